"""Emulated controller: hardware, tasks, memory and pendant, on one clock."""

from collections.abc import Callable

from sim.as_language.errors import AsError
from sim.as_language.memory import Memory
from sim.as_language.syntax import SourceFile
from sim.controller.behaviour import Behaviour
from sim.controller.compile import compile_file
from sim.controller.hardware import Hardware
from sim.controller.machine_view import MachineView
from sim.controller.network import Network
from sim.controller.scheduler import Scheduler
from sim.controller.tasks import TaskControl
from sim.robot.arm import SimArm

FACTORY_MONITOR_SPEED_PERCENT = 10.0


class Machine:
    """Complete emulated controller."""

    def __init__(
        self,
        arm: SimArm,
        network: Network,
        *,
        behaviour: Behaviour | None = None,
        now_ns: int = 0,
        print_line: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Power on: no program, switches at factory settings."""
        self.hardware = Hardware(
            arm, network, behaviour=behaviour or Behaviour(), now_ns=now_ns, print_line=print_line
        )
        self.memory = Memory()
        self.control = TaskControl(self.hardware, self.memory.globals)
        self.pendant = Pendant(self.control)
        self.pendant.monitor_speed(FACTORY_MONITOR_SPEED_PERCENT)
        self.robot, self.tcp = self.hardware.robot, self.hardware.tcp
        self.tasks, self.robot_task = self.control.tasks, self.control.robot_task
        self.stops = self.control.stops
        self.after_tick: list[Callable[[], None]] = []  # sensor feed, probe of a test
        self.scheduler = Scheduler(self.tasks, self.hardware, self._tick)
        for task in self.tasks:
            task.machine = MachineView(task)

    @property
    def now_ns(self) -> int:
        """The controller's time [ns]."""
        return self.hardware.now_ns

    def load(self, source: SourceFile) -> None:
        """LOAD: add the programs and data of a file; a program of the same name is replaced.

        Raises AsError P1014 if a program to be replaced is running.
        """
        for task in self.tasks:
            for frame in task.frames:
                if frame.program.name in source.programs:
                    raise AsError("P1014", f"{frame.program.name} is running")
        self.control.programs = {**self.control.programs, **compile_file(source)}
        self.memory.fill(source.data)

    def advance(self, until_ns: int) -> None:
        """Advance time in lock step up to `until_ns`."""
        self.scheduler.advance(until_ns)

    def _tick(self) -> None:
        try:
            self.robot.tick()
        except AsError as error:
            self.control.failed(self.robot_task, error)
        if self.robot_task.state == "ending" and not self.robot.moving:
            self.robot_task.set_state("idle")
        for observer in self.after_tick:
            observer()
        self.hardware.signals.tick(self.hardware.now_ns)


class Pendant:
    """Teach pendant and operation panel: buttons and switches, with immediate effect."""

    def __init__(self, control: TaskControl) -> None:
        """Connect to a controller."""
        self._control, self._hardware = control, control.hardware
        # ABORT; ERESET; HOLD/RUN to HOLD; HOLD/RUN to RUN and cycle start (P1000 to P1013).
        self.abort, self.error_reset = control.abort, control.reset_error
        self.hold, self.run = control.hold, control.resume

    def motor_power(self, *, on: bool) -> None:
        """Switch the motors; off holds the program. Inhibited by a pressed emergency stop."""
        if not on:
            self.hold()
        if not (on and self._hardware.emergency):
            self._hardware.robot.power(on=on)

    def repeat(self) -> None:
        """Turn the switch to REPEAT; a held program stays held."""
        self._hardware.repeat_mode = True

    def teach(self) -> None:
        """Turn the switch to TEACH: the robot program is held."""
        self.hold()
        self._hardware.repeat_mode = False

    def teach_lock(self, *, on: bool) -> None:
        """Turn the teach lock; on in REPEAT mode holds the robot program."""
        if on:
            self.hold()
        self._hardware.teach_lock = on

    def emergency_stop(self) -> None:
        """Press the emergency stop: brake the arm, switch the motors off, hold the program."""
        self._hardware.emergency = True
        self.motor_power(on=False)

    def release_emergency_stop(self) -> None:
        """Release the emergency stop; this starts no motion."""
        self._hardware.emergency = False

    def execute(self, name: str, *, cycles: int = 1) -> None:
        """Select a program and start it. Raises AsError P1000 to P1014."""
        self._control.held = self._hardware.robot.queue.held = False
        self._control.execute(name, cycles=cycles)

    def monitor_speed(self, percent: float) -> None:
        """Set the monitor speed [%]: scales every program speed, also of the active motion."""
        self._hardware.robot.queue.monitor_fraction = percent / 100.0
