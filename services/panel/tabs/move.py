"""Move tab: jog in base or tool axes, joint moves, pose moves, speed; confirmed or unlocked."""

import math
import threading
from collections.abc import Callable
from typing import Literal

import numpy as np
import viser

from common.motion.convert import joints, pose_of, record_of
from common.motion.frames import Oat, R_from_oat, oat_from_R, pose
from forcemesh.client import Cell, RefusedError
from forcemesh.errors import NotReachedError
from forcemesh.messages import RobotState, Vec3
from forcemesh.requests import MoveRequest
from services.panel.markup import Html, html, paragraphs
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, RequestOutcome, Viewer, ask, put
from services.panel.watch import Snapshot

STEPS_MM = ("1", "5", "10", "50")
UNLOCKED_S = 60.0
USUAL_MM_S = 50.0
ARROWS = ("−x", "+x", "−y", "+y", "−z", "+z")
JOG_TEXT = html(
    "<p>Until one minute after the last jog, <b>each click moves the arm at once</b>, without a "
    "question. Confirm that the area is clear and a hand is at the emergency stop.</p>"
)
BACK_OFF = "Back off"
BACK_OFF_TEXT = html(
    "<p>Frees an arm above a force limit or outside the workspace: <b>it moves up to 20 mm at "
    "5 mm/s</b>, along the measured force or straight back into the workspace, then holds. "
    "Confirm that the area is clear.</p>"
)
ARM_TEXT = paragraphs(
    "Arms for moves only, also without calibration and in contact. Force feedback stays off."
)


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    gui = viewer.gui
    where = Prose(gui, paragraphs("…"))
    arm = gui.add_button("Arm for jog", icon=viser.Icon.POWER, color="orange")
    arm.on_click(
        lambda _event: viewer.confirm_and_do(
            "Arm for jog", ARM_TEXT, "Arm now", lambda cell: cell.arm("jog").text
        )
    )
    BackOffButton(viewer)
    most_mm_s = 1e3 * viewer.cell.limits.speed_m_s
    speed = gui.add_slider(
        "Speed [mm/s]", min=1.0, max=most_mm_s, step=1.0, initial_value=min(USUAL_MM_S, most_mm_s)
    )
    mover = Mover(viewer, lambda: float(speed.value) / 1e3)
    with gui.add_folder("Jog"):
        jog = _Jog(viewer, mover)
    with gui.add_folder("Joints", expand_by_default=False):
        _Joints(viewer, mover)
    with gui.add_folder("Flange pose", expand_by_default=False):
        _JointTargets(viewer, mover)

    def refresh(snapshot: Snapshot) -> None:
        where.show(where_text(snapshot))
        jog.refresh()

    return refresh


class BackOffButton:
    """Back-off button: one confirmation, a second one when no force direction is available.

    Backing off takes seconds, so it runs in a separate thread: no click blocks.
    """

    def __init__(self, viewer: Viewer) -> None:
        """Add the button to the form."""
        self._viewer = viewer
        button = viewer.gui.add_button(BACK_OFF, icon=viser.Icon.ARROW_BACK_UP, color="orange")
        button.on_click(
            lambda _event: viewer.confirm(BACK_OFF, BACK_OFF_TEXT, "Back off now", self._begin)
        )

    def _begin(self, *, without_force: bool = False) -> None:
        threading.Thread(
            target=self._start, kwargs={"without_force": without_force}, daemon=True
        ).start()

    def _start(self, *, without_force: bool) -> None:
        refused: list[RefusedError] = []

        def back_off(cell: Cell) -> str:
            try:
                end = cell.back_off(without_force=without_force)
            except RefusedError as error:
                refused.append(error)
                raise
            if end.code != "back_off":
                raise NotReachedError(f"not free yet: {end.text}")
            return end.text

        self._viewer.do(BACK_OFF, back_off)
        if refused and refused[0].code == "no_direction" and not without_force:
            self._ask_again(refused[0].text)

    def _ask_again(self, why: str) -> None:
        question = html(
            "<p>{}</p><p>Without a measured force <b>the tool moves 5 mm back along its own "
            "axis</b>, at 5 mm/s, then the arm holds. Confirm that this path is free and that "
            "the area is clear.</p>",
            why,
        )
        self._viewer.confirm(
            f"{BACK_OFF} without force",
            question,
            "Move 5 mm back",
            lambda: self._begin(without_force=True),
        )


