"""What the language asks of the machine that runs it: the robot, its signals and its tasks.

The machine implements this; expressions never reach past it. Lengths in mm, angles in degrees.
"""

from typing import Protocol

from sim.controller.memory import Locals, Names
from sim.controller.values import Joints, Pose, Transformation


class Machine(Protocol):
    """The controller around the language.

    A method raises `AsError` where AS does: `base` and `tool` in a PC program, numbers of signals
    and timers out of range (E0106).
    """

    # --- the arm ----------------------------------------------------------------------------------

    def here(self) -> Transformation:
        """Return the pose of the TCP in the BASE frame, from the encoders now (HERE)."""

    def here_joints(self) -> Joints:
        """Return the joint values now (#HERE)."""

    def destination(self) -> Transformation:
        """Return the destination of the current motion (DEST)."""

    def destination_joints(self) -> Joints:
        """Return the same as joint values (#DEST)."""

    def home_joints(self, number: int) -> Joints:
        """Return home position 1 or 2 (#HOME)."""

    def base(self) -> Transformation:
        """Return the BASE frame in the robot's base frame (BASE)."""

    def tool(self) -> Transformation:
        """Return the TOOL frame in the flange frame (TOOL)."""

    def transformation_of(self, joints: Joints) -> Transformation:
        """Return the TCP pose in BASE for joint values: where a joint value becomes a pose."""

    def joints_of(self, place: Transformation, configuration: Joints | None = None) -> Joints:
        """Return joint values for a TCP pose; E6007 or E6008 if there are none."""

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
        """Return TASK: 0 not running, 1 running, 2 held, 3 waits for the end of a motion."""

    def error_number(self) -> int:
        """Return ERROR: 0, or -3xxxx for Exxxx and so on (`errors.number_of`)."""

    def timer_s(self, number: int) -> float:
        """Return TIMER 0 to 10 [s]; 0 is the time since the controller started."""

    def random(self) -> float:
        """Return a number from 0 up to, but not including, 1 (RANDOM)."""

    def date(self) -> str:
        """Return $DATE."""

    def time(self) -> str:
        """Return $TIME."""

    def has_program(self, name: str) -> bool:
        """Return whether a program of that name (lower case) is loaded (EXISTPGM)."""


class Context(Protocol):
    """Who evaluates an expression: the task, with its variables and its machine."""

    @property
    def locals(self) -> Locals:
        """The local variables of the program that runs now."""

    @property
    def globals(self) -> Names:
        """The variables that all tasks share."""

    @property
    def machine(self) -> Machine:
        """The controller that it runs on."""
