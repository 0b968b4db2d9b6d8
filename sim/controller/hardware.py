"""Hardware of the emulated controller: arm, sockets, signals, switches, timers. No programs."""

import math
import random
from collections import deque
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.keywords import SWITCHES
from sim.controller.behaviour import Behaviour
from sim.controller.motion_queue import MotionQueue, Ticket
from sim.controller.motion_requests import (
    MotionParameters,
    MotionRequest,
    MotionSettings,
    ProgramSpeed,
)
from sim.controller.network import Network
from sim.controller.planner import inverse
from sim.controller.tcp import TcpUnit
from sim.controller.udp import UdpUnit
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S

_STANDING_RAD = 2e-5  # of every joint: the arm has reached its command
_SETTLED_TICKS = 500  # limit for an arm that vibrates in contact
NO_STEP = -1
TIMERS = range(11)
CLAMPS = range(1, 9)
OUTPUTS = range(1, 961)
INPUTS = range(1001, 1961)
INTERNAL = range(2001, 2961)
# SINGULAR: JT5 closer to zero than this is an error on a TCP path; the manual's example.
STRAIGHT_WRIST_RAD = math.radians(5.0)
# SLOW_START: program speed of the first motion; set by SLOW_REPEAT, whose default is unknown.
SLOW_REPEAT_PERCENT = 10.0


ClampState = Literal["open", "closed", "off"]


class Signals:
    """Signals of the controller; all are initially OFF. A negative number means OFF."""

    def __init__(self) -> None:
        """Switch everything off."""
        self._on: set[int] = set()
        self._pulses: list[tuple[int, int]] = []  # end [ns] and number of each pulse

    @staticmethod
    def existing(value: float) -> int:
        """Return the number of a signal. Raises AsError E0106."""
        number = int(value)
        if not any(abs(number) in numbers for numbers in (OUTPUTS, INPUTS, INTERNAL)):
            raise AsError("E0106", f"signal {number} does not exist")
        return number

    @classmethod
    def settable(cls, value: float) -> int:
        """Return the number of an output or internal signal. Raises AsError E0106."""
        number = cls.existing(value)
        if abs(number) in INPUTS:
            raise AsError("E0106", f"signal {abs(number)} is an input")
        return number

    def set(self, number: int) -> None:
        """Switch a signal on, or off with a negative number. Also inputs, for tests."""
        if number > 0:
            self._on.add(number)
        else:
            self._on.discard(-number)

    def pulse(self, number: int, end_ns: int) -> None:
        """Switch a signal as its number says until a time [ns], then back."""
        self.set(number)
        self._pulses.append((end_ns, number))

    def holds(self, number: int) -> bool:
        """Return whether a signal is on, or off with a negative number."""
        return (abs(number) in self._on) == (number > 0)

    def reset_outputs(self) -> None:
        """Switch every output off (RESET)."""
        self._on -= set(OUTPUTS)

    def tick(self, now_ns: int) -> None:
        """End the pulses that are due."""
        for pulse in [pulse for pulse in self._pulses if pulse[0] <= now_ns]:
            self._pulses.remove(pulse)
            self.set(-pulse[1])


