"""Move tab: jog in base or tool axes, joint moves, pose moves, speed; confirmed or unlocked."""

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import viser

from common.motion.convert import pose_of, record_of
from common.motion.frames import Oat, R_from_oat, oat_from_R, pose
from forcemesh.client import Cell, RefusedError
from forcemesh.clock import NS_PER_S
from forcemesh.errors import NotReachedError
from forcemesh.messages import ZERO3, Vec3
from forcemesh.requests import MoveRequest
from services.panel.markup import Html, html, paragraphs
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, Viewer, in_background, put
from services.panel.watch import Snapshot

STEPS_MM = ("1", "5", "10", "50")
UNLOCKED_S = 60.0
USUAL_MM_S = 50.0
RequestMove = Callable[[str, Callable[[Cell], MoveRequest]], None]  # title, request
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
    viewer.button(
        "Arm for jog",
        lambda: viewer.confirm_and_do(
            "Arm for jog", ARM_TEXT, "Arm now", lambda cell: cell.arm("jog").text
        ),
        icon=viser.Icon.POWER,
        color="orange",
    )
    add_back_off(viewer)
    most_mm_s = 1e3 * viewer.cell.limits.speed_m_s
    speed = gui.add_slider(
        "Speed [mm/s]", min=1.0, max=most_mm_s, step=1.0, initial_value=min(USUAL_MM_S, most_mm_s)
    )

    def move(what: str, request: Callable[[Cell], MoveRequest]) -> None:
        """Request a move; show its refusal, or its end."""
        speed_m_s = float(speed.value) / 1e3

        def run(cell: Cell) -> str:
            moving = cell.move.begin(request(cell).replaced(speed_m_s=speed_m_s))
            x, y, z = (1e3 * part for part in moving.wait().position_m)
            return f"reached: flange at {x:z.1f}, {y:z.1f}, {z:z.1f} mm"

        in_background(lambda: viewer.do(what, run))

    with gui.add_folder("Jog"):
        jog = _Jog(viewer, move)
    with gui.add_folder("Joints", expand_by_default=False):
        _add_joints(viewer, move)
    with gui.add_folder("Flange pose", expand_by_default=False):
        _add_flange_pose(viewer, move)

    def refresh(snapshot: Snapshot) -> None:
        where.show(where_text(snapshot))
        jog.refresh()

    return refresh


def add_back_off(viewer: Viewer) -> None:
    """Add the button to back off: a second question when no force direction is available."""

    def begin(*, without_force: bool = False) -> None:
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

        def run() -> None:
            viewer.do(BACK_OFF, back_off)
            if refused and refused[0].code == "no_direction" and not without_force:
                question = html(
                    "<p>{}</p><p>Without a measured force <b>the tool moves 5 mm back along its "
                    "own axis</b>, at 5 mm/s, then the arm holds. Confirm that this path is free "
                    "and that the area is clear.</p>",
                    refused[0].text,
                )
                title = f"{BACK_OFF} without force"
                viewer.confirm(title, question, "Move 5 mm back", lambda: begin(without_force=True))

        in_background(run)

    viewer.button(
        BACK_OFF,
        lambda: viewer.confirm(BACK_OFF, BACK_OFF_TEXT, "Back off now", begin),
        icon=viser.Icon.ARROW_BACK_UP,
        color="orange",
    )


