"""Interface from the language to the machine: robot, signals and tasks.

`MachineInterface` implements it; expressions use nothing else. Lengths in mm, angles in degrees.
"""

from collections.abc import Callable
from typing import Protocol, TypeVar

from sim.as_language.memory import Locals, Namespace
from sim.as_language.values import Joints, Pose, Transformation, Value


class MachineInterface(Protocol):
    """Controller as seen by the language.

    Methods raise `AsError` as AS does: `base` and `tool` in a PC program, numbers of signals and
    timers out of range (E0106).
    """

    # --- the arm ----------------------------------------------------------------------------------

    def here(self) -> Transformation:
        """Return the current pose of the TCP in the BASE frame, from the encoders (HERE)."""

    def here_joints(self) -> Joints:
        """Return the current joint values (#HERE)."""

    def destination(self) -> Transformation:
        """Return the destination of the current motion (DEST)."""

    def destination_joints(self) -> Joints:
        """Return the destination of the current motion as joint values (#DEST)."""

    def home_joints(self, number: int) -> Joints:
        """Return home position 1 or 2 (#HOME)."""

    def base(self) -> Transformation:
        """Return the BASE frame in the robot's base frame (BASE)."""

    def tool(self) -> Transformation:
        """Return the TOOL frame in the flange frame (TOOL)."""

    def transformation_of(self, joints: Joints) -> Transformation:
        """Return the TCP pose in BASE for joint values (forward kinematics)."""

    def joints_of(self, place: Transformation, configuration: Joints | None = None) -> Joints:
        """Return joint values for a TCP pose; E6007 or E6008 if there is no solution."""

    def in_range(self, place: Pose, configuration: Joints | None = None) -> int:
        """Return INRANGE's mask: 1, 2, 4, 8, 16, 32 for the joints, 32768 out of reach."""

    def monitor_speed_percent(self) -> float:
        """Return the monitor speed (MSPEED)."""

    def motor_current_A(self, joint: int) -> float:
        """Return the motor current of joint 1 to 6 (IQARM)."""

    def motor_torque_Nm(self, joint: int) -> float:
        """Return the torque of joint 1 to 6 (TRQNM)."""

    # --- signals, switches, tasks, time -----------------------------------------------------------

    def signal(self, number: int) -> bool:
        """Return whether signal `number` (> 0) is on (SIG, BITS)."""

    def switch(self, name: str) -> bool:
        """Return whether a switch is on; P0116 for an unknown one. The name is lower case."""

    def task_state(self, number: int) -> int:
        """Return TASK: 0 not running, 1 running, 2 held, 3 waiting for the end of a motion."""

    def task_of(self, name: str) -> int:
        """Return WHICHTASK: the number of the task that is in a program (lower case), or -1."""

    def error_number(self) -> int:
        """Return ERROR: 0, or -3xxxx for Exxxx and so on (`AsError.number`)."""

    def timer_s(self, number: int) -> float:
        """Return TIMER 0 to 10 [s]; TIMER 0 is the time since the controller started."""

    def user_timer_s(self, zero_ms: float) -> float:
        """Return UTIMER [s], of an integer variable that the instruction UTIMER has set."""

    def system_number(self, keyword: str, first: int, second: int) -> float:
        """Return SYSDATA of a keyword (lower case); P0116 for an unknown one."""

    def system_text(self, keyword: str) -> str:
        """Return $SYSDATA of a keyword (lower case); P0116 for an unknown one."""

    def random(self) -> float:
        """Return a number in [0, 1) (RANDOM)."""

    def date(self) -> str:
        """Return $DATE."""

    def time(self) -> str:
        """Return $TIME."""

    def time_ms(self) -> str:
        """Return $TIME_MS."""

    def has_program(self, name: str) -> bool:
        """Return whether a program of that name (lower case) is loaded (EXISTPGM)."""


class EvaluationContext(Protocol):
    """Evaluation context of an expression: task variables and machine."""

    @property
    def locals(self) -> Locals:
        """The local variables of the running program."""

    @property
    def globals(self) -> Namespace:
        """The global variables."""

    @property
    def machine(self) -> MachineInterface:
        """The controller that executes the task."""


T = TypeVar("T")
ReadOf = Callable[[EvaluationContext], T]
"""Reader of a value of one type: a compiled expression."""
Read = ReadOf[Value]
