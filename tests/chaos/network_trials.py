"""Procedure of one trial: approach, apply the fault to a wire, remove it, evaluate the arm."""

import random
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from forcemesh.errors import ForcemeshError
from tests.chaos.common_net import CellUnderTest, HarnessError
from tests.chaos.network_faults import Ends
from tests.chaos.network_judge import (
    MOVES_M_S,
    GroundTruthTrace,
    TrialBounds,
    TrialObservations,
    TrialVerdict,
    judge,
)
from tests.chaos.witness import STALL_S, Witness

PRESS_N = 10.0
CLEARANCE_M = 0.03  # start height of an approach above the initial height of the flange
TRAVEL_S = 0.05, 0.4  # time of the fault after the start of the approach
SET_OUT_S = 3.0
WATCH_S = 1.5  # after the heal; the arm must be at rest
FRESH_S = 5.0
ATTEMPTS = 4


@dataclass(frozen=True, slots=True)
class NetworkTrial:
    """One fault on one wire. `end` returns its number of effects."""

    wire: str
    fault: str
    begin: Callable[[], None]
    end: Callable[[], int]
    lasts_s: float
    ends: Ends
    bounds: TrialBounds


class Bench:
    """Running cell with the ground truth of its arm and a witness."""

    def __init__(
        self, cell: CellUnderTest, truth: GroundTruthTrace, witness: Witness, rng: random.Random
    ) -> None:
        """Tare, and store the height of the arm."""
        self.cell, self.truth, self.witness, self._rng = cell, truth, witness, rng
        self._counted_stalls = 0
        cell.tare()
        self._high_m = cell.height_m() + CLEARANCE_M

    def run(self, trial: NetworkTrial) -> tuple[TrialVerdict, TrialObservations, int]:
        """Run a trial; also return the number of repetitions.

        It is repeated if the machine stalled, and if a random loss hit no packet.
        """
        repeated = 0
        while True:
            verdict, observed = self._once(trial)
            if trial.ends == "either" and not observed.bites and repeated < ATTEMPTS - 1:
                repeated += 1
                continue
            doubtful = verdict.mistakes or (observed.held and trial.ends != "held")
            if not doubtful or observed.stall_s < STALL_S:
                return verdict, observed, repeated
            if repeated == ATTEMPTS - 1:
                stalled = f"the machine stalled in every attempt, {observed.stall_s * 1e3:.0f} ms"
                mistakes = (*verdict.mistakes, stalled) if verdict.mistakes else ()
                return replace(verdict, mistakes=mistakes), observed, repeated
            repeated += 1

    def _once(self, trial: NetworkTrial) -> tuple[TrialVerdict, TrialObservations]:
        self._approach()
        mark = max(0, self.truth.mark() - 20)
        began_ns = time.monotonic_ns()
        trial.begin()
        try:
            time.sleep(trial.lasts_s)
        finally:
            bites = trial.end()
        healed_ns = time.monotonic_ns()
        time.sleep(WATCH_S)
        observed = self._observe(trial, began_ns, healed_ns, bites)
        return judge(observed, *self.truth.speeds(mark), trial.bounds), observed

    def _approach(self) -> None:
        """Approach under force feedback, faster than 2 mm/s, to a random height."""
        why: list[str] = []
        for _ in range(ATTEMPTS):
            try:
                self._set_out()
            except ForcemeshError as error:  # occasional machine stalls
                why.append(str(error))
                continue
            time.sleep(self._rng.uniform(*TRAVEL_S))
            if self.truth.speed_now() > MOVES_M_S and self.cell.state == "ACTIVE":
                return
            why.append(f"it stopped: {self.cell.causes()}")
        raise HarnessError(f"the arm does not keep moving: {'; '.join(why)}")

    def _set_out(self) -> None:
        cell = self.cell
        cell.make_ready()
        cell.move_to(self._high_m, speed_m_s=0.1)
        cell.press(PRESS_N)
        cell.until(lambda: self.truth.speed_now() > MOVES_M_S, "the arm moves", SET_OUT_S)

    def _observe(
        self, trial: NetworkTrial, began_ns: int, healed_ns: int, bites: int
    ) -> TrialObservations:
        """Observe the cell after the heal, once all topics are fresh again."""
        cell = self.cell
        are_fresh = lambda: cell.status is not None and cell.robot is not None  # noqa: E731
        cell.until(are_fresh, "arbiter and robot topics are fresh again", FRESH_S)
        status, robot = cell.status, cell.robot
        if status is None or robot is None:
            raise HarnessError("arbiter or robot topic expired again")
        return TrialObservations(
            began_ns=began_ns,
            healed_ns=healed_ns,
            accepted_ns=None if robot.accepted is None else robot.accepted.at_ns,
            held=not status.operational,
            causes=cell.causes(),
            bites=bites,
            ends=trial.ends,
            stall_s=self.witness.worst_s(began_ns, time.monotonic_ns()),
        )
