"""Table of the six axes of a task: control and set point of each, and what it does now."""

from math import degrees
from typing import Any

import viser

from forcemesh.errors import ForcemeshError
from forcemesh.force_task import AXIS_NAMES, CONTROLS, parse_task, task_text
from forcemesh.messages import AxisState, RegulatorTarget, TaskFrame
from forcemesh.requests import ForceStartRequest, ForceTask
from services.panel.markup import Html, html, joined
from services.panel.tabs import Refresh
from services.panel.viewer import Prose, RequestOutcome, Viewer, put
from services.panel.watch import Snapshot

FRAMES: tuple[TaskFrame, ...] = ("tool", "base", "sensor", "path")  # a pose is given by a program
OPTIONS_HINT = (
    "Separated by commas: speed=20, deviation=10 (mm or degrees), deadband=0.5; of a compliant "
    "axis mass=5, damping=200, stiffness=500."
)
ROW = "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>"


class AxisRow:
    """Form of one axis: control, set point, options."""

    def __init__(self, gui: viser.GuiApi, name: str) -> None:
        """Append the form; the axis is held."""
        self.name = name
        self._setpoint_control = "torque" if name.startswith("r") else "force"
        other = "force" if name.startswith("r") else "torque"
        controls = tuple(control for control in CONTROLS if control != other)
        unit = "N m" if name.startswith("r") else "N"
        self._control = gui.add_dropdown(name, controls, initial_value="held")
        self._setpoint = gui.add_number(f"{name} set point [{unit}]", 0.0, step=0.1, visible=False)
        self._options = gui.add_text(f"{name} options", "", hint=OPTIONS_HINT, visible=False)
        self._control.on_update(lambda _event: self._show())

    def _show(self) -> None:
        """Show the fields that the control has."""
        put(self._setpoint, visible=self._control.value == self._setpoint_control)
        put(self._options, visible=self._control.value != "held")

    def text(self) -> str:
        """Return the axis as the command line writes it."""
        control, options = self._control.value, self._options.value.replace(" ", "")
        if control == self._setpoint_control:
            control = f"{control}:{self._setpoint.value:g}"
        extra = f",{options}" if options and self._control.value != "held" else ""
        return f"{self.name}={control}{extra}"


def add_axes(viewer: Viewer) -> Refresh:
    """Add the form of a task per axis, and the table of what its axes do now."""
    gui = viewer.gui
    table = Prose(gui, html("<p>no task runs</p>"))
    frame = gui.add_dropdown("Frame", FRAMES, initial_value="tool")
    rows = [AxisRow(gui, name) for name in AXIS_NAMES]
    host = gui.add_dropdown("Host of the axes", viewer.cell.robot.hosts)

    def ask() -> None:
        try:
            asked = parse_task(" ".join(row.text() for row in rows), frame.value)
        except ForcemeshError as error:
            viewer.show("Start axes", RequestOutcome("refused", str(error)))
            return
        request = ForceStartRequest(task=asked, host=host.value)
        text = task_question(asked, viewer.cell.force.search_m)
        viewer.confirm_and_do(
            "Start axes", text, "Start now", lambda cell: cell.force.begin(request).text
        )

    viewer.button("Start axes", ask, icon=viser.Icon.PLAYER_PLAY, color="orange")

    def refresh(snapshot: Snapshot) -> None:
        table.show(axes_table(snapshot.target.fresh))

    return refresh


def task_question(task: ForceTask, search_m: float) -> Html:
    """Return the confirmation text of a task."""
    return html(
        "<p>Frame <b>{}</b>: <b>{}</b>. The tool moves along the force set point until contact, at "
        "most {} mm; compliant axes follow whatever pushes the tool.</p>",
        task.frame,
        task_text(task),
        f"{1e3 * search_m:.0f}",
    )


def axes_table(target: RegulatorTarget | None) -> Html:
    """Return control, set point, exerted load and deviation of each axis of a running task."""
    if target is None or not target.axes:
        return html("<p>no task runs</p>")
    rows = joined(axis_row(name, axis) for name, axis in zip(AXIS_NAMES, target.axes, strict=True))
    head = html("<tr><th>{}</th><th>control</th><th>set point</th><th>now</th><th>moved</th></tr>",
                target.frame)  # fmt: skip
    return html("<table>{}{}</table>", head, rows)


def axis_row(name: str, axis: AxisState) -> Html:
    """Return the row of one axis; forces are of the tool on its environment."""
    turns = name.startswith("r")
    unit, moved = ("N m", f"{degrees(axis.deviation):.2f}°") if turns else (
        "N", f"{1e3 * axis.deviation:.2f} mm")  # fmt: skip
    setpoint = f"{axis.setpoint:.2f}" if axis.control == "force" else "–"
    limit = " ⚠ limit" if axis.at_limit else ""
    control: Any = "torque" if turns and axis.control == "force" else axis.control
    return html(ROW, name, control, setpoint, f"{axis.exerted:.2f} {unit}", f"{moved}{limit}")
