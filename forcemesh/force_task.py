"""Force tasks as text: `z=force:15 rx=torque:0 x=compliant,mass=10,stiffness=500`. Pure.

Lengths and angles are in mm and degrees, as everywhere on the command line; loads are in N and N m.
Axes that are not named are held.
"""

from collections.abc import Iterable
from math import degrees, isfinite, radians

from forcemesh.errors import ForcemeshError, MessageError
from forcemesh.messages import Mode, PoseRecord, TaskFrame
from forcemesh.requests import HELD, ForceTask, TaskAxis

AXIS_NAMES = ("x", "y", "z", "rx", "ry", "rz")
CONTROLS = ("held", "force", "torque", "compliant")
EXAMPLE = "z=force:15 rx=torque:0"
GUIDED: dict[Mode, str] = {  # axes of hand guiding, by what a hand may move
    "position": "x=compliant y=compliant z=compliant",
    "orientation": "rx=compliant ry=compliant rz=compliant",
    "both": " ".join(f"{name}=compliant" for name in AXIS_NAMES),
}
COUNTS = {  # option of an axis: field of TaskAxis, and its size in SI along and about an axis
    "deadband": ("deadband", 1.0, 1.0),
    "speed": ("speed_max", 1e-3, radians(1.0)),
    "deviation": ("deviation_max", 1e-3, radians(1.0)),
    "mass": ("mass", 1.0, 1.0),
    "damping": ("damping", 1.0, 1.0),
    "stiffness": ("stiffness", 1.0, 1.0),
}
OF_COMPLIANCE = ("mass", "damping", "stiffness")


def parse_task(text: str, frame: TaskFrame = "tool", pose: PoseRecord | None = None) -> ForceTask:
    """Return the task of a text.

    Args:
        text: Axes, separated by spaces.
        frame: Of the axes.
        pose: Of the frame in base, for frame `pose`.

    Raises:
        ForcemeshError: An axis, a control, an option or a number that does not exist.
    """
    axes = dict.fromkeys(AXIS_NAMES, HELD)
    named: set[str] = set()
    for part in text.split():
        name, sign, rest = part.partition("=")
        if name not in axes or not sign:
            known = ", ".join(AXIS_NAMES)
            raise ForcemeshError(f"axis {part!r}: must be NAME=CONTROL, as in {EXAMPLE}: {known}")
        if name in named:
            raise ForcemeshError(f"axis {name}: named twice")
        named.add(name)
        axes[name] = _axis(name, rest)
    x, y, z, rx, ry, rz = axes.values()
    return ForceTask(frame=frame, pose=pose, axes=(x, y, z, rx, ry, rz))


def _axis(name: str, text: str) -> TaskAxis:
    """Return the control of one axis. Raises ForcemeshError."""
    head, *options = text.split(",")
    control, has_setpoint, setpoint = head.partition(":")
    turns = name.startswith("r")
    if control not in CONTROLS:
        raise ForcemeshError(f"axis {name}: control {control!r} must be one of {_listed(CONTROLS)}")
    if control in ("force", "torque") and (control == "torque") != turns:
        right = "torque" if turns else "force"
        raise ForcemeshError(f"axis {name}: control must be {right}, found {control}")
    if has_setpoint and control not in ("force", "torque"):
        raise ForcemeshError(f"axis {name}: control {control} has no set point")
    fields: dict[str, float] = {}
    if has_setpoint:
        fields["setpoint"] = _number(name, "set point", setpoint)
    for option in options:
        key, _, value = option.partition("=")
        if key not in COUNTS:
            raise ForcemeshError(f"axis {name}: option {key!r} must be one of {_listed(COUNTS)}")
        if key in OF_COMPLIANCE and control != "compliant":
            raise ForcemeshError(f"axis {name}: {key} needs control compliant")
        field, along, about = COUNTS[key]
        fields[field] = _number(name, key, value) * (about if turns else along)
    try:
        return TaskAxis.from_dict(
            {"control": "force" if control == "torque" else control, **fields}
        )
    except MessageError as error:
        raise ForcemeshError(f"axis {name}: {text!r}: {error}, in SI units") from error


def task_text(task: ForceTask) -> str:
    """Return the text of a task; `parse_task` reads it."""
    parts = [_axis_text(name, axis) for name, axis in zip(AXIS_NAMES, task.axes, strict=True)]
    return " ".join(parts)


def _axis_text(name: str, axis: TaskAxis) -> str:
    turns = name.startswith("r")
    text = f"{name}={axis.control}"
    if axis.control == "force":
        text = f"{name}={'torque' if turns else 'force'}:{axis.setpoint:g}"
    for key, (field, along, about) in COUNTS.items():
        value = getattr(axis, field)
        if value is not None and (key, value) != ("stiffness", 0.0):
            shown = degrees(value) if turns and about != 1.0 else value / along
            text += f",{key}={shown:.6g}"
    return text


def _number(axis: str, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise ForcemeshError(f"axis {axis}: {what} must be a number, found {text!r}")
    return value


def _listed(names: Iterable[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}"
