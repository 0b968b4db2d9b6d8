"""Emulated controller: loads programs, implements the machine interface, advances time."""

import random

import numpy as np

from common.motion.kinematics import JOINTS
from sim.as_language.errors import AsError
from sim.as_language.memory import Memory
from sim.as_language.syntax import SourceFile
from sim.as_language.values import Joints, Pose, Transformation, joints, se3_of, transformation_of
from sim.controller.compile import compile_file
from sim.controller.pendant import Pendant
from sim.controller.planner import reach_error
from sim.controller.program_control import ProgramControl
from sim.controller.speeds import checked
from sim.controller.task import PC_PROGRAMS, ROBOT
from sim.controller.timers import TIMERS

OUT_OF_REACH = 32768
_TASK_STATES = {"idle": 0, "running": 1, "held": 2, "stopped": 2, "ending": 3}


class Machine(ProgramControl):
    """Complete emulated controller; implements `machine_api.Machine`. Arguments as for `Parts`."""

    def __init__(self, *args: object, **kwargs: object) -> None:
        """Power on."""
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]
        self.memory = Memory()
        self.pendant = Pendant(self)
        self._random = random.Random(1)  # noqa: S311 - a controller's RANDOM, the same every time
        for task in self.tasks:
            task.machine, task.globals = self, self.memory.globals

    def load(self, source: SourceFile) -> None:
        """LOAD: add the programs and data of a file; a program of the same name is replaced.

        Raises AsError P1014 if a program to be replaced is running.
        """
        for task in self.tasks:
            for frame in task.frames:
                if frame.program.name in source.programs:
                    raise AsError("P1014", f"{frame.program.name} is running")
        self.programs = {**self.programs, **compile_file(source)}
        self.memory.fill(source.data)

    def advance(self, until_ns: int) -> None:
        """Advance time in lock step up to `until_ns`."""
        self.scheduler.advance(until_ns)

    # --- machine_api: the arm ---------------------------------------------------------------------

    def destination(self) -> Transformation:
        """DEST."""
        return transformation_of(self.robot.destination())

    def destination_joints(self) -> Joints:
        """#DEST."""
        return joints(*np.degrees(self.robot.q_destination()))

    def home_joints(self, number: int) -> Joints:
        """#HOME. Raises AsError E0106."""
        return joints(*np.degrees(self.home_rad(checked(number, 1, 2, "HOME"))))

    def base(self) -> Transformation:
        """BASE. Raises AsError in a PC program."""
        self._refuse_pc("BASE")
        return transformation_of(self.robot.T_base_shift)

    def tool(self) -> Transformation:
        """TOOL. Raises AsError in a PC program."""
        self._refuse_pc("TOOL")
        return transformation_of(self.robot.T_flange_tcp)

    def transformation_of(self, values: Joints) -> Transformation:
        """Return the TOOL's pose in BASE for joint values."""
        return self.transformation_at(np.radians(values.values))

    def joints_of(self, place: Transformation, configuration: Joints | None = None) -> Joints:
        """Return joint values for a pose. Raises AsError E6007, E6008, E6016."""
        near = self.robot.q_destination()
        if configuration is not None:
            near = np.radians(configuration.values)
        result = self.robot.joints_of(se3_of(place), near)
        if result.q is None:
            raise reach_error(result.reason)
        return joints(*np.degrees(result.q))

    def in_range(self, place: Pose, configuration: Joints | None = None) -> int:
        """INRANGE: one bit per joint outside its limits, 32768 out of reach."""
        if isinstance(place, Transformation):
            try:
                place = self.joints_of(place, configuration)
            except AsError:
                return OUT_OF_REACH
        q, arm = np.radians(place.values), self.robot.kinematics
        beyond = (q < arm.lower_rad) | (q > arm.upper_rad)
        return sum(1 << k for k in range(JOINTS) if beyond[k])

    def monitor_speed_percent(self) -> float:
        """MSPEED."""
        return 100.0 * self.robot.queue.monitor_fraction

    def motor_torque_Nm(self, joint: int) -> float:
        """TRQNM: torque of the simulated servo. Raises AsError E0106."""
        number = int(checked(joint, 1, JOINTS, "the joint"))
        return float(self.robot.arm.data.actuator_force[number - 1])

    def motor_current_A(self, joint: int) -> float:
        """IQARM: torque over a torque constant of 1 Nm/A; the real constants are not public."""
        return self.motor_torque_Nm(joint)

    # --- machine_api: signals, switches, tasks, time ----------------------------------------------

    def signal(self, number: int) -> bool:
        """SIG of one signal. Raises AsError E0106."""
        return self.signals.holds(self.signal_number(number))

    def switch(self, name: str) -> bool:
        """SWITCH. Raises AsError P0116."""
        if not self.switches.exists(name):
            raise AsError("P0116", f"there is no switch {name.upper()}")
        return self.switches.read(name)

    def task_state(self, number: int) -> int:
        """TASK. Raises AsError E0106."""
        if number == ROBOT:
            return _TASK_STATES[self.robot_task.state]
        if number not in PC_PROGRAMS:
            raise AsError("E0106", f"TASK({number}): 1 is the robot program, 1001 to 1005 are PC")
        return _TASK_STATES[self.tasks[number - PC_PROGRAMS.start + 1].state]

    def error_number(self) -> int:
        """ERROR: of the step that a ONE program handles, otherwise the one pending ERESET."""
        for frame in reversed(self.scheduler.current.frames):
            if frame.handles is not None:
                return frame.handles.number
        return 0 if self.error is None else self.error.error.number

    def timer_s(self, number: int) -> float:
        """TIMER. Raises AsError E0106."""
        timer = int(checked(number, 0, TIMERS[-1], "the number of TIMER"))
        return self.timers.read_s(timer, self.now_ns)

    def random(self) -> float:
        """RANDOM: the same sequence in every run."""
        return self._random.random()

    def date(self) -> str:
        """$DATE: a fixed date, for repeatable runs."""
        return "26/01/01"

    def time(self) -> str:
        """$TIME: since power-on."""
        seconds = int(self.timers.read_s(0, self.now_ns))
        return f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"

    def has_program(self, name: str) -> bool:
        """EXISTPGM."""
        return name in self.programs

    def _refuse_pc(self, name: str) -> None:
        if not self.scheduler.current.is_robot:
            raise AsError("E1095", f"{name} is not allowed in PC programs")