class Mover:
    """Requests a move and shows its acceptance, then its result."""

    def __init__(self, viewer: Viewer, speed_m_s: Callable[[], float]) -> None:
        self._viewer = viewer
        self._speed_m_s = speed_m_s

    def begin(self, what: str, request: Callable[[Cell], MoveRequest]) -> None:
        """Request the move; a separate thread waits for its end, so that no click blocks."""
        watch, found = self._viewer.watch, []

        def begin(cell: Cell) -> str:
            move = request(cell).replaced(speed_m_s=self._speed_m_s())
            found.append(cell.move.begin(move))
            return "started"

        answer = ask(watch, begin)
        if not found:
            self._viewer.show(what, answer)
            return

        def follow() -> None:
            ended: RequestOutcome = ask(watch, lambda _cell: _arrived(found[0].wait()))
            self._viewer.show(what, ended)

        threading.Thread(target=follow, daemon=True).start()

    def state(self) -> RobotState | None:
        """Return the state of the arm, None when it is not fresh."""
        return self._viewer.watch.snapshot().robot.fresh


class _Jog:
    """Jog steps along axes; one confirmation unlocks the buttons of this page for a while."""

    def __init__(self, viewer: Viewer, mover: Mover) -> None:
        gui, self._viewer, self._mover = viewer.gui, viewer, mover
        self._until_ns = 0
        self._unlock = gui.add_button("Unlock jogging", icon=viser.Icon.LOCK, color="orange")
        self._axes = gui.add_dropdown("Reference frame", ("base", "tool"))
        self._step = gui.add_dropdown("Step [mm or deg]", STEPS_MM, initial_value="5")
        self._shift = gui.add_button_group("Translation", ARROWS, visible=False)
        self._turn = gui.add_button_group("Rotation", ARROWS, visible=False)
        names = tuple(f"J{n + 1}" for n in range(viewer.cell.robot.joints))
        self._joint = gui.add_dropdown("Joint", names)
        self._by = gui.add_button_group("Joint step", ("−", "+"), visible=False)
        self._unlock.on_click(
            lambda _event: viewer.confirm("Unlock jogging", JOG_TEXT, "Unlock", self._open)
        )
        self._shift.on_click(lambda _event: self._jog(self._shift.value, turning=False))
        self._turn.on_click(lambda _event: self._jog(self._turn.value, turning=True))
        self._by.on_click(lambda _event: self._jog_joint())

    def refresh(self) -> None:
        """Lock again UNLOCKED_S after the last jog."""
        if self._until_ns and not self._is_open():
            self._set_open(open_=False)

    def _open(self) -> None:
        self._until_ns = self._viewer.watch.clock.now_ns() + round(UNLOCKED_S * 1e9)
        self._set_open(open_=True)

    def _set_open(self, *, open_: bool) -> None:
        self._until_ns = self._until_ns if open_ else 0
        self._unlock.visible = not open_
        for handle in (self._shift, self._turn, self._by):
            handle.visible = open_  # groups cannot be disabled

    def _is_open(self) -> bool:
        return self._viewer.watch.clock.now_ns() < self._until_ns

    def _jog(self, arrow: str, *, turning: bool) -> None:
        if not self._is_open():
            return
        self._open()
        step = float(self._step.value) * (-1.0 if arrow.startswith("−") else 1.0)
        amount = math.radians(step) if turning else step / 1e3
        displacement = vector("xyz".index(arrow[1:]), amount)
        still: Vec3 = (0.0, 0.0, 0.0)
        axes: Literal["base", "tool"] = "tool" if self._axes.value == "tool" else "base"
        unit = "degrees about" if turning else "mm along"

        def request(cell: Cell) -> MoveRequest:
            translation, rotation = (still, displacement) if turning else (displacement, still)
            return MoveRequest(kind="pose", pose=cell.move.jogged(translation, rotation, axes=axes))

        self._mover.begin(f"Jog {step:+g} {unit} {arrow[1:]} of the {axes}", request)

    def _jog_joint(self) -> None:
        if not self._is_open():
            return
        self._open()
        step_deg = float(self._step.value) * (-1.0 if self._by.value == "−" else 1.0)
        by = np.zeros(self._viewer.cell.robot.joints)
        by[int(self._joint.value[1:]) - 1] = math.radians(step_deg)
        request = MoveRequest(kind="by", joint_rad=joints(by))
        self._mover.begin(f"{self._joint.value} by {step_deg:+g} degrees", lambda _cell: request)


