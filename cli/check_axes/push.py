"""Guided push test: a person pushes the tool; the measured force must be along the push.

It only reads, so that it is the same with a real arm and in a cell on a virtual clock. The arm must
not be armed: a person's hands are on the tool.
"""

import numpy as np

from cli.calibration.gather import Gatherer, ReadingLostError
from cli.calibration.tell import Teller
from common.config.cell import CellConfig
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from identification.dwells import Dwell
from identification.errors import CalibrationError
from identification.installation.payload import length_findings
from identification.installation.push import (
    ALONG,
    LEAST,
    STEPS,
    USUAL_N,
    PushDetector,
    PushRequest,
    PushResult,
    judge_pushes,
)
from identification.installation.terms import (
    ExpectedInstallation,
    Installation,
    InstallationFinding,
)

PUSH_POLL_S = 0.002
PUSH_WITHIN_S = 30.0  # for each push
TRIES = 3
PUSH_REST_S = 0.3
ALIKE = 0.9  # cosine
FULL = {"push": 10.0, "twist": 0.5}  # full scale of the bar: N, N m
PROMPTS = {
    ("+x", "push"): "push the tip of the tool along +x of the base with about 10 N, then let go",
    ("+y", "push"): "push the tip of the tool along +y of the base with about 10 N, then let go",
    ("+z", "push"): "push the tool straight up (+z of the base) with about 10 N, then let go",
    ("+z", "twist"): "twist the tool anticlockwise as seen from above, with some 0.5 N m, let go",
}


class PushTest:
    """Guided push test of one cell."""

    def __init__(
        self, bus: Bus, cell: CellConfig, teller: Teller, *, within_s: float = PUSH_WITHIN_S
    ) -> None:
        """Subscribe; no request is sent. Each push must come within `within_s`."""
        self._clock, self._teller, self._within_s = bus.clock, teller, within_s
        self._gatherer = Gatherer(bus, cell)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)

    def run(self, belief: ExpectedInstallation) -> Installation:
        """Prompt for each push, evaluate them all. Raises CalibrationError with a remedy."""
        self._gatherer.until_heard()
        lengths = length_findings(belief)
        done = [each for asked in STEPS if (each := self._step(asked)) is not None]
        findings, unseen = judge_pushes(done, belief.in_metres())
        sizes = [each.size for each in done if each.asked.by == "push"]
        evidence = {f"push_{each.asked.name}_{each.asked.by}_cosine": each.along for each in done}
        return Installation((*lengths, *findings, *_of_size(sizes)), tuple(unseen), evidence)

    def _step(self, asked: PushRequest) -> PushResult | None:
        """Prompt up to three times; a push in another direction counts when it is repeated."""
        last: PushResult | None = None
        for _ in range(TRIES):
            rest = self._rest()
            self._teller.note(PROMPTS[asked.name, asked.by])
            done = self._follow(asked, rest)
            if done is None:
                continue
            self._teller.note(done.words)
            if done.along > ALONG or (last is not None and _alike(last, done)):
                return done
            last = done
        if last is None and asked.by == "push":
            raise CalibrationError(
                f"no push of more than {LEAST['push']:g} N was measured along {asked.name}: if "
                "you pushed, the sensor does not respond or its unit is too large (kgf, pounds)"
            )
        return last

    def _rest(self) -> Array:
        """Return the sensor reading while the tool is not touched. Shape (6,)."""

        def watch(what: str) -> None:
            self._refuse_armed()
            self._teller.progress(0.0, 1.0, f"hands off the tool: {what}")

        for attempt in range(1, TRIES + 1):
            try:
                dwell = self._gatherer.dwell("fit", PUSH_REST_S, watch)
            except CalibrationError as error:
                self._refuse_armed()
                if attempt == TRIES:
                    raise
                self._teller.note(f"take your hands off the tool: {error}")
            else:
                return _reading(dwell)
        raise AssertionError  # the last attempt returns or raises

    def _follow(self, asked: PushRequest, rest: Array) -> PushResult | None:
        """Wait for a push; return None after the timeout."""
        follower, began_ns = PushDetector(asked.by), self._clock.now_ns()
        while self._clock.now_ns() - began_ns < self._within_s * NS_PER_S:
            self._clock.sleep_s(PUSH_POLL_S)
            self._refuse_armed()
            try:
                sample = self._gatherer.take()
            except ReadingLostError:
                self._gatherer.until_heard()
                follower = PushDetector(asked.by)
                continue
            if sample is None:
                continue
            grown = sample.reading - rest
            self._show(asked, sample.R_base_sensor, grown)
            found = follower.see(sample.at_ns / NS_PER_S, grown)
            if found is not None:
                return PushResult(asked, found[:3], found[3:], sample.R_base_sensor)
        self._teller.note(f"no {asked.by} {asked.name} within {self._within_s:g} s")
        return None

    def _show(self, asked: PushRequest, R_base_sensor: Array, grown: Array) -> None:
        unit, read = ("N", grown[:3]) if asked.by == "push" else ("N m", grown[3:])
        x, y, z = R_base_sensor @ read
        text = f"{asked.by} {asked.name}: x {x:+6.2f}  y {y:+6.2f}  z {z:+6.2f} {unit}"
        size = float(np.linalg.norm(read))
        self._teller.progress(min(size, FULL[asked.by]), FULL[asked.by], text)

    def _refuse_armed(self) -> None:
        status = self._arbiter.read(self._clock.now_ns()).fresh
        if status is not None and status.may_move:
            raise CalibrationError(
                f"the arm is {status.state}, but this test needs a person's hands on the tool: "
                "`forcemesh hold`, then `forcemesh clear`"
            )


def _reading(dwell: Dwell) -> Array:
    return np.concatenate((dwell.force_N.mean(axis=0), dwell.torque_Nm.mean(axis=0)))


def _alike(a: PushResult, b: PushResult) -> bool:
    """Return whether two pushes for the same prompt have about the same direction."""
    one, other = (d.grown_N if d.asked.by == "push" else d.grown_Nm for d in (a, b))
    return float(one @ other) > ALIKE * float(np.linalg.norm(one) * np.linalg.norm(other))


def _of_size(sizes: list[float]) -> list[InstallationFinding]:
    """Return an unsure finding on the unit when pushes of about 10 N measure out of range."""
    size, (low, high) = float(np.median(sizes)), USUAL_N
    if low <= size <= high:
        return []
    text = f"pushes of about 10 N were requested, {size:.3g} N were measured"
    remedy = "if you pushed with about 10 N, correct the force unit of the sensor"
    return [InstallationFinding("force_unit", text, remedy, "unsure")]
