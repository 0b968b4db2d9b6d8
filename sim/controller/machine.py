"""Emulated controller: hardware, tasks, memory and pendant, on one clock; its view by a task.

One processor executes all tasks in turn, one step each, and a robot tick every millisecond. Every
step costs the same processor time, a dear one (`compile.DEAR`) a multiple of it. A waiting task
(TWAIT, WAIT, SWAIT, TCP_*, a motion) costs nothing; its condition is polled every millisecond. If
no task is ready, time advances to the next tick. The caller controls time: `advance` runs up to a
given time and stops.
"""

from collections import deque
from collections.abc import Callable
from itertools import cycle, islice
from time import gmtime, strftime

import numpy as np

from common.motion.frames import Array
from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.memory import Namespace
from sim.as_language.syntax import SIGNIFICANT_CHARACTERS, SourceFile
from sim.as_language.values import (
    Joints,
    Pose,
    Transformation,
    joints,
    se3_of,
    transformation_of,
)
from sim.controller.behaviour import Behaviour
from sim.controller.compile import compile_file
from sim.controller.hardware import TIMERS, Hardware
from sim.controller.interrupts import poll
from sim.controller.motion_requests import checked
from sim.controller.network import Network
from sim.controller.system_data import system_number, system_text
from sim.controller.tasks import Task, TaskControl
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S

TICK_NS = round(TICK_S * NS_PER_S)
MOST_TICKS_BEHIND = 50  # a process delayed for longer drops time instead of catching up
FACTORY_MONITOR_SPEED_PERCENT = 10.0
OUT_OF_REACH = 32768
NO_TASK = -1
_TASK_STATES = {"idle": 0, "running": 1, "held": 2, "stopped": 2, "ending": 3}


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
        self.memory = Namespace()
        self.control = TaskControl(self.hardware, self.memory)
        self.pendant = Pendant(self.control)
        self.pendant.monitor_speed(FACTORY_MONITOR_SPEED_PERCENT)
        self.robot, self.tcp = self.hardware.robot, self.hardware.tcp
        self.tasks, self.robot_task = self.control.tasks, self.control.robot_task
        self.stops = self.control.stops
        self.after_tick: list[Callable[[], None]] = []  # sensor feed, probe of a test
        for task in self.tasks:
            task.machine = MachineView(task)
        self.steps = 0
        self._step_ns = round(self.hardware.behaviour.step_s * NS_PER_S)
        self.ns_lost = 0
        self._next_tick_ns = now_ns + TICK_NS
        self._turns = cycle(self.tasks)
        self._offset_ns = 0  # real clock minus controller time

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

    # --- time -------------------------------------------------------------------------------------

    def skip_to(self, clock_ns: int) -> None:
        """Set the real clock equal to controller time: time before, as for loading, is not lost."""
        self._offset_ns = clock_ns - self.hardware.now_ns

    def catch_up(self, clock_ns: int) -> None:
        """Advance to a time of the real clock; long delays are dropped."""
        behind_ns = clock_ns - self._offset_ns - self.hardware.now_ns
        lost_ns = max(0, behind_ns - MOST_TICKS_BEHIND * TICK_NS)
        self.ns_lost += lost_ns
        self._offset_ns += lost_ns
        self.advance(clock_ns - self._offset_ns)

    def advance(self, until_ns: int) -> None:
        """Advance to `until_ns` in lock step."""
        while self.hardware.now_ns < until_ns:
            self._round(until_ns)

    def _round(self, until_ns: int) -> None:
        """Execute one step of every ready task; without any, advance to the next tick."""
        hardware, step_ns, idle = self.hardware, self._step_ns, True
        if hardware.now_ns >= hardware.stalled_until_ns:
            for task in islice(self._turns, len(self.tasks)):
                if not task.ready:
                    continue
                idle = False
                task.step()
                self.steps += 1
                hardware.now_ns += step_ns
                if hardware.now_ns >= self._next_tick_ns:
                    self._pass_ticks()
                if hardware.now_ns >= until_ns:
                    return  # the next round begins with the next task
        if idle:
            hardware.now_ns = min(self._next_tick_ns, until_ns)
            self._pass_ticks()

    def _pass_ticks(self) -> None:
        hardware = self.hardware
        while hardware.now_ns >= self._next_tick_ns:
            self._next_tick_ns += TICK_NS
            self._tick()
            for task in self.tasks:
                if task.waiting:
                    task.check_wait(hardware.now_ns)

    def _tick(self) -> None:
        try:
            self.robot.tick()
        except AsError as error:
            self.control.failed(self.robot_task, error)
        if self.robot_task.state == "ending" and not self.robot.moving:
            self.robot_task.set_state("idle")
        for observer in self.after_tick:
            observer()
        self.hardware.tick()
        if self.control.interrupts:
            poll(self.control)


