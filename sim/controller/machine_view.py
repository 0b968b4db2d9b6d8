"""The controller as the expressions of one task see it: position, signals, switches, time."""

import numpy as np

from common.motion.frames import Array
from sim.as_language.errors import AsError
from sim.as_language.values import (
    Joints,
    Pose,
    Transformation,
    joints,
    se3_of,
    transformation_of,
)
from sim.controller.hardware import TIMERS
from sim.controller.motion_requests import checked
from sim.controller.planner import reach_error
from sim.controller.tasks import PC_PROGRAMS, ROBOT, Task

OUT_OF_REACH = 32768
_TASK_STATES = {"idle": 0, "running": 1, "held": 2, "stopped": 2, "ending": 3}


class MachineView:
    """Implements `MachineInterface` for a task."""

    def __init__(self, task: Task) -> None:
        """Start with the task's controller."""
        self._task, self._control = task, task.control
        self._hardware, self._robot = task.hardware, task.hardware.robot

    # --- the arm ----------------------------------------------------------------------------------

    def here(self) -> Transformation:
        """HERE."""
        return transformation_of(self._robot.here())

    def here_joints(self) -> Joints:
        """#HERE."""
        return _degrees(self._robot.q)

    def destination(self) -> Transformation:
        """DEST."""
        return transformation_of(self._robot.destination())

    def destination_joints(self) -> Joints:
        """#DEST."""
        return _degrees(self._robot.q_destination())

    def home_joints(self, number: float) -> Joints:
        """#HOME; the second home is the same as the first. Raises AsError E0106."""
        checked(number, 1, 2, "HOME")
        return _degrees(self._robot.arm.settings.home_rad)

    def base(self) -> Transformation:
        """BASE. Raises AsError in a PC program."""
        self._refuse_pc("BASE")
        return transformation_of(self._robot.T_base_shift)

    def tool(self) -> Transformation:
        """TOOL. Raises AsError in a PC program."""
        self._refuse_pc("TOOL")
        return transformation_of(self._robot.T_flange_tcp)

    def transformation_of(self, values: Joints) -> Transformation:
        """Return the TOOL's pose in BASE for joint values."""
        return transformation_of(self._robot.pose_of(np.radians(values.values)))

    def joints_of(self, place: Transformation, configuration: Joints | None = None) -> Joints:
        """Return joint values for a pose. Raises AsError E6007, E6008, E6016."""
        near = self._robot.q_destination()
        if configuration is not None:
            near = np.radians(configuration.values)
        result = self._robot.joints_of(se3_of(place), near)
        if result.q is None:
            raise reach_error(result.reason)
        return _degrees(result.q)

    def in_range(self, place: Pose, configuration: Joints | None = None) -> int:
        """INRANGE: one bit per joint outside its limits, 32768 out of reach."""
        if isinstance(place, Transformation):
            try:
                place = self.joints_of(place, configuration)
            except AsError:
                return OUT_OF_REACH
        q, arm = np.radians(place.values), self._robot.kinematics
        beyond = (q < arm.lower_rad) | (q > arm.upper_rad)
        return sum(1 << k for k in range(arm.joints) if beyond[k])

    def monitor_speed_percent(self) -> float:
        """MSPEED."""
        return 100.0 * self._robot.queue.monitor_fraction

    def motor_torque_Nm(self, joint: int) -> float:
        """TRQNM: torque of the simulated servo. Raises AsError E0106."""
        number = int(checked(joint, 1, self._robot.kinematics.joints, "the joint"))
        return float(self._robot.arm.data.actuator_force[number - 1])

    def motor_current_A(self, joint: int) -> float:
        """IQARM: torque over a torque constant of 1 Nm/A; the real constants are not public."""
        return self.motor_torque_Nm(joint)

    # --- signals, switches, tasks, time -----------------------------------------------------------

    def signal(self, number: int) -> bool:
        """SIG of one signal. Raises AsError E0106."""
        signals = self._hardware.signals
        return signals.holds(signals.existing(number))

    def switch(self, name: str) -> bool:
        """SWITCH. Raises AsError P0116."""
        if name in self._control.reports:
            return self._control.reports[name]()
        if name not in self._hardware.switches:
            raise AsError("P0116", f"there is no switch {name.upper()}")
        return self._hardware.switches[name]

    def task_state(self, number: int) -> int:
        """TASK. Raises AsError E0106."""
        if number != ROBOT and number not in PC_PROGRAMS:
            raise AsError("E0106", f"TASK({number}): 1 is the robot program, 1001 to 1005 are PC")
        states = {task.number: task.state for task in self._control.tasks}
        return _TASK_STATES[states[number]]

    def error_number(self) -> int:
        """ERROR: of the step that a ONE program handles, otherwise the one pending ERESET."""
        for frame in reversed(self._task.frames):
            if frame.handles is not None:
                return frame.handles.number
        return 0 if self._control.error is None else self._control.error.error.number

    def timer_s(self, number: int) -> float:
        """TIMER. Raises AsError E0106."""
        return self._hardware.timer_s(int(checked(number, 0, TIMERS[-1], "the number of TIMER")))

    def random(self) -> float:
        """RANDOM: the same sequence in every run."""
        return self._hardware.random.random()

    def date(self) -> str:
        """$DATE: a fixed date, for repeatable runs."""
        return "26/01/01"

    def time(self) -> str:
        """$TIME: since power-on."""
        seconds = int(self._hardware.timer_s(0))
        return f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"

    def has_program(self, name: str) -> bool:
        """EXISTPGM."""
        return name in self._control.programs

    def _refuse_pc(self, name: str) -> None:
        if not self._task.is_robot:
            raise AsError("E1095", f"{name} is not allowed in PC programs")


def _degrees(q: Array) -> Joints:
    return joints(*np.degrees(q))
