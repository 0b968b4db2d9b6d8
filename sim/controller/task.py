"""Program task: call stack, wait condition and end state of one program in execution.

`task.ready` means that a step can be executed. Every state change updates it, so the scheduler's
inner loop reads only one attribute.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from sim.as_language.errors import AsError
from sim.as_language.memory import Locals, Namespace
from sim.controller.compiled import Compiled

if TYPE_CHECKING:
    from sim.controller.machine import Machine

ROBOT = 1
PC_PROGRAMS = range(1001, 1006)
DEEPEST_CALL = 20
FOREVER = -1

TaskState = Literal["idle", "running", "held", "stopped", "ending"]
Wait = Callable[[int], bool]
"""Wait condition of a step: polled every millisecond with the time [ns]; True ends the wait."""


@dataclass(slots=True)
class StackFrame:
    """Stack frame of a program: program counter, locals, actions of the END of each FOR."""

    program: Compiled
    locals: Locals
    pc: int = 0
    loops: "dict[int, Callable[[Task], int]]" = field(default_factory=dict)
    handles: AsError | None = None  # called by ONE for this error


@dataclass(frozen=True, slots=True)
class ProgramStop:
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

    # The executing machine, and the global variables: set by the machine.
    machine: "Machine"
    globals: Namespace

    def __init__(
        self,
        number: int,
        ended: "Callable[[Task], None]",
        failed: "Callable[[Task, AsError], None]",
    ) -> None:
        """Start without a program. `ended`: called after a cycle; `failed`: after a failed step."""
        self.number = number
        self.state: TaskState = "idle"
        self.frames: list[StackFrame] = []
        self.main = ""
        self.cycles = 0
        self.handler = ""  # ONE
        self.stop: ProgramStop | None = None
        self.scan_s = 0.0  # PCSCAN: minimum cycle time
        self.began_ns = 0  # start of this cycle
        self.ready = False
        self.waiting = False
        self._wait: Wait | None = None
        self._waits_at = 0
        self._ended, self._failed = ended, failed

    @property
    def is_robot(self) -> bool:
        """Whether this is the robot program."""
        return self.number == ROBOT

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

    def start(self, frame: StackFrame, *, cycles: int) -> None:
        """Start a program."""
        self.frames = [frame]
        self.main, self.cycles = frame.program.name, cycles
        self.handler, self.stop, self._wait, self.scan_s = "", None, None, 0.0
        self.set_state("running")

    def set_state(self, state: TaskState) -> None:
        """Change the state; the wait condition is kept unless the program has ended."""
        self.state = state
        if state in ("idle", "ending"):
            self.frames, self._wait = [], None
        self.ready = state == "running" and self._wait is None
        self.waiting = state == "running" and self._wait is not None

    def wait(self, wait: Wait) -> None:
        """Suspend the task until a condition is true."""
        self._wait, self._waits_at = wait, self.frames[-1].pc
        self.ready, self.waiting = False, True

    @property
    def step_index(self) -> int:
        """Index of the step that is being executed or waiting."""
        return self._waits_at if self._wait is not None else self.frame.pc

    def where(self, error: AsError) -> ProgramStop:
        """Return the program position for an error."""
        frame = self.frame
        steps = frame.program.steps
        step = steps[min(self.step_index, len(steps) - 1)]
        return ProgramStop(
            error, frame.program.name, step.number, step.text.strip(), str(step.where)
        )

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
            self._failed(self, error)

    def check_wait(self, now_ns: int) -> None:
        """Poll the wait condition."""
        wait = self._wait
        if wait is None:
            return
        try:
            over = wait(now_ns)
        except AsError as error:
            self._failed(self, error)
            return
        # The condition may itself have ended the program and removed the wait.
        if over and self._wait is wait:
            self.end_wait()

    def end_wait(self) -> None:
        """End the wait and continue with the next step."""
        self._wait = None
        self.waiting, self.ready = False, self.state == "running"

    def enter(self, frame: StackFrame) -> None:
        """Call a subroutine. Raises AsError E0112 if calls are nested too deeply."""
        if len(self.frames) > DEEPEST_CALL:
            raise AsError("E0112", f"more than {DEEPEST_CALL} levels")
        self.frames.append(frame)

    def leave(self) -> None:
        """Return from a subroutine; from the main program: end the cycle."""
        if len(self.frames) > 1:
            self.frames.pop()
        else:
            self._ended(self)