class Pendant:
    """Teach pendant and operation panel: buttons and switches, with immediate effect."""

    def __init__(self, control: TaskControl) -> None:
        """Connect to a controller."""
        self._control, self._hardware = control, control.hardware
        # ABORT; ERESET; HOLD/RUN to HOLD; HOLD/RUN to RUN and cycle start (P1000 to P1013).
        self.abort, self.error_reset = control.abort, control.reset_error
        self.hold, self.run = control.hold, control.resume
        self.motor_power = control.motor_power

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

    def external_hold(self, *, on: bool) -> None:
        """Switch the external HOLD input; off resumes the program, unless CYCLE.STOP is ON.

        Raises AsError as `run`.
        """
        if on:
            self.hold()
        elif not self._hardware.switches["cycle.stop"]:
            self.run()

    def tool_button(self) -> None:
        """Operate the function button of a tool: with QTOOL it replaces TOOL by that tool."""
        if self._hardware.switches["qtool"]:
            self._hardware.robot.T_flange_tcp = self._hardware.registered_tool

    def type_line(self, text: str) -> None:
        """Type a line at the keyboard of the terminal, which is connected with it: for PROMPT."""
        if self._hardware.keyboard is None:
            self._hardware.keyboard = deque()
        self._hardware.keyboard.append(text)

    def execute(self, name: str, *, cycles: int = 1) -> None:
        """Select a program and start it. Raises AsError P1000 to P1014."""
        self._control.held = self._hardware.robot.queue.held = False
        self._control.execute(name, cycles=cycles)

    def monitor_speed(self, percent: float) -> None:
        """Set the monitor speed [%]: scales every program speed, also of the active motion."""
        self._hardware.robot.queue.monitor_fraction = percent / 100.0


class MachineView:
    """The controller as the expressions of one task see it; implements `MachineInterface`."""

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
        return _degrees(self._robot.queue.q_end)

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
        near = self._robot.queue.q_end
        if configuration is not None:
            near = np.radians(configuration.values)
        return _degrees(self._robot.joints_of(se3_of(place), near))

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
        """TRQNM: torque of the simulated servo."""
        return float(self._robot.arm.data.actuator_force[joint - 1])

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
        switches = self._hardware.switches
        if name in switches:
            return switches[name]
        for longer, is_on in switches.items():  # a name has 15 significant characters
            if longer[:SIGNIFICANT_CHARACTERS] == name:
                return is_on
        raise AsError("P0116", f"there is no switch {name.upper()}")

    def task_state(self, number: int) -> int:
        """TASK. Raises AsError E0106."""
        states = {task.number: task.state for task in self._control.tasks}
        if number not in states:
            raise AsError("E0106", f"TASK({number}): 1 is the robot program, 1001 to 1005 are PC")
        return _TASK_STATES[states[number]]

    def task_of(self, name: str) -> int:
        """WHICHTASK: also of a subroutine that the task called, and of a held program."""
        for task in self._control.tasks:
            if any(frame.program.name == name[:SIGNIFICANT_CHARACTERS] for frame in task.frames):
                return task.number
        return NO_TASK

    def error_number(self) -> int:
        """ERROR: of the step that a ONE program handles, otherwise the one pending ERESET."""
        for frame in reversed(self._task.frames):
            if frame.handles is not None:
                return frame.handles.number
        return self._control.error_number

    def timer_s(self, number: int) -> float:
        """TIMER. Raises AsError E0106."""
        return self._hardware.timer_s(int(checked(number, 0, TIMERS[-1], "the number of TIMER")))

    def user_timer_s(self, zero_ms: float) -> float:
        """UTIMER."""
        return (self._hardware.uptime_ms - zero_ms) * 1e-3

    def system_number(self, keyword: str, first: int, second: int) -> float:
        """SYSDATA. Raises AsError P0116, P0104, E0106."""
        return system_number(self._control, keyword, first, second)

    def system_text(self, keyword: str) -> str:
        """$SYSDATA. Raises AsError P0116."""
        return system_text(self._control, keyword)

    def random(self) -> float:
        """RANDOM: the same sequence in every run."""
        return self._hardware.random.random()

    def date(self) -> str:
        """$DATE: a fixed date, for repeatable runs."""
        return "26/01/01"

    def time(self) -> str:
        """$TIME: since power-on."""
        return strftime("%H:%M:%S", gmtime(self._hardware.timer_s(0)))

    def time_ms(self) -> str:
        """$TIME_MS: since power-on."""
        whole_s, ms = divmod(self._hardware.uptime_ms, 1000)
        return f"{strftime('%H:%M:%S', gmtime(whole_s))}.{ms:03d}"

    def has_program(self, name: str) -> bool:
        """EXISTPGM."""
        return name in self._control.programs

    def _refuse_pc(self, name: str) -> None:
        if not self._task.is_robot:
            raise AsError("E1095", f"{name} is not allowed in PC programs")


def _degrees(q: Array) -> Joints:
    return joints(*np.degrees(q))
