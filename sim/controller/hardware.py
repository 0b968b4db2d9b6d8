"""Hardware of the emulated controller: arm, network, signals, timers, tasks. No programs."""

from collections.abc import Callable

import numpy as np

from common.motion.frames import Array
from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.values import (
    Joints,
    Transformation,
    joints,
    se3_of,
    transformation_of,
)
from sim.controller.behaviour import Behaviour
from sim.controller.motion_queue import Ticket
from sim.controller.motion_requests import MotionParameters, MotionRequest, ProgramSpeed
from sim.controller.motion_settings import MotionSettings
from sim.controller.network import Network
from sim.controller.robot import Robot
from sim.controller.scheduler import Scheduler
from sim.controller.signals import Signals
from sim.controller.switches import SystemSwitches
from sim.controller.task import PC_PROGRAMS, ROBOT, ProgramStop, Task
from sim.controller.tcp import TcpUnit
from sim.controller.timers import Timers
from sim.robot.arm import SimArm
from sim.robot.scene import home_rad

FACTORY_MONITOR_SPEED = 0.1


class ControllerHardware:
    """Arm, sockets, signals, timers, switches, tasks and their scheduler."""

    def __init__(
        self,
        arm: SimArm,
        network: Network,
        *,
        behaviour: Behaviour | None = None,
        now_ns: int = 0,
        print_line: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Power on: no program, switches at factory settings. `say` receives PRINT lines."""
        self.behaviour = behaviour or Behaviour()
        self.print_line = print_line
        self.robot = Robot(arm)
        self.robot.queue.monitor_fraction = FACTORY_MONITOR_SPEED
        self.settings = MotionSettings()
        self.tcp = TcpUnit(network, send_ignores_timeout=self.behaviour.send_ignores_timeout)
        self.signals = Signals()
        self.timers = Timers(self.behaviour, now_ns=now_ns)
        self.repeat_mode = True
        self.teach_lock = False
        self.held = False
        self.emergency = False
        self.error: ProgramStop | None = None  # latched until ERESET
        self.stops: list[ProgramStop] = []
        self.tasks = [Task(n, self.cycle_ended, self.failed) for n in (ROBOT, *PC_PROGRAMS)]
        self.scheduler = Scheduler(self.tasks, self._tick, self.behaviour, now_ns=now_ns)
        self.switches = SystemSwitches(self._reports())
        self.after_tick: list[Callable[[], None]] = []  # sensor feed, probe of a test
        self._later: list[tuple[int, Callable[[], None]]] = []
        self._line = ""  # pending output of PRINT with /S
        self._motions = 0  # motions of this run of the robot program

    # --- time -------------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """The controller's time [ns]."""
        return self.scheduler.now_ns

    @property
    def robot_task(self) -> Task:
        """The robot program."""
        return self.tasks[0]

    def later(self, delay_s: float, action: Callable[[], None]) -> None:
        """Schedule an action after a delay [s]."""
        self._later.append((self.now_ns + round(delay_s * NS_PER_S), action))

    def print(self, text: str, *, feed: bool) -> None:
        """PRINT: output complete lines; /S keeps a line open."""
        self._line += text
        if feed:
            line, self._line = self._line, ""
            self.print_line(line)

    def cycle_ended(self, task: Task) -> None:
        """Handle the end of a task's main program."""
        raise NotImplementedError

    def failed(self, task: Task, error: AsError) -> None:
        """Handle a failed step of a task."""
        raise NotImplementedError

    def _tick(self) -> None:
        try:
            self.robot.tick()
        except AsError as error:
            self.failed(self.robot_task, error)
        if self.robot_task.state == "ending" and not self.robot.moving:
            self.robot_task.set_state("idle")
        for observer in self.after_tick:
            observer()
        if self._later:
            due = [action for at_ns, action in self._later if at_ns <= self.now_ns]
            self._later = [entry for entry in self._later if entry[0] > self.now_ns]
            for action in due:
                action()

    # --- the arm ----------------------------------------------------------------------------------

    def move(self, motion: MotionRequest) -> Ticket:
        """Queue a motion of the robot program. Raises AsError."""
        self.robot.queue.continuous_path = self.switches.read("cp")
        ticket = self.robot.move(motion)
        self._motions += 1
        if self._motions in self.behaviour.stall_at_motions:
            self.scheduler.stall(self.behaviour.planning_stall_s)
        return ticket

    def manner(self, speed: ProgramSpeed | None = None) -> MotionParameters:
        """Return the parameters of the next motion; an own speed does not use up SPEED."""
        return self.settings.take(self.robot.T_flange_tcp, speed)

    def brake(self) -> None:
        """BRAKE."""
        self.robot.queue.brake(keep_ahead=self.behaviour.brake_keeps_prefetched)

    def set_frame(self, name: str, value: Transformation) -> None:
        """Set BASE or TOOL."""
        if name == "BASE":
            self.robot.T_base_shift = se3_of(value)
        else:
            self.robot.T_flange_tcp = se3_of(value)

    def set_monitor_speed(self, percent: float) -> None:
        """Set the monitor speed: scales every program speed, also of the active motion."""
        self.robot.queue.monitor_fraction = percent / 100.0

    def here(self) -> Transformation:
        """HERE."""
        return transformation_of(self.robot.here())

    def here_joints(self) -> Joints:
        """#HERE."""
        return joints(*np.degrees(self.robot.q))

    def transformation_at(self, q: Array) -> Transformation:
        """Return the TOOL's pose in BASE at joint angles [rad]."""
        return transformation_of(self.robot.pose_of(q))

    def home_rad(self, _number: float) -> Array:
        """Return #HOME [rad]; the second home is the same as the first."""
        return home_rad(self.robot.arm.settings)

    # --- signals and switches ---------------------------------------------------------------------

    def signal_number(self, value: float) -> int:
        """Return a signal's number. Raises AsError E0106."""
        number = int(value)
        if not Signals.exists(number):
            raise AsError("E0106", f"signal {number} does not exist")
        return number

    def settable_signal(self, value: float) -> int:
        """Return the number of an output or internal signal. Raises AsError E0106."""
        number = self.signal_number(value)
        if not Signals.can_be_set(number):
            raise AsError("E0106", f"signal {abs(number)} is an input")
        return number

    def _reports(self) -> dict[str, Callable[[], bool]]:
        return {
            "power": lambda: self.robot.motor_power,
            "repeat": lambda: self.repeat_mode,
            "teach_lock": lambda: self.teach_lock,
            "run": lambda: not self.held,
            "cs": lambda: self.robot_task.state == "running",
            "error": lambda: self.error is not None,
            "emergency": lambda: self.emergency,
        }