class Robot:
    """Arm as seen by AS: motor power, BASE and TOOL, pose, motions; stepped every millisecond.

    Internal units: metres, radians, `pin.SE3`, in the robot's own base frame (the simulation's). A
    pose of a program is the TOOL frame in the BASE frame, T_base_shift_tcp here.
    """

    def __init__(self, arm: SimArm, behaviour: Behaviour) -> None:
        """Connect to an arm at rest."""
        self.arm = arm
        self.kinematics = arm.kinematics
        self.queue = MotionQueue(
            arm.kinematics,
            arm.q,
            motions_ahead=behaviour.motions_ahead,
            least_segment_s=behaviour.least_segment_s,
        )
        self.T_base_shift = pin.SE3.Identity()  # BASE
        self.T_flange_tcp = pin.SE3.Identity()  # TOOL
        self.motor_power = True
        self._commanded_at = -_SETTLED_TICKS  # tick of the last change of the command

    # --- position ---------------------------------------------------------------------------------

    @property
    def q(self) -> Array:
        """Joint angles of the encoders [rad]. Shape (6,)."""
        return self.arm.q

    def here(self) -> pin.SE3:
        """Return the TOOL's pose in BASE, from the encoders."""
        return self.pose_of(self.arm.q)

    def destination(self) -> pin.SE3:
        """Return the TOOL's pose in BASE at the end of the newest started motion, or at rest."""
        return self.pose_of(self.queue.q_end)

    def start_of_next(self) -> pin.SE3:
        """Return the TOOL's pose in BASE at the end of the newest motion, also one that waits."""
        return self.pose_of(self.queue.q_newest)

    def pose_of(self, q: Array) -> pin.SE3:
        """Return the TOOL's pose in BASE at joint angles [rad]."""
        T_base_tcp = self.kinematics.flange_pose(q) * self.T_flange_tcp
        return self.T_base_shift.actInv(T_base_tcp)

    def joints_of(self, T_shift_tcp: pin.SE3, q_near: Array) -> Array:
        """Return the joint angles for a program's pose, near `q_near`. Raises AsError."""
        T_base_flange = self.T_base_shift * T_shift_tcp * self.T_flange_tcp.inverse()
        return inverse(self.kinematics, T_base_flange, q_near)

    # --- motion -----------------------------------------------------------------------------------

    @property
    def arrived(self) -> bool:
        """Whether the arm has reached its last command, within the motion's ACCURACY."""
        return not self.queue.is_moving and self._is_near()

    @property
    def axes_coincide(self) -> bool:
        """Whether the newest motion has reached its end, within its ACCURACY."""
        return self.queue.axes_coincide(arrived=self.arrived)

    @property
    def moving(self) -> bool:
        """Whether a motion is active or queued, or the arm is not at rest."""
        return self.queue.busy or not self.at_rest

    @property
    def at_rest(self) -> bool:
        """Whether command and arm are at rest; at the latest 0.5 s after the command."""
        if self.queue.is_moving:
            return False
        arm = self.arm
        still = not arm.moving or np.abs(arm.q - self.queue.q_command).max() < _STANDING_RAD
        return bool(still) or arm.ticks - self._commanded_at > _SETTLED_TICKS

    def power(self, *, on: bool) -> None:
        """Switch the motors; off: active motions are braked and discarded."""
        if on and not self.motor_power:
            self.queue.reseed(self.arm.q)
        elif not on:
            self.queue.brake(keep_ahead=False)
        self.motor_power = on

    def tick(self) -> None:
        """Advance by one millisecond. Raises AsError if a motion cannot be continued."""
        try:
            waits = self.queue.is_ahead and not self.queue.is_moving
            self.queue.tick(TICK_S, arrived=waits and self.arrived)
        except AsError:
            self.queue.fail()
            raise
        finally:
            if self.queue.is_moving:
                self._commanded_at = self.arm.ticks
            command = self.queue.q_command
            command.setflags(write=False)
            self.arm.command_joints(command)
            self.arm.step()

    def _is_near(self) -> bool:
        if self.at_rest:
            return True
        q, command = self.arm.q, self.queue.q_command
        last = self.queue.last
        accuracy_m = 0.001 if last is None else last.manner.accuracy_m
        off = self.pose_of(q).translation - self.pose_of(command).translation
        return float(np.linalg.norm(off)) <= accuracy_m


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
        # Of a dear step, beyond what every step costs.
        self.dear_step_ns = round(behaviour.step_s * (behaviour.dear_step_factor - 1.0) * NS_PER_S)
        self.robot = Robot(arm, behaviour)
        self.motion_settings = MotionSettings()
        self.arc: Any = None  # a C1MOVE that waits for the next point of its circle
        self.motions = 0  # of this run of the robot program
        self.motion_step = NO_STEP  # step of the last motion instruction
        self.is_slow = True  # the next motion is the first one after a start or restart
        self.tcp = TcpUnit(network, send_ignores_timeout=behaviour.send_ignores_timeout)
        self.udp = UdpUnit(network)
        self.signals = Signals()
        self.switches = SWITCHES | {"abs.speed": behaviour.abs_speed}
        self.registered_tool = pin.SE3.Identity()  # that of the selected tool number, Aux. 0304
        self.clamps: dict[int, ClampState] = {}
        self.at_next_motion: list[Callable[[], None]] = []  # OPEN, CLOSE, RELAX
        self._when: list[tuple[Callable[[], bool], Callable[[], None]]] = []
        self.keyboard: deque[str] | None = None  # lines typed for PROMPT; None: not connected
        self.repeat_mode = True
        self.teach_lock = False
        self.emergency = False
        self.random = random.Random(1)  # noqa: S311 - RANDOM, the same sequence in every run
        self._power_on_ns = now_ns
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

    @property
    def uptime_ms(self) -> int:
        """Time since power-on [ms]."""
        return (self.now_ns - self._power_on_ns) // 1_000_000

    def close_sockets(self) -> None:
        """Release every port and connection: the controller is switched off."""
        self.tcp.close_all()
        self.udp.close_all()

    def stall(self, duration_s: float) -> None:
        """Suspend all tasks for a duration: the processor plans a motion."""
        self.stalled_until_ns = self.now_ns + round(duration_s * NS_PER_S)

    def when(self, condition: Callable[[], bool], act: Callable[[], None]) -> None:
        """Act once, in the first millisecond in which a condition is true, or now."""
        if condition():
            act()
        else:
            self._when.append((condition, act))

    def tick(self) -> None:
        """End the pulses that are due, and do what waits for a condition."""
        self.signals.tick(self.now_ns)
        if self._when:
            waiting, self._when = self._when, []
            for condition, act in waiting:
                self.when(condition, act)

    @staticmethod
    def clamp(value: float) -> int:
        """Return the number of a clamp. Raises AsError E1075."""
        if int(value) not in CLAMPS:
            raise AsError("E1075", f"clamp {int(value)}; clamps are 1 to {CLAMPS[-1]}")
        return int(value)

    def set_clamp(self, number: int, state: ClampState) -> None:
        """Set a clamp and report it: which signals drive it is a setting of the controller."""
        self.clamps[number] = state
        self.print_line(f"clamp {number}: {state}")

    def interrupt_motion(self, *, keep_ahead: bool = False) -> None:
        """Brake the arm as BRAKE, XMOVE and ONI do, with CHG_INTERRUPT_DECEL as DECEL says."""
        self.robot.queue.brake(keep_ahead=keep_ahead, by_decel=self.switches["chg_interrupt_decel"])

    def move(self, motion: MotionRequest) -> Ticket:
        """Queue a motion of the robot program. Raises AsError: P1000, E6007, E6008, E6016."""
        robot = self.robot
        if not robot.motor_power:
            raise AsError("P1000")
        robot.queue.continuous_path = self.switches["cp"]
        motion = motion._replace(manner=self._with_speed(motion))
        ticket = robot.queue.offer(motion, arrived=robot.arrived)
        self.motions += 1
        planning_s = self.behaviour.segment_planning_s
        self.is_slow = False
        if self.motions in self.behaviour.stall_at_motions:
            planning_s = max(planning_s, self.behaviour.planning_stall_s)
        self.stall(planning_s)
        return ticket

    def _with_speed(self, motion: MotionRequest) -> MotionParameters:
        """Return the parameters of a motion as switches and behaviour interpret its speed."""
        switches = self.switches
        manner = motion.manner._replace(accel_time_s=self.behaviour.accel_time_s)
        if motion.kind == "linear":
            manner = manner._replace(
                straight_wrist_rad=STRAIGHT_WRIST_RAD if switches["singular"] else 0.0,
                keeps_configuration=not switches["conf_variable"],
            )
        if self.is_slow and switches["slow_start"]:
            return manner._replace(speed=manner.speed.at_most(SLOW_REPEAT_PERCENT))
        if manner.speed.unit == "M/S":
            speed_m_s = max(manner.speed.value, self.behaviour.least_speed_m_s)
            speed = ProgramSpeed(speed_m_s, "M/S")
            return manner._replace(speed=speed, absolute=switches["abs.speed"])
        has_seconds = motion.kind == "joint" and manner.speed.unit == "S"
        if has_seconds and self.behaviour.joint_seconds_ignored:
            return manner._replace(speed=ProgramSpeed())
        return manner
