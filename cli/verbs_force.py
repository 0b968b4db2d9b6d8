"""Verbs for force feedback: force start, force stop, force gains, tare."""

from typing import Annotated, Any

from typer import BadParameter, Option, Typer

from cli.context import (
    CellOption,
    JsonOption,
    cell_of,
    exit_with_error,
    print_note,
    print_reply,
    waiting,
)
from cli.numbers import NEGATIVE_NUMBERS, POSE, parse_gain, parse_vector
from forcemesh.errors import ForcemeshError
from forcemesh.force_task import AXIS_NAMES, parse_task
from forcemesh.messages import Host, Mode, PoseRecord, Preset, TaskFrame
from forcemesh.requests import ForceStartRequest, ForceTask, GainsRequest

force = Typer(no_args_is_help=True, help="Force feedback: start, stop, gains.")


OPTIONS = (  # of the verb `gains`, in the order of the record
    ("--force-p", "m/N"),
    ("--force-i", "m/(N s)"),
    ("--torque-p", "rad/(N m)"),
    ("--torque-i", "rad/(N m s)"),
)


def known_law(law: str | None) -> str | None:
    """Return the law of an option. Raises BadParameter for one that does not exist."""
    if law is not None:
        from control.laws import LAWS

        if law not in LAWS:
            raise BadParameter(f"must be {' or '.join(LAWS)}, found {law!r}")
    return law


LawOption = Annotated[
    str | None,
    Option(
        callback=known_law,
        metavar="LAW",
        help="Control law: plain, adaptive or an added one; default: the cell file's.",
    ),
]
PresetOption = Annotated[
    Preset | None,
    Option(
        help="Gains: gentle is slow without overshoot, stiff rejects disturbances but overshoots."
    ),
]


def _task(axes: str, frame: TaskFrame, pose: str | None) -> ForceTask:
    """Return the task of the options; a mistake ends the verb."""
    record = None
    if pose is not None:
        from forcemesh.client.rotations import from_oat_deg

        x, y, z, o, a, t = parse_vector(pose, POSE)
        record = PoseRecord(
            position_m=(x / 1e3, y / 1e3, z / 1e3), orientation_xyzw=from_oat_deg((o, a, t))
        )
    try:
        return parse_task(axes, frame, record)
    except ForcemeshError as error:
        exit_with_error(f"--axes: {error}")


def _axes(text: str) -> tuple[bool, bool, bool, bool, bool, bool]:
    """Return a mask of the named axes; an unknown name ends the verb."""
    named = [name.strip() for name in text.split(",")]
    unknown = [name for name in named if name not in AXIS_NAMES]
    if unknown:
        known = ", ".join(AXIS_NAMES)
        exit_with_error(f"--axes: unknown axis {', '.join(unknown)}: choose from {known}")
    x, y, z, rx, ry, rz = (axis in named for axis in AXIS_NAMES)
    return (x, y, z, rx, ry, rz)


def _gain(unit: str) -> Any:
    return Option(metavar="x,y,z", help=f"[{unit}]")


@force.command("start")
def force_start(
    *,
    mode: Annotated[Mode, Option(help="Controlled motion.")] = "position",
    setpoint: Annotated[
        float, Option(min=0.0, help="Press force along the tool's axis [N].")
    ] = 0.0,
    host: Annotated[Host, Option(help="Host of the control loop.")] = "pc",
    law: LawOption = None,
    preset: PresetOption = None,
    axes: Annotated[
        str,
        Option(
            help="Controlled axes, separated by commas: x, y, z, rotations rx, ry, rz. Or the "
            'control of each axis: "z=force:15 rx=torque:0 x=compliant,mass=10,stiffness=500"; '
            "the others are held."
        ),
    ] = ",".join(AXIS_NAMES),
    frame: Annotated[
        TaskFrame | None,
        Option(help="Frame of the axes: by default base, and tool with a control of each axis."),
    ] = None,
    pose: Annotated[
        str | None,
        Option(metavar=str(POSE), help="Of frame pose in base; rotations are about its origin."),
    ] = None,
    cell: CellOption = None,
) -> None:
    """Start force feedback; in free space the tool approaches along its set point until contact."""
    if "=" in axes:
        if setpoint or mode != "position":
            exit_with_error("--axes NAME=CONTROL holds the set points: omit --setpoint and --mode")
        task = _task(axes, frame or "tool", pose)
        request = ForceStartRequest(task=task, host=host, law=law, preset=preset)
    else:
        if frame not in (None, "base", "tool"):
            exit_with_error(f'--frame {frame}: needs --axes "NAME=CONTROL ..."')
        request = ForceStartRequest(
            mode=mode,
            host=host,
            setpoint_N=setpoint,
            law=law,
            preset=preset,
            axes=_axes(axes),
            frame="tool" if frame == "tool" else "base",
        )
    with cell_of(cell) as client:
        print_reply(client.force.begin(request))


@force.command("stop")
def force_stop(cell: CellOption = None) -> None:
    """Stop force feedback; the arm stays where it is."""
    with cell_of(cell) as client:
        print_reply(client.force.stop())


@force.command("gains", context_settings=NEGATIVE_NUMBERS)
def force_gains(
    *,
    force_p: Annotated[str | None, _gain("m/N")] = None,
    force_i: Annotated[str | None, _gain("m/(N s)")] = None,
    torque_p: Annotated[str | None, _gain("rad/(N m)")] = None,
    torque_i: Annotated[str | None, _gain("rad/(N m s)")] = None,
    preset: PresetOption = None,
    accept_unstable: Annotated[
        bool,
        Option("--accept-unstable", help="Also gains that are unstable at the stiffest contact."),
    ] = False,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Set gains for the base axes x,y,z, or one number for all three; print all gains.

    Omitted gains keep their value, or take that of the preset. Without options the present gains
    are printed in the form of the options. While force feedback runs, gains change on a ramp.
    """
    request = GainsRequest(
        preset=preset,
        force_p_m_per_N=parse_gain(force_p, "m/N"),
        force_i_m_per_Ns=parse_gain(force_i, "m/(N s)"),
        torque_p_rad_per_Nm=parse_gain(torque_p, "rad/(N m)"),
        torque_i_rad_per_Nms=parse_gain(torque_i, "rad/(N m s)"),
        accept_unstable=accept_unstable,
    )
    with cell_of(cell) as client:
        reply = client.force.ask_gains(request)
    if reply.gains is not None and as_json:
        print(reply.gains.as_json())
    elif reply.gains is not None:
        for (option, unit), gain in zip(OPTIONS, reply.gains.as_dict().values(), strict=True):
            print(f"{option} {','.join(f'{part:g}' for part in gain)}  # {unit}")
    if reply.text:
        print_note(reply.text)


def tare(cell: CellOption = None) -> None:
    """Tare: set the present reading to zero force; refused in motion or in contact."""
    with cell_of(cell) as client, waiting("taring: arm at rest, tool free"):
        print_reply(client.tare())
