"""Program control: EXECUTE, ABORT, HOLD, CONTINUE, cycles, errors and start conditions."""

from collections.abc import Mapping

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.memory import Locals
from sim.controller.compiled import Compiled
from sim.controller.hardware import ControllerHardware
from sim.controller.task import FOREVER, PC_PROGRAMS, ProgramStop, StackFrame, Task


class ProgramControl(ControllerHardware):
    """Loaded programs of the controller and their execution control."""

    programs: Mapping[str, Compiled] = {}

    def program(self, name: str) -> Compiled:
        """Return a program. Raises AsError E0105 if it does not exist."""
        program = self.programs.get(name)
        if program is None:
            raise AsError("E0105", f"there is no program {name}")
        return program

    def refuse_if_in_use(self, program: Compiled, by: Task) -> None:
        """Raise AsError P1014 if a program to be entered is already on the stack of any task."""
        for task in self.tasks:
            for frame in task.frames:
                if frame.program is program:
                    whose = "itself" if task is by else task_name(task)
                    raise AsError("P1014", f"{program.name} is active in {whose}")

    # --- robot program ----------------------------------------------------------------------------

    def execute(self, name: str, *, cycles: int = 1, step: int = 1) -> None:
        """EXECUTE. Raises AsError P1000, P1001, P1002, P1009, P1013, P1014, E0105."""
        if self.robot_task.state in ("running", "ending") or (
            self.held and self.robot_task.state == "held"
        ):
            raise AsError("P1009", self.robot_task.main)
        self._refuse_start()
        program = self.program(name)
        self.robot_task.set_state("idle")
        self.refuse_if_in_use(program, self.robot_task)
        self.settings.reset()
        self._motions = 0
        self._start(self.robot_task, program, cycles=cycles, step=step)
        if self.held:
            self.robot_task.set_state("held")

    def abort(self) -> None:
        """ABORT: finish the active motion, then end the program."""
        self.robot.queue.drop_ahead()
        if self.robot_task.active:
            self.robot_task.set_state("ending")

    def hold(self) -> None:
        """HOLD: decelerate; keep the program and the rest of its motion."""
        self.held = self.robot.queue.held = True
        if self.robot_task.state == "running":
            self.robot_task.set_state("held")

    def resume(self) -> None:
        """CONTINUE: resume after HOLD, PAUSE or an error. Raises AsError as `execute`."""
        self._refuse_start()
        self.held = self.robot.queue.held = False
        if self.robot_task.state in ("held", "stopped"):
            self.robot_task.stop = None
            self.robot_task.set_state("running")

    def reset_error(self) -> None:
        """ERESET."""
        self.error = None

    def _refuse_start(self) -> None:
        if not self.robot.motor_power:
            raise AsError("P1000")
        if not self.repeat_mode:
            raise AsError("P1001")
        if self.teach_lock:
            raise AsError("P1002")
        if self.error is not None:
            raise AsError("P1013", str(self.error.error))

    # --- PC programs ------------------------------------------------------------------------------

    def start_pc(self, number: int, name: str, *, cycles: int = 1, step: int = 1) -> None:
        """PCEXECUTE. Raises AsError P1019, P1014, E0105."""
        task = self.tasks[number - PC_PROGRAMS.start + 1]
        if task.state in ("running", "held"):
            raise AsError("P1019", f"{task_name(task)} runs {task.main}")
        program = self.program(name)
        self.refuse_if_in_use(program, task)
        self._start(task, program, cycles=cycles, step=step)

    def stop_pc(self, number: int, *, at_once: bool = True) -> None:
        """PCABORT, or PCEND at the end of the cycle. No error if the program does not run."""
        task = self.tasks[number - PC_PROGRAMS.start + 1]
        if at_once:
            task.set_state("idle")
        else:
            task.cycles = 1

    # --- cycles -----------------------------------------------------------------------------------

    def _start(self, task: Task, program: Compiled, *, cycles: int, step: int) -> None:
        task.start(StackFrame(program, Locals(), pc=step - 1), cycles=cycles)
        task.began_ns = self.now_ns

    def cycle_ended(self, task: Task) -> None:
        """Restart the main program, or end it."""
        if task.cycles != FOREVER:
            task.cycles -= 1
        if task.cycles == 0:
            self.end(task)
            return
        program = task.frames[0].program
        task.frames = [StackFrame(program, Locals())]
        due_ns = task.began_ns + round(task.scan_s * NS_PER_S)
        if due_ns > self.now_ns:
            task.wait(lambda now_ns: now_ns >= due_ns)
        task.began_ns = max(due_ns, self.now_ns)

    def end_cycle(self, task: Task) -> None:
        """STOP: handle as the end of the main program."""
        task.end_wait()
        self.cycle_ended(task)

    def end(self, task: Task) -> None:
        """End the program; a robot program ends only when its motion has ended."""
        busy = task.is_robot and self.robot.moving
        task.set_state("ending" if busy else "idle")

    # --- errors -----------------------------------------------------------------------------------

    def failed(self, task: Task, error: AsError) -> None:
        """Call the task's ONE program, or stop the task and report the position."""
        if not task.frames:  # a motion whose program has already ended
            self.print_line(f"error: {error}")
            self.robot.queue.brake(keep_ahead=False)
            return
        handled = task.handler and all(frame.handles is None for frame in task.frames)
        stop = task.where(error)
        task.frame.pc = task.step_index
        task.end_wait()
        self.stops.append(stop)
        if handled:
            try:
                handler = self.program(task.handler)
                self.refuse_if_in_use(handler, task)
            except AsError:
                pass
            else:
                task.frames.append(StackFrame(handler, Locals(), handles=error))
                return
        self._stop(task, stop)

    def _stop(self, task: Task, stop: ProgramStop) -> None:
        task.stop = stop
        self.error = stop
        task.set_state("stopped" if task.is_robot else "idle")
        if task.is_robot:
            self.robot.queue.brake(keep_ahead=False)
        self.print_line(f"error: {stop}")


def task_name(task: Task) -> str:
    """Return the display name of a task."""
    return "the robot program" if task.is_robot else f"PC program {task.number - 1000}"
