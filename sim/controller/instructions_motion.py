"""Motion instructions: target, motion parameters, and one motion ahead; BREAK, BRAKE, frames."""

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from sim.as_language.errors import AsError
from sim.as_language.values import Joints, Pose, Transformation, se3_of
from sim.controller.hardware import ClampState, Hardware
from sim.controller.instruction import Action, at_rest, until
from sim.controller.motion_queue import Ticket
from sim.controller.motion_requests import (
    MotionRequest,
    ProgramSpeed,
    checked,
    percent,
    speed_of,
)
from sim.controller.tasks import Task, Wait

Words = tuple[str, ...]
MotionKind = Literal["linear", "joint", "pause"]
_LONGEST_ACCURACY_MM = 5000.0


def move(kind: MotionKind, task: Task, goal: Pose, clamp: float | None = None) -> Wait | None:
    """LMOVE p[,clamp], JMOVE p[,clamp] and HMOVE p[,clamp] (as LMOVE)."""
    return queue_motions(task, goal_request(task, kind, goal), clamp=clamp)


def approach(kind: MotionKind, task: Task, goal: Pose, distance_mm: float) -> Wait | None:
    """LAPPRO p,d and JAPPRO p,d: d [mm] before p, along its -Z."""
    if isinstance(goal, Joints):
        T = task.hardware.robot.pose_of(np.radians(goal.values))
    else:
        T = se3_of(goal)
    return queue_motions(task, request(task, kind, T=T * _translation_z(-distance_mm)))


def depart(kind: MotionKind, task: Task, distance_mm: float) -> Wait | None:
    """LDEPART d and JDEPART d: d [mm] back along the tool's -Z."""
    T = task.hardware.robot.start_of_next()
    return queue_motions(task, request(task, kind, T=T * _translation_z(-distance_mm)))


def home(task: Task, number: float = 1.0) -> Wait | None:
    """HOME and HOME n: a joint motion to #HOME; the second home is the same as the first."""
    checked(number, 1, 2, "HOME")
    return queue_motions(task, request(task, "joint", q=task.hardware.robot.arm.settings.home_rad))


def drive(task: Task, joint: float, angle_deg: float, speed: float = 100.0) -> Wait | None:
    """DRIVE jt,deg[,speed]: one joint, relative; the speed is a % of monitor speed."""
    q = task.hardware.robot.queue.q_newest.copy()
    number = int(checked(joint, 1, len(q), "the joint of DRIVE"))
    q[number - 1] += np.radians(angle_deg)
    own = ProgramSpeed(percent(speed, "the speed of DRIVE"))
    return queue_motions(task, request(task, "joint", q=q, speed=own))


def draw(axes: str, task: Task, words: Words, *numbers: float | None) -> Wait | None:
    """DRAW (base axes) and TDRAW (tool axes): dx,dy,dz,rx,ry,rz,speed, linear, relative.

    The rotation is Rx Ry Rz; with DRAW it is about the base axes through the TCP.
    """
    x, y, z, rx, ry, rz, speed = (*numbers, *(None,) * 7)[:7]
    rotation = _rotation("x", rx) @ _rotation("y", ry) @ _rotation("z", rz)
    travel = np.array([x or 0.0, y or 0.0, z or 0.0]) * 1e-3
    T = task.hardware.robot.start_of_next()
    if axes == "tool":
        goal = T * pin.SE3(rotation, travel)
    else:
        goal = pin.SE3(rotation @ T.rotation, T.translation + travel)
    own = None if speed is None else speed_of(speed, words)
    return queue_motions(task, request(task, "linear", T=goal, speed=own))


def pause(name: str, task: Task, duration_s: float) -> Wait | None:
    """DELAY s and STABLE s: the arm dwells, then the next motion starts."""
    pause_s = checked(duration_s, 0.0, 3600.0, name)
    return queue_motions(task, request(task, "pause", pause_s=pause_s))


def speed(task: Task, value: float, words: Words, *more: float | None) -> None:
    """SPEED v [unit] [ALWAYS]. Raises AsError E0111 for a second, rotational speed."""
    if more:
        raise AsError("E0111", "a rotational SPEED is an option of the controller")
    _set(task, "speed", speed_of(value, words), words)


def accuracy(task: Task, value_mm: float, words: Words) -> None:
    """ACCURACY mm [ALWAYS] [FINE]."""
    accuracy_m = checked(value_mm, 0.0, _LONGEST_ACCURACY_MM, "ACCURACY") * 1e-3
    _set(task, "accuracy_m", accuracy_m, words)


def ramp(name: str, task: Task, value: float, words: Words) -> None:
    """ACCEL % [ALWAYS] and DECEL % [ALWAYS]."""
    _set(task, f"{name.lower()}_fraction", percent(value, name) / 100.0, words)


def brake(task: Task) -> Wait | None:
    """BRAKE: stop at once. Only the robot program waits for standstill."""
    hardware = task.hardware
    hardware.interrupt_motion(keep_ahead=hardware.behaviour.brake_keeps_prefetched)
    return at_rest(task) if task.is_robot else None


def mvwait(task: Task, left_mm: float, words: Words) -> Wait:
    """MVWAIT mm: wait until the remaining distance is at most this."""
    if "S" in words:
        raise AsError("E0111", "MVWAIT with seconds; give the distance in mm")
    left_m = checked(left_mm, 0.0, 1e5, "MVWAIT") * 1e-3
    queue = task.hardware.robot.queue
    return lambda _: queue.remaining_m() <= left_m


