"""Guided push test: a person pushes the tool; the measured force must be along the push.

It only reads, so that it is the same with a real arm and in a cell on a virtual clock. The arm must
not be armed: a person's hands are on the tool.
"""

from math import hypot

import numpy as np

from cli.calibration.gather import Gatherer, ReadingLostError
from cli.terminal import ProgressOutput
from common.bus.configured_cell import ConfiguredCell
from common.motion.frames import Array
from forcemesh.clock import NS_PER_S
from identification.errors import CalibrationError
from identification.installation.payload import length_findings
from identification.installation.push import (
    LEAST,
    LEAST_COSINE,
    STEPS,
    USUAL_N,
    PushDetector,
    PushRequest,
    PushResult,
    cosine,
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
SAME_DIRECTION_COSINE = 0.9  # of two pushes for the same prompt
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
        self, cell: ConfiguredCell, output: ProgressOutput, *, within_s: float = PUSH_WITHIN_S
    ) -> None:
        """Subscribe; no request is sent. Each push must come within `within_s`."""
        self._cell, self._clock = cell, cell.session.clock
        self._output, self._within_s = output, within_s
        self._gatherer = Gatherer(cell)

    def run(self, expected: ExpectedInstallation) -> Installation:
        """Prompt for each push, evaluate them all. Raises CalibrationError with a remedy."""
        self._gatherer.until_received()
        lengths = length_findings(expected)
        done = [each for request in STEPS if (each := self._step(request)) is not None]
        findings, unidentified = judge_pushes(done, expected.in_metres())
        evidence = {
            f"push_{each.request.name}_{each.request.action}_cosine": each.cosine for each in done
        }
        return Installation(
            (*lengths, *findings, *_size_findings(done)),
            tuple(unidentified),
            evidence,
            shows_torques=not unidentified,
        )

    def _step(self, request: PushRequest) -> PushResult | None:
        """Prompt up to three times; a push in another direction counts when it is repeated."""
        last: PushResult | None = None
        for _ in range(TRIES):
            baseline = self._untouched_reading()
            self._output.note(PROMPTS[request.name, request.action])
            done = self._follow(request, baseline)
            if done is None:
                continue
            self._output.note(done.description)
            if done.cosine > LEAST_COSINE or (
                last is not None and cosine(last.change, done.change) > SAME_DIRECTION_COSINE
            ):
                return done
            last = done
        if last is None and request.action == "push":
            raise CalibrationError(
                f"no push of more than {LEAST['push']:g} N was measured along {request.name}: if "
                "you pushed, the sensor does not respond or its unit is too large (kgf, pounds)"
            )
        return last

    def _untouched_reading(self) -> Array:
        """Return the sensor reading while the tool is not touched. Shape (6,)."""

        def watch(text: str) -> None:
            self._refuse_armed()
            self._output.progress(0.0, 1.0, f"hands off the tool: {text}")

        for attempt in range(1, TRIES + 1):
            try:
                dwell = self._gatherer.dwell("fit", PUSH_REST_S, watch)
            except CalibrationError as error:
                self._refuse_armed()
                if attempt == TRIES:
                    raise
                self._output.note(f"take your hands off the tool: {error}")
            else:
                return np.concatenate((dwell.force_N.mean(axis=0), dwell.torque_Nm.mean(axis=0)))
        raise AssertionError  # the last attempt returns or raises

    def _follow(self, request: PushRequest, baseline: Array) -> PushResult | None:
        """Wait for a push; return None after the timeout."""
        detector, began_ns = PushDetector(request.action), self._clock.now_ns()
        while self._clock.now_ns() - began_ns < self._within_s * NS_PER_S:
            self._clock.sleep_s(PUSH_POLL_S)
            self._refuse_armed()
            try:
                sample = self._gatherer.take()
            except ReadingLostError:
                self._gatherer.until_received()
                detector = PushDetector(request.action)
                continue
            if sample is None:
                continue
            change = sample.reading - baseline
            self._show(request, sample.R_base_sensor, change)
            found = detector.update(sample.at_ns / NS_PER_S, change)
            if found is not None:
                return PushResult(request, found[:3], found[3:], sample.R_base_sensor)
        self._output.note(f"no {request.action} {request.name} within {self._within_s:g} s")
        return None

    def _show(self, request: PushRequest, R_base_sensor: Array, change: Array) -> None:
        unit, read = ("N", change[:3]) if request.action == "push" else ("N m", change[3:])
        x, y, z = R_base_sensor @ read
        text = f"{request.action} {request.name}: x {x:+6.2f}  y {y:+6.2f}  z {z:+6.2f} {unit}"
        size = hypot(*read)
        self._output.progress(min(size, FULL[request.action]), FULL[request.action], text)

    def _refuse_armed(self) -> None:
        status = self._cell.status.reading().fresh
        if status is not None and status.may_move:
            raise CalibrationError(
                f"the arm is {status.state}, but this test needs a person's hands on the tool: "
                "`forcemesh hold`, then `forcemesh clear`"
            )


def _size_findings(done: list[PushResult]) -> list[InstallationFinding]:
    """Return an unsure finding on the unit when pushes of about 10 N measure out of range."""
    sizes = [each.size for each in done if each.request.action == "push"]
    size, (low, high) = float(np.median(sizes)), USUAL_N
    if low <= size <= high:
        return []
    text = f"pushes of about 10 N were requested, {size:.3g} N were measured"
    remedy = "if you pushed with about 10 N, correct the force unit of the sensor"
    return [InstallationFinding("force_unit", text, remedy, "unsure")]
