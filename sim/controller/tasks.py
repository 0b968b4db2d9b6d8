"""Tasks of the controller: programs in execution, and EXECUTE, ABORT, HOLD, cycles and errors.

`task.ready` means that a step can be executed. Every state change updates it, so the inner loop of
the machine reads only one attribute. A compiled program is independent of a machine: a step
accesses all state through its task.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.machine_api import MachineInterface
from sim.as_language.memory import Locals, Namespace
from sim.as_language.syntax import Program, ProgramStep
from sim.controller.hardware import NO_STEP, Hardware
from sim.controller.motion_requests import MotionSettings

ROBOT = 1
PC_PROGRAMS = range(1001, 1006)
DEEPEST_CALL = 20
FOREVER = -1

TaskState = Literal["idle", "running", "held", "stopped", "ending"]
Op = Callable[["Task"], int]
"""Executes a step for a task and returns the index of the next step."""
Wait = Callable[[int], bool]
"""Wait condition of a step: polled every millisecond with the time [ns]; True ends the wait."""


class Compiled(NamedTuple):
    """Program with one operation for each step."""

    program: Program
    ops: Sequence[Op]

    @property
    def name(self) -> str:
        """Name of the program, lower case."""
        return self.program.name

    @property
    def steps(self) -> tuple[ProgramStep, ...]:
        """The parsed steps."""
        return self.program.steps


@dataclass(slots=True)
class StackFrame:
    """Stack frame of a program: program counter, locals, actions of the END of each FOR."""

    program: Compiled
    locals: Locals = field(default_factory=Locals)
    pc: int = 0
    loops: dict[int, Op] = field(default_factory=dict)
    handles: AsError | None = None  # called by ONE for this error


class ProgramStop(NamedTuple):
    """Cause and position of a program stop."""

    error: AsError
    program: str
    step: int
    text: str
    where: str

    def __str__(self) -> str:
        return (
            f"{self.error} | program {self.program}, step {self.step}: {self.text} | {self.where}"
        )


class Task:
    """A robot program (number 1) or a PC program (1001 to 1005)."""

    machine: MachineInterface  # the controller as its expressions see it; set by the machine

    def __init__(self, number: int, control: "TaskControl") -> None:
        """Start without a program."""
        self.number = number
        self.control, self.hardware, self.globals = control, control.hardware, control.globals
        self.is_robot = number == ROBOT
        self.name = "the robot program" if self.is_robot else f"PC program {number - 1000}"
        self.state: TaskState = "idle"
        self.frames: list[StackFrame] = []
        self.main = ""
        self.cycles = 0
        self.handler = ""  # ONE
        self.stop: ProgramStop | None = None
        self.scan_s = 0.0  # PCSCAN: minimum cycle time
        self.began_ns = 0  # start of this cycle
        self.branching = False  # to the program of an interrupt
        self.masked: set[int] = set()  # RUNMASK
        self._lit: set[int] = set()  # signals to switch on again when the program continues
        self.ready = False
        self.waiting = False
        self._wait: Wait | None = None
        self._waits_at = 0

    @property
    def frame(self) -> StackFrame:
        """The frame of the running program."""
        return self.frames[-1]

    @property
    def locals(self) -> Locals:
        """The local variables of the running program."""
        return self.frames[-1].locals

    @property
    def active(self) -> bool:
        """Whether a program is active: running, held or stopped by an error."""
        return self.state in ("running", "held", "stopped")  # "stopped" can be continued

    # --- states -----------------------------------------------------------------------------------

    def start(self, program: Compiled, *, cycles: int, step: int) -> None:
        """Start a program."""
        self.frames = [StackFrame(program, pc=step - 1)]
        self.main, self.cycles = program.name, cycles
        self.handler, self.stop, self._wait, self.scan_s = "", None, None, 0.0
        self.branching = False
        self.masked.clear()
        self._lit.clear()
        self.began_ns = self.hardware.now_ns
        self.set_state("running")

    def set_state(self, state: TaskState) -> None:
        """Change the state; the wait condition is kept unless the program has ended."""
        if self.masked and (state == "running") != (self.state == "running"):
            self._mask(on=state == "running")
        self.state = state
        if state in ("idle", "ending"):
            self.frames, self._wait = [], None
        self.ready = state == "running" and self._wait is None
        self.waiting = state == "running" and self._wait is not None

    def _mask(self, *, on: bool) -> None:
        """Switch the signals of RUNMASK off, or those on again that were on."""
        signals = self.hardware.signals
        if not on:
            self._lit = {number for number in self.masked if signals.holds(number)}
        for number in self._lit:
            signals.set(number if on else -number)

    def wait(self, wait: Wait) -> None:
        """Suspend the task until a condition is true."""
        self._wait, self._waits_at = wait, self.frames[-1].pc
        self.ready, self.waiting = False, True

    def end_wait(self) -> None:
        """End the wait and continue with the next step."""
        self._wait = None
        self.waiting, self.ready = False, self.state == "running"

    @property
    def step_index(self) -> int:
        """Index of the step that is being executed or waiting."""
        return self._waits_at if self._wait is not None else self.frame.pc

    def where(self, error: AsError) -> ProgramStop:
        """Return the program position for an error."""
        program = self.frame.program
        step = program.steps[min(self.step_index, len(program.steps) - 1)]
        return ProgramStop(error, program.name, step.number, step.text.strip(), str(step.where))

    # --- steps ------------------------------------------------------------------------------------

    def step(self) -> None:
        """Execute one step."""
        frame = self.frames[-1]
        try:
            ops = frame.program.ops
            if frame.pc >= len(ops):
                self.leave()
                return
            frame.pc = ops[frame.pc](self)
        except AsError as error:
            self.control.failed(self, error)

    def check_wait(self, now_ns: int) -> None:
        """Poll the wait condition."""
        wait = self._wait
        if wait is None:
            return
        try:
            over = wait(now_ns)
        except AsError as error:
            self.control.failed(self, error)
            return
        # The condition may itself have ended the program and removed the wait.
        if over and self._wait is wait:
            self.end_wait()

    def enter(self, program: Compiled, names: Locals) -> None:
        """Call a subroutine. Raises AsError E0112 if calls are nested too deeply."""
        if len(self.frames) > DEEPEST_CALL:
            raise AsError("E0112", f"more than {DEEPEST_CALL} levels")
        self.frames.append(StackFrame(program, names))

    def leave(self) -> None:
        """Return from a subroutine; from the main program: end the cycle."""
        if len(self.frames) > 1:
            self.frames.pop()
        else:
            self.end_cycle()

    # --- cycles -----------------------------------------------------------------------------------

    def end_cycle(self) -> None:
        """Restart the main program, or end it."""
        self.end_wait()
        if self.cycles != FOREVER:
            self.cycles -= 1
        if self.cycles == 0:
            self.end()
            return
        self.frames = [StackFrame(self.frames[0].program)]
        now_ns = self.hardware.now_ns
        due_ns = self.began_ns + round(self.scan_s * NS_PER_S)
        if due_ns > now_ns:
            self.wait(lambda now_ns: now_ns >= due_ns)
        self.began_ns = max(due_ns, now_ns)

    def end(self) -> None:
        """End the program; a robot program ends only when its motion has ended."""
        busy = self.is_robot and self.hardware.robot.moving
        self.set_state("ending" if busy else "idle")


class TaskControl:
    """Loaded programs of the controller and the tasks that execute them."""

    def __init__(self, hardware: Hardware, global_names: Namespace) -> None:
        """Start without a program."""
        self.hardware = hardware
        self.globals = global_names
        self.programs: Mapping[str, Compiled] = {}
        self.tasks = [Task(number, self) for number in (ROBOT, *PC_PROGRAMS)]
        self.robot_task = self.tasks[0]
        self.held = False
        self.error: ProgramStop | None = None  # latched until ERESET
        self.stops: list[ProgramStop] = []
        self.interrupts: list[Any] = []  # ON and ONI, see `interrupts`
        self.reports: dict[str, Callable[[], bool]] = {  # switches that programs cannot set
            "power": lambda: hardware.robot.motor_power,
            "repeat": lambda: hardware.repeat_mode,
            "teach_lock": lambda: hardware.teach_lock,
            "run": lambda: not self.held,
            "cs": lambda: self.robot_task.state == "running",
            "error": lambda: self.error is not None,
            "emergency": lambda: hardware.emergency,
        }

    def program(self, name: str) -> Compiled:
        """Return a program. Raises AsError E0105 if it does not exist."""
        program = self.programs.get(name)
        if program is None:
            raise AsError("E0105", f"there is no program {name}")
        return program

    def unused_program(self, name: str, by: Task) -> Compiled:
        """Return a program to be entered. Raises AsError E0105, or P1014 if any task is in it."""
        program = self.program(name)
        for task in self.tasks:
            for frame in task.frames:
                if frame.program is program:
                    whose = "itself" if task is by else task.name
                    raise AsError("P1014", f"{program.name} is active in {whose}")
        return program

    @property
    def error_number(self) -> int:
        """Number of the error that is pending ERESET, or 0."""
        return 0 if self.error is None else self.error.error.number

    # --- robot program ----------------------------------------------------------------------------

    def execute(self, name: str, *, cycles: int = 1) -> None:
        """EXECUTE. Raises AsError P1000, P1001, P1002, P1009, P1013, P1014, E0105."""
        self._refuse_start()
        self.prime(name, cycles=cycles)
        if not self.held:
            self.robot_task.set_state("running")

    def prime(self, name: str, *, cycles: int = 1) -> None:
        """PRIME: prepare a program, which CONTINUE starts. Raises AsError P1009, P1014, E0105."""
        task = self.robot_task
        if task.state in ("running", "ending") or (self.held and task.state == "held"):
            raise AsError("P1009", task.main)
        self.program(name)
        task.set_state("idle")
        program = self.unused_program(name, task)
        self.hardware.motion_settings = MotionSettings()
        self.hardware.motions, self.hardware.arc = 0, None
        self.hardware.motion_step, self.hardware.is_slow = NO_STEP, True
        task.start(program, cycles=cycles, step=1)
        task.set_state("held")

    def abort(self) -> None:
        """ABORT: finish the active motion, then end the program."""
        self.hardware.robot.queue.drop_ahead()
        if self.robot_task.active:
            self.robot_task.set_state("ending")

    def hold(self) -> None:
        """HOLD: decelerate; keep the program and the rest of its motion."""
        self.held = self.hardware.robot.queue.held = True
        if self.robot_task.state == "running":
            self.robot_task.set_state("held")

    def resume(self) -> None:
        """Run: end HOLD; resume a program that waits for it. Raises AsError as `execute`."""
        self._refuse_start()
        self.held = self.hardware.robot.queue.held = False
        if self.robot_task.state in ("held", "stopped"):
            self.robot_task.stop, self.hardware.is_slow = None, True
            self.robot_task.set_state("running")

    def continue_program(self) -> None:
        """CONTINUE: after HOLD, PAUSE, PRIME or an error. Raises AsError P1011, or as `execute`."""
        if self.robot_task.state == "idle":
            raise AsError("P1011")
        self.resume()

    def motor_power(self, *, on: bool) -> None:
        """Switch the motors; off holds the program. Inhibited by a pressed emergency stop."""
        if not on:
            self.hold()
        if not (on and self.hardware.emergency):
            self.hardware.robot.power(on=on)

    def reset_error(self) -> None:
        """ERESET."""
        self.error = None

    def _refuse_start(self) -> None:
        if not self.hardware.robot.motor_power:
            raise AsError("P1000")
        if not self.hardware.repeat_mode:
            raise AsError("P1001")
        if self.hardware.teach_lock:
            raise AsError("P1002")
        if self.error is not None:
            raise AsError("P1013", str(self.error.error))

    # --- PC programs ------------------------------------------------------------------------------

    def start_pc(self, number: int, name: str, *, cycles: int = 1, step: int = 1) -> None:
        """PCEXECUTE 1 to 5. Raises AsError P1019, P1014, E0105."""
        task = self.tasks[number]
        if task.state in ("running", "held"):
            raise AsError("P1019", f"{task.name} runs {task.main}")
        task.start(self.unused_program(name, task), cycles=cycles, step=step)

    # --- errors -----------------------------------------------------------------------------------

    def failed(self, task: Task, error: AsError) -> None:
        """Call the task's ONE program, or stop the task and report the position."""
        if not task.frames:  # a motion whose program has already ended
            self.hardware.print_line(f"error: {error}")
            self.hardware.robot.queue.brake(keep_ahead=False)
            return
        handled = task.handler and all(frame.handles is None for frame in task.frames)
        stop = task.where(error)
        task.frame.pc = task.step_index
        task.end_wait()
        self.stops.append(stop)
        if handled:
            try:
                handler = self.unused_program(task.handler, task)
            except AsError:
                pass
            else:
                task.frames.append(StackFrame(handler, handles=error))
                return
        task.stop = self.error = stop
        task.set_state("stopped" if task.is_robot else "idle")
        if task.is_robot or self.hardware.behaviour.pc_error_stops_robot:
            self.hardware.robot.queue.brake(keep_ahead=False)
            if self.robot_task.state == "running":
                self.robot_task.set_state("stopped")
        self.hardware.print_line(f"error: {stop}")
