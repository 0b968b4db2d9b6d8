"""Motion queue of the robot program: one active motion, one ahead, superposed while blending.

CP ON: the next motion starts once the active one is within its ACCURACY and decelerating; the
two displacements are added in joint space. CP OFF: it starts when the arm has arrived. The program
waits at the next motion's step until then ("one motion ahead").
"""

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

    def __init__(self, motion: MotionRequest) -> None:
        """Create the ticket of a motion that has not started."""
        self.motion = motion
        self.state: TicketState = "waiting"


class MotionQueue:
    """Motion queue with one joint command per tick. Open loop: the caller passes `arrived`."""

    def __init__(self, kinematics: ArmKinematics, q_start: Array) -> None:
        """Start at rest at q_start [rad]. Shape (6,)."""
        self._kinematics = kinematics
        self._active: list[tuple[Segment, Ticket]] = []
        self._pause_s = 0.0
        self._pausing: Ticket | None = None
        self.ahead: Ticket | None = None
        self.continuous_path = True
        self.monitor_fraction = 0.1
        self.held = False
        self.q_command: Array = np.array(q_start, dtype=float)
        self.q_end: Array = self.q_command  # end of the last queued motion
        self._base: Array = self.q_command  # base of the displacements of the active segments
        self.last: MotionRequest | None = None

    # --- interface for the program ----------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether a motion is active or queued."""
        return self.is_moving or self.ahead is not None

    @property
    def is_moving(self) -> bool:
        """Whether the command is changing, or a pause is active."""
        return bool(self._active) or self._pausing is not None

    def offer(self, motion: MotionRequest, *, arrived: bool) -> Ticket:
        """Queue a motion; it starts at once if no motion is active.

        Raises AsError if its target cannot be reached from the end of the last motion.
        """
        ticket = Ticket(motion)
        joint_target(self._kinematics, motion, self.q_end)
        self.ahead = ticket
        self._try_start(arrived=arrived)
        return ticket

    def remaining_m(self) -> float:
        """Return the remaining distance of the newest motion's command [m]."""
        return self._remaining_m(self._active[-1][0]) if self._active else 0.0

    # --- stopping ---------------------------------------------------------------------------------

    def brake(self, *, keep_ahead: bool) -> None:
        """Stop and discard the active motions; also the motion ahead unless kept."""
        self.fail()
        self._end_pause()
        if not keep_ahead:
            self.drop_ahead()

    def drop_ahead(self) -> None:
        """Discard the motion ahead."""
        if self.ahead is not None:
            self.ahead.state, self.ahead = "dropped", None

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
        if self.ahead is None or self.held or not self._may_start(self.ahead, arrived=arrived):
            return
        ticket, motion = self.ahead, self.ahead.motion
        if motion.kind == "pause":
            self._pause_s, self._pausing = motion.pause_s, ticket
        else:
            try:
                segment = plan(self._kinematics, motion, self.q_end)
            except AsError:
                self.drop_ahead()
                raise
            if not self._active:
                self._base = self.q_command
            self._active.append((segment, ticket))
            self.q_end = segment.q_to
        ticket.state, self.ahead, self.last = "under way", None, motion

    def _may_start(self, ticket: Ticket, *, arrived: bool) -> bool:
        if self._pausing is not None:
            return False
        blends = self.continuous_path and ticket.motion.kind != "pause"
        if not self._active:
            return arrived or blends
        segment, running = self._active[-1]
        if not blends or segment.braking or not segment.slowing:
            return False
        return self._remaining_m(segment) <= running.motion.manner.accuracy_m

    def _remaining_m(self, segment: Segment) -> float:
        here, end = (self._kinematics.flange_pose(q) for q in (segment.q, segment.q_to))
        return float(np.linalg.norm(here.translation - end.translation))