class _Joints:
    """Joint move to one angle for each joint."""

    def __init__(self, viewer: Viewer, mover: Mover) -> None:
        gui, self._viewer, self._mover = viewer.gui, viewer, mover
        robot = viewer.cell.robot
        ranges = enumerate(zip(robot.joint_min_deg, robot.joint_max_deg, strict=True), start=1)
        self._angles = [
            gui.add_number(f"J{n} [deg]", 0.0, min=low, max=high, step=0.1)
            for n, (low, high) in ranges
        ]
        take = gui.add_button("Copy current angles", color="gray")
        button = gui.add_button("Move the joints", icon=viser.Icon.PLAYER_PLAY, color="orange")
        take.on_click(lambda _event: self._take())
        button.on_click(lambda _event: self._start())

    def _take(self) -> None:
        state = self._mover.state()
        if state is not None and len(state.joint_rad) == len(self._angles):
            for handle, angle in zip(self._angles, state.joint_rad, strict=True):
                put(handle, value=round(math.degrees(angle), 2))

    def _start(self) -> None:
        angles = [float(handle.value) for handle in self._angles]
        request = MoveRequest(kind="joints", joint_rad=joints(np.radians(angles)))
        text = "All joints move to " + ", ".join(f"{angle:g}" for angle in angles) + " degrees."
        self._viewer.confirm(
            "Move the joints",
            paragraphs(text),
            "Move now",
            lambda: self._mover.begin("Move the joints", lambda _cell: request),
        )


class _JointTargets:
    """Move of the flange to a pose, in the pendant's convention."""

    def __init__(self, viewer: Viewer, mover: Mover) -> None:
        gui, self._viewer, self._mover = viewer.gui, viewer, mover
        self._place = gui.add_vector3("X, Y, Z [mm]", (0.0, 0.0, 0.0), step=0.1)
        self._oat = gui.add_vector3("O, A, T [deg]", (0.0, 0.0, 0.0), step=0.1)
        take = gui.add_button("Copy current pose", color="gray")
        button = gui.add_button("Move to pose", icon=viser.Icon.PLAYER_PLAY, color="orange")
        take.on_click(lambda _event: self._take())
        button.on_click(lambda _event: self._start())

    def _take(self) -> None:
        state = self._mover.state()
        if state is not None:
            T = pose_of(state)
            x, y, z = (round(1e3 * float(part), 2) for part in T.translation)
            put(self._place, value=(x, y, z))
            o, a, t = (round(math.degrees(angle), 3) for angle in oat_from_R(T.rotation))
            put(self._oat, value=(o, a, t))

    def _start(self) -> None:
        place, angles = self._place.value, self._oat.value
        position_m = tuple(part / 1e3 for part in place)
        R = R_from_oat(Oat(*(math.radians(angle) for angle in angles)))
        request = MoveRequest(kind="pose", pose=record_of(pose(position_m, R)))
        x, y, z = place
        text = f"The flange moves to {x:g}, {y:g}, {z:g} mm on the path of the controller."
        self._viewer.confirm(
            "Move to a pose",
            paragraphs(text),
            "Move now",
            lambda: self._mover.begin("Move to a pose", lambda _cell: request),
        )


def vector(axis: int, amount: float) -> Vec3:
    """Return a vector along one axis."""
    x, y, z = (amount if axis == other else 0.0 for other in range(3))
    return (x, y, z)


def where_text(snapshot: Snapshot) -> Html:
    """Return the flange pose as shown on the pendant."""
    robot = snapshot.robot.fresh
    if robot is None:
        return paragraphs(f"⚠ {snapshot.hub_fault or snapshot.robot.fault}")
    T = pose_of(robot)
    x, y, z = (1e3 * float(part) for part in T.translation)
    o, a, t = (math.degrees(angle) for angle in oat_from_R(T.rotation))
    joints = ", ".join(f"{math.degrees(angle):z.1f}" for angle in robot.joint_rad)
    flange, turned = f"{x:z.1f}, {y:z.1f}, {z:z.1f}", f"{o:z.1f}, {a:z.1f}, {t:z.1f}"
    line = html("flange <b>{}</b> mm · O A T {}°<br>joints {}°", flange, turned, joints)
    return paragraphs(line)


def _arrived(state: RobotState) -> str:
    x, y, z = (1e3 * part for part in state.position_m)
    return f"reached: flange at {x:z.1f}, {y:z.1f}, {z:z.1f} mm"


TAB = Tab(20, "Move", viser.Icon.ARROWS_MOVE, build)