class _Jog:
    """Jog steps along axes; one confirmation unlocks the buttons of this page for a while."""

    def __init__(self, viewer: Viewer, move: RequestMove) -> None:
        gui, self._clock, self._move = viewer.gui, viewer.watch.clock, move
        self._until_ns = 0
        self._unlock = viewer.button(
            "Unlock jogging",
            lambda: viewer.confirm("Unlock jogging", JOG_TEXT, "Unlock", self._open),
            icon=viser.Icon.LOCK,
            color="orange",
        )
        self._axes = gui.add_dropdown("Reference frame", ("base", "tool"))
        self._step = gui.add_dropdown("Step [mm or deg]", STEPS_MM, initial_value="5")
        shift = gui.add_button_group("Translation", ARROWS, visible=False)
        turn = gui.add_button_group("Rotation", ARROWS, visible=False)
        self._count = viewer.cell.robot.joints
        joint = gui.add_dropdown("Joint", tuple(f"J{n + 1}" for n in range(self._count)))
        by = gui.add_button_group("Joint step", ("−", "+"), visible=False)
        self._groups = (shift, turn, by)
        shift.on_click(lambda _event: self._jog(shift.value, turning=False))
        turn.on_click(lambda _event: self._jog(turn.value, turning=True))
        by.on_click(lambda _event: self._jog_joint(joint.value, by.value))

    def refresh(self) -> None:
        """Lock again UNLOCKED_S after the last jog."""
        is_open = self._is_open()
        put(self._unlock, visible=not is_open)
        for group in self._groups:
            put(group, visible=is_open)  # groups cannot be disabled

    def _open(self) -> None:
        self._until_ns = self._clock.now_ns() + round(UNLOCKED_S * NS_PER_S)
        self.refresh()

    def _is_open(self) -> bool:
        return self._clock.now_ns() < self._until_ns

    def _jog(self, arrow: str, *, turning: bool) -> None:
        if not self._is_open():
            return
        self._open()
        step, axis = self._signed_step(arrow), arrow[1:]
        displacement = vector("xyz".index(axis), math.radians(step) if turning else step / 1e3)
        parts = (ZERO3, displacement) if turning else (displacement, ZERO3)
        axes: Literal["base", "tool"] = "tool" if self._axes.value == "tool" else "base"
        unit = "degrees about" if turning else "mm along"

        def request(cell: Cell) -> MoveRequest:
            return MoveRequest(kind="pose", pose=cell.move.jogged(*parts, axes=axes))

        self._move(f"Jog {step:+g} {unit} {axis} of the {axes}", request)

    def _jog_joint(self, joint: str, arrow: str) -> None:
        if not self._is_open():
            return
        self._open()
        step_deg = self._signed_step(arrow)
        by = np.zeros(self._count)
        by[int(joint[1:]) - 1] = math.radians(step_deg)
        request = MoveRequest(kind="by", joint_rad=tuple(by.tolist()))
        self._move(f"{joint} by {step_deg:+g} degrees", lambda _cell: request)

    def _signed_step(self, arrow: str) -> float:
        return float(self._step.value) * (-1.0 if arrow.startswith("−") else 1.0)


def _add_joints(viewer: Viewer, move: RequestMove) -> None:
    """Add the form of a joint move: one angle for each joint."""
    limits = zip(viewer.cell.robot.joint_min_deg, viewer.cell.robot.joint_max_deg, strict=True)
    fields = [
        viewer.gui.add_number(f"J{n} [deg]", 0.0, min=low, max=high, step=0.1)
        for n, (low, high) in enumerate(limits, 1)
    ]

    def take() -> None:
        state = viewer.watch.snapshot().robot.fresh
        if state is not None and len(state.joint_rad) == len(fields):
            for field, angle in zip(fields, state.joint_rad, strict=True):
                put(field, value=round(math.degrees(angle), 2))

    def start() -> None:
        angles = [float(field.value) for field in fields]
        request = MoveRequest(kind="joints", joint_rad=tuple(np.radians(angles).tolist()))
        text = "All joints move to " + ", ".join(f"{angle:g}" for angle in angles) + " degrees."
        what = "Move the joints"
        viewer.confirm(what, paragraphs(text), "Move now", lambda: move(what, lambda _: request))

    viewer.button("Copy current angles", take, color="gray")
    viewer.button("Move the joints", start, icon=viser.Icon.PLAYER_PLAY, color="orange")


def _add_flange_pose(viewer: Viewer, move: RequestMove) -> None:
    """Add the form of a move of the flange to a pose, in the pendant's convention."""
    place = viewer.gui.add_vector3("X, Y, Z [mm]", (0.0, 0.0, 0.0), step=0.1)
    angles = viewer.gui.add_vector3("O, A, T [deg]", (0.0, 0.0, 0.0), step=0.1)

    def take() -> None:
        state = viewer.watch.snapshot().robot.fresh
        if state is not None:
            T = pose_of(state)
            put(place, value=tuple(round(1e3 * float(part), 2) for part in T.translation))
            oat = oat_from_R(T.rotation)
            put(angles, value=tuple(round(math.degrees(angle), 3) for angle in oat))

    def start() -> None:
        x, y, z = place.value
        R = R_from_oat(Oat(*(math.radians(angle) for angle in angles.value)))
        T = pose((x / 1e3, y / 1e3, z / 1e3), R)
        request = MoveRequest(kind="pose", pose=record_of(T))
        text = f"The flange moves to {x:g}, {y:g}, {z:g} mm on the path of the controller."
        what = "Move to a pose"
        viewer.confirm(what, paragraphs(text), "Move now", lambda: move(what, lambda _: request))

    viewer.button("Copy current pose", take, color="gray")
    viewer.button("Move to pose", start, icon=viser.Icon.PLAYER_PLAY, color="orange")


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
    return paragraphs(html("flange <b>{}</b> mm · O A T {}°<br>joints {}°", flange, turned, joints))


TAB = Tab(20, "Move", viser.Icon.ARROWS_MOVE, build)
