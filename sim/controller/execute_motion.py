"""Motion instructions: target, motion parameters, and one motion ahead."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from common.motion.kinematics import JOINTS
from sim.as_language.errors import AsError
from sim.as_language.syntax import Instruction
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler, Target
from sim.controller.motion_requests import MotionRequest, ProgramSpeed
from sim.controller.speeds import checked, percent, speed_of
from sim.controller.task import Task

Kind = Literal["linear", "joint"]
Make = Callable[[Task], MotionRequest]
_KINDS: dict[str, Kind] = {"L": "linear", "J": "joint", "H": "linear"}


def compile_move(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile LMOVE p, JMOVE p and HMOVE p (as LMOVE)."""
    kind, target = _KINDS[statement.name[0]], evaluate.target(statement.arguments[0])
    return _handed_over(lambda task: _motion(task, kind, target(task)), at)


def compile_approach(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile LAPPRO p,d and JAPPRO p,d: d [mm] before p, along its -Z."""
    kind, target = _KINDS[statement.name[0]], evaluate.target(statement.arguments[0])
    distance_mm = evaluate.argument(statement, 1)

    def make(task: Task) -> MotionRequest:
        goal = target(task)
        T = goal.T if goal.T is not None else task.machine.robot.pose_of(_joints(goal))
        return _motion(task, kind, Target(T=T * _translation_z(-distance_mm(task))))

    return _handed_over(make, at)


def compile_depart(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile LDEPART d and JDEPART d: d [mm] back along the tool's -Z."""
    kind = _KINDS[statement.name[0]]
    distance_mm = evaluate.argument(statement, 0)

    def make(task: Task) -> MotionRequest:
        T = task.machine.robot.destination()
        return _motion(task, kind, Target(T=T * _translation_z(-distance_mm(task))))

    return _handed_over(make, at)


def compile_home(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile HOME and HOME n: a joint motion to #HOME."""
    number = evaluate.argument(statement, 0, 1.0)

    def make(task: Task) -> MotionRequest:
        q = task.machine.home_rad(checked(number(task), 1, 2, "HOME"))
        return _motion(task, "joint", Target(q=q))

    return _handed_over(make, at)


def compile_drive(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile DRIVE jt,deg[,speed]: one joint, relative; the speed is a % of monitor speed."""
    joint = evaluate.argument(statement, 0)
    angle_deg = evaluate.argument(statement, 1)
    speed = evaluate.argument(statement, 2, 100.0)

    def make(task: Task) -> MotionRequest:
        number = int(checked(joint(task), 1, JOINTS, "the joint of DRIVE"))
        q = task.machine.robot.q_destination().copy()
        q[number - 1] += np.radians(angle_deg(task))
        value = ProgramSpeed(percent(speed(task), "the speed of DRIVE"))
        return _motion(task, "joint", Target(q=q), speed=value)

    return _handed_over(make, at)


def compile_draw(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile DRAW (base axes) and TDRAW (tool axes): dx,dy,dz,rx,ry,rz,speed, linear, relative.

    The rotation is Rx Ry Rz; with DRAW it is about the base axes through the TCP.
    """
    numbers = [evaluate.argument(statement, k, 0.0) for k in range(6)]
    has_speed = len(statement.arguments) > 6 and statement.arguments[6] is not None
    speed = evaluate.argument(statement, 6, 100.0)
    in_tool = statement.name == "TDRAW"

    def make(task: Task) -> MotionRequest:
        x, y, z, rx, ry, rz = (number(task) for number in numbers)
        rotation = _rotation("x", rx) @ _rotation("y", ry) @ _rotation("z", rz)
        travel = np.array([x, y, z]) * 1e-3
        T = task.machine.robot.destination()
        goal = T * pin.SE3(rotation, travel)
        if not in_tool:
            goal = pin.SE3(rotation @ T.rotation, T.translation + travel)
        value = speed_of(speed(task), statement.modifiers) if has_speed else None
        return _motion(task, "linear", Target(T=goal), speed=value)

    return _handed_over(make, at)


def compile_pause(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile DELAY s and STABLE s: the arm dwells, then the next motion starts."""
    duration_s = evaluate.argument(statement, 0)

    def make(task: Task) -> MotionRequest:
        pause_s = checked(duration_s(task), 0.0, 3600.0, statement.name)
        return MotionRequest("pause", task.machine.manner(), pause_s=pause_s)

    return _handed_over(make, at)


def _handed_over(make: Make, at: int) -> Op:
    """Queue the motion and wait at the step until it starts: one motion ahead."""

    def run(task: Task) -> int:
        refuse_outside_robot_program(task)
        ticket = task.machine.move(make(task))
        if ticket.state == "waiting":
            task.wait(lambda _: ticket.state != "waiting")
        return at + 1

    return run


def refuse_outside_robot_program(task: Task) -> None:
    """Raise AsError E1095 in a PC program, P0111 in an error handler."""
    if not task.is_robot:
        raise AsError("E1095")
    if any(frame.handles is not None for frame in task.frames):
        raise AsError("P0111", "no motion in a program that ONE calls")


def _motion(
    task: Task, kind: Kind, target: Target, *, speed: ProgramSpeed | None = None
) -> MotionRequest:
    machine = task.machine
    manner = machine.manner(speed)
    if target.q is not None:
        return MotionRequest(kind, manner, q=target.q)
    return MotionRequest(kind, manner, T_base_tcp=machine.robot.in_robot_base(target.T))


def _joints(target: Target) -> Array:
    assert target.q is not None  # noqa: S101 - a target is one or the other
    return target.q


def _translation_z(distance_mm: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, distance_mm * 1e-3]))


def _rotation(axis: str, angle_deg: float) -> Array:
    return np.asarray(pin.utils.rotate(axis, float(np.radians(angle_deg))))
