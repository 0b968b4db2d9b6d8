"""Motion queue of the robot program: one active motion, others ahead, superposed while blending.

CP ON: the next motion starts once the active one is within its ACCURACY and decelerating; the
two displacements are added in joint space. CP OFF: it starts when the arm has arrived. The program
waits at the next motion's step until then ("one motion ahead"), or while the queue is full.
"""

from collections import deque
from typing import Literal

import numpy as np

from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from sim.as_language.errors import AsError
from sim.controller.motion_requests import MotionRequest
from sim.controller.planner import Segment, joint_target, plan

TicketState = Literal["waiting", "under way", "finished", "dropped"]


class Ticket:
    """State of a queued motion."""

    def __init__(self, motion: MotionRequest, q_to: Array) -> None:
        """Create the ticket of a motion that has not started; it ends at q_to [rad]. Shape (6,)."""
        self.motion, self.q_to = motion, q_to
        self.state: TicketState = "waiting"


class MotionQueue:
    """Motion queue with one joint command per tick. Open loop: the caller passes `arrived`."""

    def __init__(
        self,
        kinematics: ArmKinematics,
        q_start: Array,
        *,
        motions_ahead: int = 1,
        least_segment_s: float = 0.0,
    ) -> None:
        """Start at rest at q_start [rad]. Shape (6,).

        Args:
            kinematics: Kinematics of the arm.
            q_start: Joint angles [rad]. Shape (6,).
            motions_ahead: Motions that a program may have beyond the active one, with the one at
                whose step it waits.
            least_segment_s: Least planned duration of a motion that blends into the next one [s].
        """
        self._kinematics = kinematics
        self._motions_ahead, self._least_segment_s = motions_ahead, least_segment_s
        self._active: list[tuple[Segment, Ticket]] = []
        self._pause_s = 0.0
        self._pausing: Ticket | None = None
        self._waiting: deque[Ticket] = deque()  # not started, in order
        self.continuous_path = True
        self.monitor_fraction = 0.1
        self.held = False
        self.q_command: Array = np.array(q_start, dtype=float)
        self.q_end: Array = self.q_command  # end of the motion that started last
        self._base: Array = self.q_command  # base of the displacements of the active segments
        self.last: MotionRequest | None = None

    # --- interface for the program ----------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether a motion is active or queued."""
        return self.is_moving or self.is_ahead

    @property
    def is_ahead(self) -> bool:
        """Whether a motion is queued that has not started."""
        return bool(self._waiting)

    @property
    def is_full(self) -> bool:
        """Whether the program waits at the step of the newest motion."""
        return len(self._waiting) >= self._motions_ahead

    @property
    def is_moving(self) -> bool:
        """Whether the command is changing, or a pause is active."""
        return bool(self._active) or self._pausing is not None

    def offer(self, motion: MotionRequest, *, arrived: bool) -> Ticket:
        """Queue a motion; it starts at once if no motion is active.

        Raises AsError if its target cannot be reached from the end of the last motion.
        """
        ticket = Ticket(motion, joint_target(self._kinematics, motion, self.q_newest))
        self._waiting.append(ticket)
        self._try_start(arrived=arrived)
        return ticket

    @property
    def q_newest(self) -> Array:
        """Joint angles at the end of the newest motion, also one that waits [rad]. Shape (6,)."""
        return self._waiting[-1].q_to if self._waiting else self.q_end

    def axes_coincide(self, *, arrived: bool) -> bool:
        """Return whether the newest motion has reached its end: the next one could start.

        With CP ON its command is within ACCURACY and decelerating; with CP OFF the arm has arrived.
        """
        return not self._waiting and self._may_start(blends=self.continuous_path, arrived=arrived)

    def remaining_m(self) -> float:
        """Return the remaining distance of the newest motion's command [m]."""
        return self._remaining_m(self._active[-1][0]) if self._active else 0.0

    # --- stopping ---------------------------------------------------------------------------------

    def brake(self, *, keep_ahead: bool, by_decel: bool = False) -> None:
        """Stop and discard the active motions; also the motions ahead unless kept.

        `by_decel`: with the DECEL of the motions instead of the largest deceleration.
        """
        self.fail()
        for segment, _ in self._active if by_decel else ():
            segment.ramp = segment.ramp._replace(brake=segment.ramp.decel)
        self._end_pause()
        if not keep_ahead:
            self.drop_ahead()

    def drop_ahead(self) -> None:
        """Discard the motions ahead."""
        for ticket in self._waiting:
            ticket.state = "dropped"
        self._waiting.clear()

    def reseed(self, q: Array) -> None:
        """Discard all motions and hold q [rad], after the motors were off. Shape (6,)."""
        for _, ticket in self._active:
            ticket.state = "dropped"
        self._active.clear()
        self.brake(keep_ahead=False)
        self.q_command = np.array(q, dtype=float)
        self.q_end = self.q_command

    # --- time -------------------------------------------------------------------------------------

    def tick(self, dt_s: float, *, arrived: bool) -> None:
        """Advance by one tick.

        `arrived`: the arm has reached its last command. Raises AsError if a motion cannot be
        continued; all active motions are then braked or discarded.
        """
        if not self.busy:
            return
        feed = 0.0 if self.held else self.monitor_fraction
        try:
            for segment, _ in self._active:
                segment.tick(dt_s, feed)
        finally:
            self._gather()
        if self._pausing is not None and not self.held and not self._active:
            self._pause_s -= dt_s
            if self._pause_s <= 1e-9:
                self._end_pause("finished")
        self._try_start(arrived=arrived)

    def _gather(self) -> None:
        """Add the displacements; remove completed segments."""
        if not self._active:
            return
        q = self._base + sum(segment.covered for segment, _ in self._active)
        violation = self._kinematics.limit_violation(q)
        if violation:
            self.fail()
            raise AsError("E6007", f"during blending, {violation}")
        self.q_command = q
        while self._active and self._active[0][0].done:
            segment, ticket = self._active.pop(0)
            ticket.state = "dropped" if segment.braking and segment.share < 1.0 else "finished"
            self._base = self._base + segment.covered
        if not self._active:
            self.q_end = self.q_command

    def fail(self) -> None:
        """Brake all segments: an active motion cannot be continued."""
        for segment, _ in self._active:
            segment.braking = True

    def _end_pause(self, state: TicketState = "dropped") -> None:
        if self._pausing is not None:
            self._pausing.state, self._pausing = state, None

    # --- starting ---------------------------------------------------------------------------------

    def _try_start(self, *, arrived: bool) -> None:
        if not self._waiting or self.held:
            return
        ticket = self._waiting[0]
        motion = ticket.motion
        blends = self.continuous_path and motion.kind != "pause"
        if not self._may_start(blends=blends, arrived=arrived):
            return
        if motion.kind == "pause":
            self._pause_s, self._pausing = motion.pause_s, ticket
        else:
            try:
                self._refuse_short_segment()
                segment = plan(self._kinematics, motion, self.q_end)
            except AsError:
                self.drop_ahead()
                raise
            if not self._active:
                self._base = self.q_command
            self._active.append((segment, ticket))
            self.q_end = segment.q_to
        self._waiting.popleft()
        ticket.state, self.last = "under way", motion

    def _refuse_short_segment(self) -> None:
        """Raise AsError E1117 if the active motion is too short to blend into the next one."""
        if not self._active:
            return
        planned_s = self._active[-1][0].planned_s(self.monitor_fraction)
        if planned_s < self._least_segment_s:
            least = f"a motion that blends needs {1e3 * self._least_segment_s:.0f} ms"
            raise AsError("E1117", f"planned for {1e3 * planned_s:.1f} ms, {least}")

    def _may_start(self, *, blends: bool, arrived: bool) -> bool:
        if self._pausing is not None:
            return False
        if not self._active:
            return arrived or blends
        segment, running = self._active[-1]
        if not blends or segment.braking or not segment.slowing:
            return False
        return self._remaining_m(segment) <= running.motion.manner.accuracy_m

    def _remaining_m(self, segment: Segment) -> float:
        here, end = (self._kinematics.flange_pose(q) for q in (segment.q, segment.q_to))
        return float(np.linalg.norm(here.translation - end.translation))
