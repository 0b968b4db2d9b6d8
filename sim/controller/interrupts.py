"""Interrupts by signal: ON and ONI monitor a signal, and its edge branches the program.

The signals are read every millisecond while the program runs. The branch waits until the arm is at
rest: ON lets it finish its motions, ONI brakes it. Then the subroutine is called, or the program
continues at the label; it returns to the step after the one that was interrupted. A signal that
the main program monitors is noticed in its subroutines too, and served after their return.
"""

from dataclasses import dataclass

from sim.as_language.memory import bind
from sim.controller.tasks import StackFrame, Task, TaskControl


@dataclass(slots=True, eq=False)
class Interrupt:
    """A monitored signal, and the branch: a program to call, or else the index of a step."""

    task: Task
    frame: StackFrame  # the program that monitors it
    signal: int
    brakes: bool  # ONI
    priority: int
    call: str
    goto: int
    before: bool  # whether the signal was there a tick ago
    due: bool = False


def monitor(interrupt: Interrupt) -> None:
    """Start to monitor a signal; this ends an earlier interrupt of the same signal and task."""
    ignore(interrupt.task, interrupt.signal)
    interrupt.task.control.interrupts.append(interrupt)


def ignore(task: Task, signal: int) -> None:
    """End the interrupts of a signal in a task, of either edge."""
    task.control.interrupts = [
        each
        for each in task.control.interrupts
        if each.task is not task or abs(each.signal) != abs(signal)
    ]


def poll(control: TaskControl) -> None:
    """Read the signals; begin the branch of each task's interrupt with the highest priority."""
    control.interrupts = [
        each for each in control.interrupts if any(f is each.frame for f in each.task.frames)
    ]
    signals = control.hardware.signals
    for each in control.interrupts:
        now = signals.holds(each.signal)
        each.due = each.due or (now and not each.before and each.task.state == "running")
        each.before = now
    for task in dict.fromkeys(each.task for each in control.interrupts if each.due):
        if task.state == "running" and not task.branching:
            _serve(task)


def _serve(task: Task) -> None:
    """Begin the branch of an interrupt that the running program itself monitors."""
    interrupts: list[Interrupt] = task.control.interrupts
    due = [each for each in interrupts if each.due and each.frame is task.frame]
    if due:
        _branch(task, max(due, key=lambda each: each.priority))


def _branch(task: Task, interrupt: Interrupt) -> None:
    """Interrupt the step that waits, and branch as soon as the arm is at rest."""
    task.control.interrupts.remove(interrupt)
    task.end_wait()
    if interrupt.brakes:
        task.hardware.interrupt_motion()
    task.branching = True

    def branches(_: int) -> bool:
        if task.is_robot and task.hardware.robot.moving:
            return False
        task.branching = False
        if interrupt.call:
            program = task.control.unused_program(interrupt.call, task)
            task.enter(program, bind(program.program.parameters, [], program.name))
        else:
            task.frame.pc = interrupt.goto
        return True

    task.wait(branches)
