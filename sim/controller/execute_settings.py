"""Motion settings: SPEED, ACCURACY, ACCEL, DECEL, BREAK, BRAKE, MVWAIT, BASE, TOOL, postures."""

from collections.abc import Callable

from sim.as_language.errors import AsError
from sim.as_language.syntax import Instruction
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.execute_motion import refuse_outside_robot_program
from sim.controller.speeds import checked, percent, speed_of
from sim.controller.task import Task

_LONGEST_ACCURACY_MM = 5000.0


def compile_speed(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile SPEED v [unit] [ALWAYS]."""
    if len(statement.arguments) > 1:
        return _refused("a rotational SPEED is an option of the controller")
    value, modifiers = evaluate.argument(statement, 0), statement.modifiers
    return _setting(at, "speed", lambda task: speed_of(value(task), modifiers), always=modifiers)


def compile_accuracy(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile ACCURACY mm [ALWAYS] [FINE]."""
    value = evaluate.argument(statement, 0)

    def accuracy_m(task: Task) -> float:
        return checked(value(task), 0.01, _LONGEST_ACCURACY_MM, "ACCURACY") * 1e-3

    return _setting(at, "accuracy_m", accuracy_m, always=statement.modifiers)


def compile_ramp(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile ACCEL % [ALWAYS] and DECEL % [ALWAYS]."""
    value, name = evaluate.argument(statement, 0), statement.name
    field = "accel_fraction" if name == "ACCEL" else "decel_fraction"

    def fraction(task: Task) -> float:
        return percent(value(task), name) / 100.0

    return _setting(at, field, fraction, always=statement.modifiers)


def compile_break(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile BREAK: wait until the motion has ended and the arm is at rest."""
    return when_at_rest(at, _nothing)


def compile_posture(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile LEFTY, RIGHTY, ABOVE, BELOW, UWRIST, DWRIST: they only break CP.

    The inverse kinematics stays on the current branch of the arm.
    """
    return when_at_rest(at, _nothing)


def compile_weight(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile WEIGHT kg,x,y,z,..: checked, but without effect on the simulated servos."""
    numbers = [evaluate.argument(statement, k) for k in range(len(statement.arguments))]

    def run(task: Task) -> int:
        checked(numbers[0](task), 0.0, 1000.0, "WEIGHT")
        return at + 1

    return run


def compile_brake(_: Instruction, at: int, __: ArgumentCompiler) -> Op:
    """Compile BRAKE: stop at once. Only the robot program waits for standstill."""
    still = when_at_rest(at, _nothing)

    def run(task: Task) -> int:
        task.machine.brake()
        return still(task) if task.is_robot else at + 1

    return run


def compile_mvwait(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile MVWAIT mm: wait until the remaining distance is at most this."""
    if "S" in statement.modifiers:
        return _refused("MVWAIT with seconds; give the distance in mm")
    left_mm = evaluate.argument(statement, 0)

    def run(task: Task) -> int:
        refuse_outside_robot_program(task)
        left_m = checked(left_mm(task), 0.0, 1e5, "MVWAIT") * 1e-3
        queue = task.machine.robot.queue
        task.wait(lambda _: queue.remaining_m() <= left_m)
        return at + 1

    return run


def compile_frame(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile BASE t and TOOL t; without t the frame is cleared. Both break CP."""
    name = statement.name
    argument = statement.arguments[0] if statement.arguments else None
    pose = evaluate.pose_or_null(argument)

    def apply(task: Task) -> None:
        task.machine.set_frame(name, pose(task))

    still = when_at_rest(at, apply)

    def run(task: Task) -> int:
        refuse_outside_robot_program(task)
        return still(task)

    return run


def when_at_rest(at: int, action: Callable[[Task], None]) -> Op:
    """Return an operation that acts as soon as the arm is at rest and no motion is active."""

    def run(task: Task) -> int:
        robot = task.machine.robot
        if not robot.moving:
            action(task)
            return at + 1

        def condition(_: int) -> bool:
            if robot.moving:
                return False
            action(task)
            return True

        task.wait(condition)
        return at + 1

    return run


def _nothing(_: Task) -> None:
    """Do nothing."""


def _setting(
    at: int,
    field: str,
    value: Callable[[Task], object],
    *,
    always: tuple[str, ...],
) -> Op:
    for_good = "ALWAYS" in always

    def run(task: Task) -> int:
        refuse_outside_robot_program(task)
        task.machine.settings.change(field, value(task), always=for_good)
        return at + 1

    return run


def _refused(reason: str) -> Op:
    def run(_: Task) -> int:
        raise AsError("E0111", reason)

    return run
