"""Force tab: arm, tare, press with a set point, gains."""

from contextlib import suppress
from math import hypot
from typing import Any, get_args

import viser

from common.config.cell import CellConfig
from forcemesh.client import Cell
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ForcemeshError
from forcemesh.messages import LAWS_THAT_SHIP, Gains, Mode, Preset, Vec3
from forcemesh.requests import ForceStartRequest, GainsRequest
from services.panel.axes_form import add_axes
from services.panel.markup import Html, html, paragraphs
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, Viewer, in_background, put
from services.panel.watch import Snapshot
from tuning.forecast import ForceJob
from tuning.forecast_text import one_line

READ_S = 5.0  # between two requests for the regulator's gains, which no topic carries
GAIN_ROWS = (  # field, label, SI value of one unit of the form
    ("force_p_m_per_N", "force P [µm/N]", 1e-6),
    ("force_i_m_per_Ns", "force I [mm/(N s)]", 1e-3),
    ("torque_p_rad_per_Nm", "torque P [mrad/(N m)]", 1e-3),
    ("torque_i_rad_per_Nms", "torque I [rad/(N m s)]", 1.0),
)
ARM_TEXT = paragraphs(
    "The arm executes commands once armed. Confirm that the area is clear and a hand is at the "
    "emergency stop."
)


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    gui = viewer.gui
    now = Prose(gui, paragraphs("…"))
    arm = viewer.button(
        "Arm",
        lambda: viewer.confirm_and_do("Arm", ARM_TEXT, "Arm now", lambda cell: cell.arm().text),
        icon=viser.Icon.POWER,
        color="orange",
    )
    viewer.button(
        "Tare",
        lambda: viewer.do("Tare", lambda cell: cell.tare().text),
        icon=viser.Icon.SCALE,
        hint="Sets the present reading to zero; needs free space.",
    )
    with gui.add_folder("Press"):
        refresh_press = _add_press(viewer)
    with gui.add_folder("Guide", expand_by_default=False):
        _add_guiding(viewer)
    with gui.add_folder("Axes", expand_by_default=False):
        refresh_axes = add_axes(viewer)
    with gui.add_folder("Gains", expand_by_default=False):
        gains = _GainsForm(viewer)

    def refresh(snapshot: Snapshot) -> None:
        now.show(now_text(snapshot))
        refresh_press(snapshot)
        refresh_axes(snapshot)
        gains.refresh(snapshot)
        status = snapshot.arbiter.fresh
        put(arm, visible=status is None or not status.operational)

    return refresh


class SyncedField:
    """Form field that follows a setting of the cell until the user edits it.

    A value that differs from the one shown last is edited, until it is sent or restored.
    """

    def __init__(self, handle: Any) -> None:
        """Start with the value that the form shows."""
        self.handle, self.shown = handle, handle.value

    @property
    def is_own(self) -> bool:
        """Whether the user has edited it."""
        return bool(self.handle.value != self.shown)

    def follow(self, setting: object) -> None:
        """Show the cell's setting unless the field is edited; None is unknown."""
        if setting is None:
            return
        if not self.is_own and self.handle.value != setting:
            put(self.handle, value=setting)
        if self.handle.value == setting:
            self.shown = self.handle.value


def _add_press(viewer: Viewer) -> Refresh:
    """Add the form of a press: set point, mode, loop host and control law."""
    gui, config = viewer.gui, viewer.cell
    most_N = config.force.setpoint_max_N
    setpoint = gui.add_slider(
        "Set point [N]", min=0.0, max=most_N, step=0.5, initial_value=min(15.0, most_N)
    )
    mode = gui.add_dropdown("Mode", get_args(Mode))
    host = gui.add_dropdown("Loop host", config.robot.hosts, hint="Runs the regulator.")
    laws = dict.fromkeys((*LAWS_THAT_SHIP, config.force.law))
    law = gui.add_dropdown("Control law", tuple(laws), initial_value=config.force.law)
    fields = {"setpoint_N": setpoint, "mode": mode, "host": host, "law": law}
    followed = {name: SyncedField(handle) for name, handle in fields.items()}

    def request() -> ForceStartRequest:
        return ForceStartRequest(
            mode=mode.value, host=host.value, law=law.value, setpoint_N=float(setpoint.value)
        )

    def begin(cell: Cell) -> str:
        return cell.force.begin(request()).text

    def ask() -> None:
        text = start_question(request(), config.force.search_m)
        viewer.confirm_and_do("Start pressing", text, "Press now", begin)

    expected = Prose(gui, forecast_line(request(), config))
    start = viewer.button("Start pressing", ask, icon=viser.Icon.PLAYER_PLAY, color="orange")
    change = viewer.button(
        "Change set point",
        lambda: viewer.do("Set point", begin),
        icon=viser.Icon.ADJUSTMENTS,
        visible=False,
    )
    stop = viewer.button(
        "Stop force feedback",
        lambda: viewer.do("Force feedback", lambda cell: cell.force.stop().text),
        icon=viser.Icon.PLAYER_STOP,
        color="gray",
        visible=False,
    )

    def refresh(snapshot: Snapshot) -> None:
        """Show the settings of the running press and the buttons that apply."""
        for name, field in followed.items():
            field.follow(getattr(snapshot.target.fresh, name, None))
        expected.show(forecast_line(request(), config))
        runs = getattr(snapshot.target.message, "mode", None) is not None
        put(start, visible=not runs)
        put(change, visible=runs)
        put(stop, visible=runs)

    return refresh


