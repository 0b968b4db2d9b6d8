"""Instructions for arcs, XMOVE, ALIGN, the monitor speed of a program, and clamps.

C1MOVE p is a point on an arc, whose circle is only known at the next C1MOVE or C2MOVE: until then
the point is kept in `Hardware.arc`, and the program continues. The arc of C1MOVE is the part of
the circle up to its point; that of C2MOVE is the rest.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from sim.as_language.errors import AsError
from sim.as_language.values import Pose
from sim.controller.hardware import ClampState, Hardware
from sim.controller.instruction import Action, at_rest, until
from sim.controller.instructions_motion import (
    Words,
    goal_request,
    offer,
    queue_motions,
    request,
)
from sim.controller.motion_requests import MotionRequest, percent
from sim.controller.planner import circle_center_m
from sim.controller.tasks import Task, Wait

_LARGEST_TURN_RAD = np.pi - 1e-6


class ArcPoint(NamedTuple):
    """A C1MOVE that waits for the next point of its circle: its motion, and where it starts [m]."""

    motion: MotionRequest
    start_m: Array


def c1move(task: Task, goal: Pose, clamp: float | None = None) -> Wait | None:
    """C1MOVE p: an arc to p, on the circle through p and the points before and after it."""
    hardware = task.hardware
    pending = _arc_through(hardware, goal_request(task, "linear", goal, of_arc=True))
    motion, before = pending
    if before is None:
        hardware.arc = ArcPoint(motion, _position_m(hardware, None))
        return None
    hardware.arc = ArcPoint(motion, _position_m(hardware, before))
    return queue_motions(task, before, clamp=clamp)


def c2move(task: Task, goal: Pose, clamp: float | None = None) -> Wait | None:
    """C2MOVE p: the rest of the arc, to p. Raises AsError E1098 without a C1MOVE before it."""
    hardware = task.hardware
    start = hardware.arc
    if start is None:
        raise AsError("E1098")
    motion, before = _arc_through(hardware, goal_request(task, "linear", goal, of_arc=True))
    hardware.arc = None
    assert before is not None  # noqa: S101 - there is a point to start from
    return queue_motions(task, before, motion._replace(circle_m=start.start_m), clamp=clamp)


def _arc_through(
    hardware: Hardware, motion: MotionRequest
) -> tuple[MotionRequest, MotionRequest | None]:
    """Return a motion, and the one before it as an arc on the circle through its goal.

    Raises AsError E1099 if the points are on a line.
    """
    point = hardware.arc
    if point is None:
        return motion, None
    end_m = _position_m(hardware, motion)
    circle_center_m(point.start_m, _position_m(hardware, point.motion), end_m)
    return motion, point.motion._replace(circle_m=end_m)


def _position_m(hardware: Hardware, motion: MotionRequest | None) -> Array:
    """Return the TCP's position at the end of a motion, or of the newest one in the queue [m]."""
    robot = hardware.robot
    if motion is not None and motion.T_base_tcp is not None:
        return np.array(motion.T_base_tcp.translation)
    q = robot.queue.q_newest if motion is None or motion.q is None else motion.q
    return np.array((robot.kinematics.flange_pose(q) * robot.T_flange_tcp).translation)


def xmove(task: Task, goal: Pose, words: Words, signal: float) -> Wait | None:
    """XMOVE[/ERR or /LVL] p TILL s: linear, until the signal comes or p is reached.

    Without a mode only the edge counts. Raises AsError E1071 (/ERR) if the signal is there before.
    """
    hardware = task.hardware
    number = hardware.signals.existing(signal)
    ticket = offer(task, goal_request(task, "linear", goal))
    before: bool | None = None  # the signal a tick ago, while the arm moves to p
    braked = False

    def ends(_: int) -> bool:
        nonlocal before, braked
        if braked or ticket.state != "under way":
            return ticket.state != "waiting" and not (braked and hardware.robot.moving)
        now = hardware.signals.holds(number)
        if before is None and now and "/ERR" in words:
            hardware.interrupt_motion()
            raise AsError("E1071", f"signal {number}")
        if now and not (before or (before is None and "/LVL" not in words)):
            hardware.interrupt_motion()
            braked = True
        before = now
        return False

    return until(ends)


def align(task: Task) -> Wait | None:
    """ALIGN: turn the tool about the TCP until its Z is parallel to the nearest base axis."""
    T = task.hardware.robot.start_of_next()
    z = T.rotation[:, 2]
    axis = np.zeros(3)
    nearest = int(np.abs(z).argmax())
    axis[nearest] = np.copysign(1.0, z[nearest])
    turn = pin.Quaternion.FromTwoVectors(z, axis).toRotationMatrix()
    return queue_motions(task, request(task, "linear", T=pin.SE3(turn @ T.rotation, T.translation)))


def monitor_speed(task: Task, value: float) -> None:
    """MON_SPEED %: the monitor speed; here also of the motion that is under way."""
    task.hardware.robot.queue.monitor_fraction = percent(value, "MON_SPEED") / 100.0


# --- clamps ---------------------------------------------------------------------------------------


def at_next_motion(state: ClampState, task: Task, number: float = 1.0) -> None:
    """OPEN, CLOSE, RELAX n: when the next motion starts."""
    task.hardware.at_next_motion.append(_acts(task, state, number))


def after_motion(state: ClampState, task: Task, number: float = 1.0) -> Wait | None:
    """OPENI, CLOSEI, RELAXI n: when the arm is at rest; they break CP."""
    act = _acts(task, state, number)
    return at_rest(task, lambda _: act())


def at_once(state: ClampState, task: Task, number: float = 1.0) -> None:
    """OPENS, CLOSES, RELAXS n: at once."""
    _acts(task, state, number)()


def clamp(task: Task, *numbers: float) -> None:
    """CLAMP n,..: when the motion ends; a positive number opens, a negative one closes."""
    hardware = task.hardware
    for number in numbers:
        act = _acts(task, "open" if number > 0 else "closed", abs(number))
        hardware.when(lambda: not hardware.robot.moving, act)


def _acts(task: Task, state: ClampState, number: float) -> Callable[[], None]:
    """Return the action on a clamp. Raises AsError E1075 for its number."""
    return partial(task.hardware.set_clamp, task.hardware.clamp(number), state)


_OfRobot = partial(Action, only="robot")
_CLAMPS: dict[str, ClampState] = {"OPEN": "open", "CLOSE": "closed", "RELAX": "off"}

INSTRUCTIONS = {
    "C1MOVE": _OfRobot(c1move, "pn"),
    "C2MOVE": _OfRobot(c2move, "pn"),
    "XMOVE": _OfRobot(xmove, "pmr"),
    "ALIGN": _OfRobot(align),
    "MON_SPEED": Action(monitor_speed, "r"),
    "CLAMP": Action(clamp, "r*"),
    **{word: Action(partial(at_next_motion, state), "r") for word, state in _CLAMPS.items()},
    **{f"{word}I": Action(partial(after_motion, state), "r") for word, state in _CLAMPS.items()},
    **{f"{word}S": Action(partial(at_once, state), "r") for word, state in _CLAMPS.items()},
}
