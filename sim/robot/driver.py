"""Driver of the simulated robot: commands to arm motions, physics up to the clock. No bus."""

from collections import deque
from collections.abc import Callable, Sequence

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import Array
from common.motion.limits import joint_goal
from common.motion.setpoint_monitor import SPEED_MARGIN
from common.robot.driver import RobotDriver
from common.robot.report import ArmReport
from common.runtime.signal_service import SignalReading
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Goal, GoalState, Speed, Trip
from sim.robot.arm import SimArm
from sim.robot.motion import BUSY, MotionGenerator
from sim.robot.settings import TICK_S, SimSettings
from sim.robot.signals import SimSignals

MOST_TICKS_PER_STEP = 50  # a process delayed for longer drops simulated time instead
TICK_NS = round(TICK_S * NS_PER_S)


class SimDriver(RobotDriver):
    """The simulated arm, moved by a motion generator. It reports at the rate of the cell file.

    The physics runs in steps of `wake_ticks`, all of their ticks at once, because the first tick
    after a wake-up costs as much as three more. A set point in between waits for the tick that it
    acts from, the one of its arrival; a goal or a hold makes up the ticks before it.
    """

    link_fault = None  # the state of this arm is always known

    def __init__(self, cell: CellConfig, now_ns: int) -> None:
        """Start at rest at home; the first tick is a millisecond from now."""
        settings = SimSettings.of(cell)
        self.arm = SimArm(settings, seed=settings.seed)
        self.after_tick: list[Callable[[], object]] = []
        self.state_ticks = max(1, round(1.0 / cell.rates.robot_hz / TICK_S))
        stream_m_s = SPEED_MARGIN * cell.limits.speed_m_s
        self._motion = MotionGenerator(self.arm.kinematics, self.arm.q, stream_m_s=stream_m_s)
        self._seeded = True  # the commanded pose is the measured one of this hold
        self.wake_ticks = 1
        self.ticks_lost, self._start_ns = 0, now_ns
        self._behind = 0  # ticks, behind the clock of this step
        self._is_due = False  # this step runs them
        self._streamed: deque[tuple[int, pin.SE3, Array]] = deque()  # first tick, pose, joints
        self._reports: list[ArmReport] = []
        self._signals = SimSignals(cell)

    # --- report -----------------------------------------------------------------------------------

    @property
    def measured(self) -> ArmReport:
        """Present state of the arm."""
        return ArmReport(
            T_base_flange=self.arm.T_base_flange,
            joint_rad=tuple(self.arm.q.tolist()),
            moving=self._motion.state in BUSY or self.arm.moving,
            at_ns=self.time_of(self.arm.ticks),
        )

    def time_of(self, tick: int) -> int:
        """Return the time of a tick."""
        return self._start_ns + (tick + self.ticks_lost) * TICK_NS

    def receive(self, now_ns: int) -> None:
        """Advance the physics to the clock, but for the last tick, if it is due."""
        elapsed = (now_ns - self._start_ns) // TICK_NS - self.arm.ticks - self.ticks_lost
        self.ticks_lost += max(0, elapsed - MOST_TICKS_PER_STEP)
        self._behind = min(elapsed, MOST_TICKS_PER_STEP)
        self._is_due = self._behind >= self.wake_ticks - self.arm.ticks % self.wake_ticks
        if self._is_due:
            self._make_up()

    def _make_up(self) -> None:
        """Run the ticks since the last step, but for the last one."""
        while self._behind > 1:
            self._tick()
        self._is_due = True

    def report(self) -> Sequence[ArmReport]:
        """Make the last tick; return the reports of this step."""
        if self._is_due and self._behind > 0:
            self._tick()
        reports, self._reports = self._reports, []
        return reports

    def _tick(self) -> None:
        self._behind -= 1
        while self._streamed and self._streamed[0][0] <= self.arm.ticks + 1:
            _, T_base_flange, q = self._streamed.popleft()
            self._motion.follow(T_base_flange, q)
        self.arm.command_joints(self._motion.tick(TICK_S))
        self.arm.step()
        for ticked in self.after_tick:
            ticked()
        if self.arm.ticks % self.state_ticks == 0:
            self._reports.append(self.measured)

    @property
    def explains_motion(self) -> bool:
        """Whether the arm brakes."""
        return self._motion.state in BUSY

    # --- stream and goal --------------------------------------------------------------------------

    def stream(self, T_base_flange: pin.SE3, *, begins: bool) -> Trip | None:
        """Follow a set point; the first one is where the arm is."""
        if begins:
            return None
        if self._motion.state in BUSY:  # it may end before this set point
            self._make_up()
        result = self._motion.solved(T_base_flange)
        if result.q is None:
            return tripped("robot_refuses", result.reason)
        self._streamed.append((self.arm.ticks + max(1, self._behind), T_base_flange, result.q))
        return None

    def goal(self, goal: Goal, speed: Speed) -> str:
        """Start a goal; return why it is refused."""
        self._make_up()
        self._streamed.clear()
        if goal.kind == "pose" and goal.pose is not None:
            return self._motion.start_pose(pose_of(goal.pose), speed)
        return self._motion.start_joints(joint_goal(goal, self._motion.q_command), speed)

    def goal_state(self) -> tuple[GoalState, str]:
        """Return the state of the goal: done when the arm has come to rest."""
        if self._motion.state == "refused":
            return "refused", self._motion.reason
        is_running = self._motion.state in BUSY or self.arm.moving
        return "running" if is_running else "done", ""

    def hold(self, *, begins: bool) -> None:
        """Brake; once at rest, command the measured pose, so that no command is pending."""
        if begins:
            self._make_up()
            self._streamed.clear()
            self._motion.brake()
            self._seeded = False
        if not self._seeded and self._motion.state not in BUSY and not self.arm.moving:
            self._motion.reseed(self.arm.q)
            self._seeded = True

    # --- signals ----------------------------------------------------------------------------------

    def signals(self) -> SignalReading:
        """Return the present state of the signals."""
        return self._signals.reading()

    def switch(self, number: int, on: bool) -> None:  # noqa: FBT001 - a `Switch`
        """Switch an output."""
        self._signals.switch(number, on)