def frame(
    name: str, task: Task, place: Callable[[Task], Transformation] = lambda _: Transformation()
) -> Wait | None:
    """BASE t and TOOL t; without t the frame is cleared. Both break CP."""

    def apply(task: Task) -> None:
        T, robot = se3_of(place(task)), task.hardware.robot
        if name == "BASE":
            robot.T_base_shift = T
        else:
            robot.T_flange_tcp = T

    return at_rest(task, apply)


def accept(name: str, most: float, _: Task, value: float) -> None:
    """WEIGHT kg,.. and LOCK p: checked, but without effect: rigid servos, one robot program."""
    checked(value, 0, most, name)


def _set(task: Task, field: str, value: object, words: Words) -> None:
    task.hardware.motion_settings.change(field, value, always="ALWAYS" in words)


def request(
    task: Task,
    kind: MotionKind,
    *,
    q: Array | None = None,
    T: pin.SE3 | None = None,
    speed: ProgramSpeed | None = None,
    pause_s: float = 0.0,
    of_arc: bool = False,
) -> MotionRequest:
    """Return a motion to joint angles [rad] or a TOOL pose in BASE, with the program's settings.

    Its own speed does not use up SPEED. Raises AsError E1097 if a C1MOVE waits for the next point
    of its arc and this is none.
    """
    hardware = task.hardware
    if hardware.arc is not None and not of_arc:
        hardware.arc = None
        raise AsError("E1097", "C1MOVE must be followed by C1MOVE or C2MOVE")
    hardware.motion_step = task.step_index + 1
    manner = hardware.motion_settings.take(hardware.robot.T_flange_tcp, speed)
    T_base_tcp = None if T is None else hardware.robot.T_base_shift * T
    return MotionRequest(kind, manner, T_base_tcp=T_base_tcp, q=q, pause_s=pause_s)


def goal_request(
    task: Task, kind: MotionKind, goal: Pose, *, of_arc: bool = False
) -> MotionRequest:
    """Return a motion to a location of a program. Raises AsError E1097 as `request`."""
    if isinstance(goal, Joints):
        return request(task, kind, q=np.radians(goal.values), of_arc=of_arc)
    return request(task, kind, T=se3_of(goal), of_arc=of_arc)


def offer(task: Task, motion: MotionRequest) -> Ticket:
    """Queue a motion; OPEN and CLOSE before it act when it starts."""
    hardware = task.hardware
    ticket = hardware.move(motion)
    actions, hardware.at_next_motion = hardware.at_next_motion, []
    for action in actions:
        hardware.when(lambda: ticket.state != "waiting", action)
    return ticket


def queue_motions(task: Task, *motions: MotionRequest, clamp: float | None = None) -> Wait | None:
    """Queue motions; wait until the queue has room again. The clamp acts at the end of the last."""
    hardware = task.hardware
    number = None if clamp is None else hardware.clamp(abs(clamp))
    ticket = [offer(task, motion) for motion in motions][-1]
    if number is not None and clamp is not None:
        clamp_at_end(hardware, ticket, number, "closed" if clamp > 0 else "open")
    queue = hardware.robot.queue
    return until(lambda _: ticket.state != "waiting" or not queue.is_full)


def clamp_at_end(hardware: Hardware, ticket: Ticket, number: int, state: ClampState) -> None:
    """Set a clamp when a motion has ended, unless it was dropped."""

    def act() -> None:
        if ticket.state == "finished":
            hardware.set_clamp(number, state)

    hardware.when(lambda: ticket.state in ("finished", "dropped"), act)


def _translation_z(distance_mm: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, distance_mm * 1e-3]))


def _rotation(axis: str, angle_deg: float | None) -> Array:
    return np.asarray(pin.utils.rotate(axis, float(np.radians(angle_deg or 0.0))))


_OfRobot = partial(Action, only="robot")
_POSTURES = ("LEFTY", "RIGHTY", "ABOVE", "BELOW", "UWRIST", "DWRIST")

INSTRUCTIONS = {
    "LMOVE": _OfRobot(partial(move, "linear"), "pn"),
    "HMOVE": _OfRobot(partial(move, "linear"), "pn"),
    "JMOVE": _OfRobot(partial(move, "joint"), "pn"),
    "LAPPRO": _OfRobot(partial(approach, "linear"), "pr"),
    "JAPPRO": _OfRobot(partial(approach, "joint"), "pr"),
    "LDEPART": _OfRobot(partial(depart, "linear"), "r"),
    "JDEPART": _OfRobot(partial(depart, "joint"), "r"),
    "HOME": _OfRobot(home, "r"),
    "DRIVE": _OfRobot(drive, "rrr"),
    "DRAW": _OfRobot(partial(draw, "base"), "mn*"),
    "TDRAW": _OfRobot(partial(draw, "tool"), "mn*"),
    "DELAY": _OfRobot(partial(pause, "DELAY"), "r"),
    "STABLE": _OfRobot(partial(pause, "STABLE"), "r"),
    "SPEED": _OfRobot(speed, "rmn*"),
    "ACCURACY": _OfRobot(accuracy, "rm"),
    "ACCEL": _OfRobot(partial(ramp, "ACCEL"), "rm"),
    "DECEL": _OfRobot(partial(ramp, "DECEL"), "rm"),
    "BREAK": Action(at_rest),
    "BRAKE": Action(brake),
    "MVWAIT": _OfRobot(mvwait, "rm"),
    "BASE": _OfRobot(partial(frame, "BASE"), "P"),
    "TOOL": _OfRobot(partial(frame, "TOOL"), "P"),
    "WEIGHT": Action(partial(accept, "WEIGHT", 1000.0), "r"),
    "LOCK": Action(partial(accept, "LOCK", 127), "r"),
    # They only break CP: the inverse kinematics stays on the branch of the arm.
    **dict.fromkeys(_POSTURES, Action(at_rest)),
}
