"""Hardware of the emulated controller: arm, sockets, signals, switches, timers. No programs."""

import random
from collections.abc import Callable

from forcemesh.clock import NS_PER_S
from sim.controller.behaviour import Behaviour
from sim.controller.motion_queue import Ticket
from sim.controller.motion_requests import MotionRequest, MotionSettings
from sim.controller.network import Network
from sim.controller.robot import Robot
from sim.controller.signals import Signals
from sim.controller.tcp import TcpUnit
from sim.robot.arm import SimArm

TIMERS = range(11)
# Switches that programs set, with their factory setting. CP takes effect here; the others are only
# stored. Not in this table: switches that only report a state (`TaskControl.reports`).
FACTORY_SWITCHES = {
    "cp": True, "check.hold": False, "messages": True, "screen": True, "oxpreset": False,
    "prefetch.sigins": False, "qtool": False, "rep_once": False, "rps": False, "stp_once": False,
    "autostart.pc": False, "autostart2.pc": False, "autostart3.pc": False, "autostart4.pc": False,
    "autostart5.pc": False, "errstart.pc": False, "dispio_01": False, "hold.step": False,
    "wait.nozer": False, "trace": False, "singular": True, "abs.speed": False, "slow_start": False,
    "after.wait.tmr": False, "udp_send_nobind": False, "udp_emsg": False, "flexcomp": False,
    "disable_interrupt": False,
}  # fmt: skip


class Hardware:
    """Everything of the controller that a program uses. `now_ns` is the controller's time."""

    def __init__(
        self,
        arm: SimArm,
        network: Network,
        *,
        behaviour: Behaviour,
        now_ns: int,
        print_line: Callable[[str], None],
    ) -> None:
        """Power on at `now_ns`; `print_line` receives the lines of PRINT and errors."""
        self.behaviour = behaviour
        self.print_line = print_line
        self.now_ns = now_ns
        self.stalled_until_ns = 0
        self.robot = Robot(arm)
        self.motion_settings = MotionSettings()
        self.motions = 0  # of this run of the robot program
        self.tcp = TcpUnit(network, send_ignores_timeout=behaviour.send_ignores_timeout)
        self.signals = Signals()
        self.switches = dict(FACTORY_SWITCHES)
        self.repeat_mode = True
        self.teach_lock = False
        self.emergency = False
        self.random = random.Random(1)  # noqa: S311 - RANDOM, the same sequence in every run
        self._timer_zeros_ns = [now_ns for _ in TIMERS]
        self._line = ""  # pending output of PRINT with /S

    def print(self, text: str, *, feed: bool) -> None:
        """PRINT: output complete lines; /S keeps a line open."""
        self._line += text
        if feed:
            line, self._line = self._line, ""
            self.print_line(line)

    def timer_s(self, number: int) -> float:
        """Return a timer [s]: since it was set; TIMER 0 since power-on."""
        return self.behaviour.timer_s((self.now_ns - self._timer_zeros_ns[number]) / NS_PER_S)

    def set_timer(self, number: int, value_s: float) -> None:
        """Set a timer [s]."""
        self._timer_zeros_ns[number] = self.now_ns - round(value_s * NS_PER_S)

    def stall(self, duration_s: float) -> None:
        """Suspend all tasks for a duration: the processor plans a motion."""
        self.stalled_until_ns = self.now_ns + round(duration_s * NS_PER_S)

    def move(self, motion: MotionRequest) -> Ticket:
        """Queue a motion of the robot program. Raises AsError."""
        self.robot.queue.continuous_path = self.switches["cp"]
        ticket = self.robot.move(motion)
        self.motions += 1
        if self.motions in self.behaviour.stall_at_motions:
            self.stall(self.behaviour.planning_stall_s)
        return ticket
