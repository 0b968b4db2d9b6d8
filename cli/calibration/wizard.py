"""Calibration sequence: moves the arm through a plan and reads at each pose.

The wizard is an ordinary client of the cell, so it runs against real processes and in a cell on a
virtual clock. The recorded readings stay in `dwells`, however the sequence ends.
"""

from functools import partial
from itertools import pairwise

import numpy as np

from cli.calibration.drive import Drive, refuse_relieved
from cli.calibration.gather import Gatherer
from cli.terminal import ProgressOutput
from common.bus.configured_cell import ConfiguredCell
from common.motion.frames import Array
from forcemesh.clock import NS_PER_S
from forcemesh.errors import RefusedError
from identification.dwells import Dwell, Purpose
from identification.errors import InContactError, PoseRefusedError
from identification.excitation.plan import CalibrationPlan
from identification.excitation.stillness import STILLNESS_WINDOW_S

BOTH: tuple[Purpose, ...] = ("fit", "verify")
FREE_READ_S = 0.2  # long enough to detect contact above the sensor's noise
RAMP_S = 0.5  # acceleration, deceleration and detection of the arrival


class CalibrationWizard:
    """One calibration, from arming to the return to the start."""

    def __init__(
        self,
        cell: ConfiguredCell,
        plan: CalibrationPlan,
        output: ProgressOutput,
    ) -> None:
        """Subscribe; nothing moves before `run`."""
        self.plan = plan
        self.dwells: list[Dwell] = []
        self._cell, self._clock = cell, cell.session.clock
        self.output = output  # may be replaced for the return
        self._drive = Drive(cell, plan.options.speed_m_s)
        self.gatherer = Gatherer(cell)
        self._q: Array = plan.route.q_start
        self._done_s, self._total_s = 0.0, expected_s(plan)
        self._stage = ""
        self._begun = False

    def run(self, purposes: tuple[Purpose, ...] = BOTH) -> None:
        """Arm, visit every pose, return to the start and restore the armed state.

        Raises ForcemeshError with the reason of an early end; the arm then stays where it is.
        """
        self.measure(purposes)
        self.return_to_start()

    def measure(self, purposes: tuple[Purpose, ...] = BOTH) -> None:
        """Arm and visit every pose; the arm stays armed at the last one. Raises as `run`."""
        self._total_s = expected_s(self.plan, purposes)
        self.gatherer.until_received()
        self._begun = True  # also when interrupted before the reply
        try:
            self.output.note(self._drive.arm())
        except RefusedError:
            self._begun = False
            raise
        self._lift()
        for purpose in purposes:
            self._visit_all(purpose)

    def return_to_start(self) -> None:
        """Return to the start and restore the armed state. Raises as `run`."""
        self._stage = "back to the start"
        self._move_through(
            [self.plan.route.hub, *self.plan.route.goals_to_start(self.plan.route.hub)]
        )
        self._drive.release()
        self.output.note("the arm has returned to its start")

    def abandon(self, reason: str) -> str:
        """Hold the arm if it was armed for this calibration; return the text of the reply."""
        return self._drive.hold(reason) if self._begun else "nothing was moved"

    def _lift(self) -> None:
        """Move to the hub above the start. Raises InContactError when the force changes."""
        self._stage = "to the hub"
        goals = self.plan.route.goals_to_hub(self._q)
        if not goals:
            return
        before_N = self._force_N()
        self._move_through(goals)
        after_N = self._force_N()
        try:
            refuse_relieved(before_N, after_N, self.plan.route.lift_m, self._cell.config)
        except InContactError:
            self._drive.release()
            raise

    def _force_N(self) -> Array:
        """Return the mean measured force at the present pose, sensor axes. Shape (3,)."""
        return np.asarray(self._read("fit", FREE_READ_S).force_N.mean(axis=0))

    def _visit_all(self, purpose: Purpose) -> None:
        visited: list[int] = []
        while True:
            places = self.plan.fit if purpose == "fit" else self.plan.verify
            remaining = [place for place in places if place not in visited]
            if not remaining:
                return
            self._stage = f"pose {len(visited) + 1} of {len(places)}"
            if purpose == "verify":
                self._stage = f"verifying, {self._stage}"
            try:
                self._move_through(self.plan.route.goals(self._q, self.plan.q[remaining[0]]))
            except PoseRefusedError as error:
                self.output.note(f"{self._stage} is skipped, another pose is used: {error}")
                self.plan = self.plan.without(remaining[0])
                # A refused goal may have ended between poses: the path back is free.
                if np.abs(self._drive.state().joint_rad - self._q).max() > np.radians(0.3):
                    self._move_through([self._q])
                continue
            visited.append(remaining[0])
            self.dwells.append(self._read(purpose, self.plan.options.dwell_s))

    def _read(self, purpose: Purpose, duration_s: float) -> Dwell:
        began_ns = self._clock.now_ns()
        expected_s = STILLNESS_WINDOW_S + duration_s

        def watch(text: str) -> None:
            self._drive.check()
            self._report_progress(text, began_ns, expected_s)

        dwell = self.gatherer.dwell(purpose, duration_s, watch)
        self._done_s += expected_s
        return dwell

    def _move_through(self, stops: list[Array]) -> None:
        """Move from stop to stop. Raises PoseRefusedError when one of them is refused."""
        for q in stops:
            length_m = self.plan.route.length_m(self._q, q)
            expected_s = length_m / self.plan.options.speed_m_s + RAMP_S
            began_ns = self._clock.now_ns()
            report = partial(self._report_progress, began_ns=began_ns, expected_s=expected_s)
            self._drive.move_joints(q, length_m, report)
            self._q = q
            self._done_s += expected_s

    def _report_progress(self, text: str, began_ns: int, expected_s: float) -> None:
        spent_s = (self._clock.now_ns() - began_ns) / NS_PER_S
        done_s = self._done_s + min(spent_s, expected_s)
        self.output.progress(min(done_s, self._total_s), self._total_s, f"{self._stage}: {text}")


def expected_s(plan: CalibrationPlan, purposes: tuple[Purpose, ...] = BOTH) -> float:
    """Return the approximate duration of a plan [s]."""
    route = plan.route
    places = [p for purpose in purposes for p in (plan.fit if purpose == "fit" else plan.verify)]
    stops = [route.q_start, route.hub, *(plan.q[place] for place in places), route.hub]
    travel_m = sum(route.length_m(a, b) for a, b in pairwise(stops))
    travel_m += route.length_m(route.hub, route.q_start)
    moving_s = travel_m / plan.options.speed_m_s + RAMP_S * (len(stops) + 1)
    free_s = 2.0 * (STILLNESS_WINDOW_S + FREE_READ_S) if route.goals_to_hub(route.q_start) else 0.0
    return moving_s + free_s + len(places) * (STILLNESS_WINDOW_S + plan.options.dwell_s)