def _add_guiding(viewer: Viewer) -> None:
    """Add the form of hand guiding; force feedback is stopped as a press is."""
    mode = viewer.gui.add_dropdown("Guided motion", get_args(Mode))

    def ask() -> None:
        chosen: Mode = mode.value
        viewer.confirm_and_do(
            "Guide by hand",
            guiding_question(chosen),
            "Guide now",
            lambda cell: cell.force.guide(chosen).text,
        )

    viewer.button("Guide by hand", ask, icon=viser.Icon.HAND_MOVE, color="orange")


def forecast_line(request: ForceStartRequest, cell: CellConfig) -> Html:
    """Return what a press is forecast to do on the cell's contact, or why there is no forecast."""
    job = ForceJob(request.setpoint_N, law=request.law, host=request.host, mode=request.mode)
    return paragraphs(one_line(cell, job))


def start_question(request: ForceStartRequest, search_m: float) -> Html:
    """Return the confirmation text of a start request."""
    return html(
        "<p>The tool moves along its z axis until contact, then presses with <b>{} N</b> "
        "(mode {}, loop host {}). The search ends after {} mm without contact.</p>",
        f"{request.setpoint_N:g}",
        request.mode,
        request.host,
        f"{1e3 * search_m:.0f}",
    )


def guiding_question(mode: Mode) -> Html:
    """Return the confirmation text of hand guiding."""
    return html(
        "<p>Hand guiding: <b>the tool moves in the direction in which it is pushed</b> (mode "
        "{}). Confirm that the space around it is free and that only the guiding person is "
        "within reach.</p>",
        mode,
    )


class _GainsForm:
    """Form of the regulator's gains; the regulator ramps to new ones, also while pressing."""

    def __init__(self, viewer: Viewer) -> None:
        gui, self._viewer = viewer.gui, viewer
        preset = gui.add_button_group(
            "Preset", get_args(Preset), hint="Gain rule for this cell's stiffest contact."
        )
        self._rows = {
            field: SyncedField(
                gui.add_vector3(label, (0.0, 0.0, 0.0), min=(0.0, 0.0, 0.0), step=0.001)
            )
            for field, label, _ in GAIN_ROWS
        }
        self._accepts = gui.add_checkbox(
            "Accept unstable gains",
            initial_value=False,
            hint="At the stiffest contact of the cell file.",
        )
        viewer.button(
            "Read", lambda: viewer.do("Gains", self._read), icon=viser.Icon.REFRESH, color="gray"
        )
        viewer.button(
            "Apply",
            lambda: viewer.do("Gains", self._apply),
            icon=viser.Icon.CHECK,
            hint="Gains of base x, y, z.",
        )
        self._are_read, self._read_at_ns = False, 0
        preset.on_click(
            lambda _event: viewer.do(
                f"Gains {preset.value}", lambda cell: self._set(cell, {"preset": preset.value})
            )
        )

    def refresh(self, snapshot: Snapshot) -> None:
        """Request the regulator's gains every READ_S and show them."""
        if snapshot.target.silent or snapshot.now_ns - self._read_at_ns < READ_S * NS_PER_S:
            return
        self._read_at_ns = snapshot.now_ns
        in_background(self._follow)

    def _follow(self) -> None:
        with suppress(ForcemeshError):
            gains = self._viewer.watch.client.force.gains()
            for field, shown in in_rows(gains).items():
                self._rows[field].follow(shown)
            self._are_read = True

    def _read(self, cell: Cell) -> str:
        self._show(cell.force.gains())
        return "gains read from the regulator"

    def _apply(self, cell: Cell) -> str:
        if not self._are_read:  # the zeros of an unread form must not be applied
            return f"{self._read(cell)}: change them, then apply"
        request = {
            field: tuple(float(part) * unit for part in self._rows[field].handle.value)
            for field, _, unit in GAIN_ROWS
        }
        return self._set(cell, request)

    def _set(self, cell: Cell, request: dict[str, Any]) -> str:
        asked = GainsRequest(**request, accept_unstable=bool(self._accepts.value))
        reply = cell.force.ask_gains(asked)
        if reply.gains is not None:
            self._show(reply.gains)
        warning = f"\n⚠ {reply.text}" if reply.text else ""
        return f"set; the regulator ramps to the new gains{warning}"

    def _show(self, gains: Gains) -> None:
        for field, shown in in_rows(gains).items():
            put(self._rows[field].handle, value=shown)
            self._rows[field].follow(shown)
        self._are_read = True


def in_rows(gains: Gains) -> dict[str, Vec3]:
    """Return gains in the units of the form, by field."""
    rows = {}
    for field, _, unit in GAIN_ROWS:
        x, y, z = (part / unit for part in getattr(gains, field))
        rows[field] = (x, y, z)
    return rows


def now_text(snapshot: Snapshot) -> Html:
    """Return the present force, the running press and what prevents one."""
    target, wrench, status = snapshot.target.message, snapshot.wrench.fresh, snapshot.arbiter.fresh
    if wrench is None:
        return paragraphs(f"⚠ no wrench: {snapshot.hub_fault or snapshot.wrench.fault}")
    force_N = hypot(*wrench.force_N)
    doing = html("force feedback is off")
    if target is not None and target.mode is not None:
        doing = html("mode <b>{}</b>, loop host {}, {}", target.mode, target.host, target.contact)
    if target is not None and target.setpoint_N is not None:
        doing = html("{}, set point <b>{} N</b>", doing, f"{target.setpoint_N:g}")
    lines: list[Html | str] = [html("<b>{} N</b> · {}", f"{force_N:.1f}", doing)]
    if status is not None and not status.operational:
        lines.append("not armed")
    if not wrench.calibrated:
        lines.append(f"⚠ not calibrated: {wrench.calibration_fault}")
    return paragraphs(*lines)


TAB = Tab(10, "Force", viser.Icon.ARROW_BAR_TO_DOWN, build)
