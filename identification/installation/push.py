"""Axis check by pushes and twists by hand: detector and evaluation, fed sample by sample. Pure.

Only the direction of a push is used: its size is unknown, its direction off by some degrees and
unsteady. The reading before it is subtracted, so weight, bias and calibration do not matter.
"""

from dataclasses import dataclass, field
from math import hypot
from typing import Literal, NamedTuple

import numpy as np

from common.motion.frames import Array
from identification.installation.axes import (
    driver_remedy,
    same,
    turned_finding,
    uncertain_torques,
    wrong_channels,
)
from identification.installation.axis_fit import EYE, SIGNED
from identification.installation.terms import ExpectedInstallation, InstallationFinding

PushAction = Literal["push", "twist"]
LEAST = {"push": 3.0, "twist": 0.15}  # N, N m
USUAL_N = (3.0, 40.0)  # range of a push when 10 N are requested
FULL_SHARE = 0.7  # of the peak: samples above it count
END_SHARE = 0.4  # of the peak: the push is over
LEAST_DURATION_S = 0.15  # shorter ones are knocks
LEAST_COSINE = float(np.cos(np.radians(30.0)))
LEAST_MOMENT_COSINE = float(np.cos(np.radians(50.0)))  # the hand is not exactly at the tip
LEVER_M, MOMENT_NM = 0.03, 0.1  # less is not evaluated


class PushRequest(NamedTuple):
    """Push or twist that the operator is asked for, in base axes."""

    name: str
    action: PushAction
    direction: tuple[float, float, float]


STEPS = (
    PushRequest("+x", "push", (1.0, 0.0, 0.0)),
    PushRequest("+y", "push", (0.0, 1.0, 0.0)),
    PushRequest("+z", "push", (0.0, 0.0, 1.0)),
    PushRequest("+z", "twist", (0.0, 0.0, 1.0)),
)


@dataclass(frozen=True, slots=True)
class PushResult:
    """Change of the reading during a push or twist. Sensor axes, about the sensor's origin."""

    request: PushRequest
    change_N: Array
    change_Nm: Array
    R_base_sensor: Array

    @property
    def change(self) -> Array:
        """Return the change of the force by a push [N], of the torque by a twist [N m]."""
        return self.change_N if self.request.action == "push" else self.change_Nm

    @property
    def direction(self) -> Array:
        """Return the requested direction in sensor axes."""
        return np.asarray(self.R_base_sensor.T @ np.array(self.request.direction))

    @property
    def cosine(self) -> float:
        """Return the cosine between the requested and the measured direction."""
        return cosine(self.change, self.direction)

    @property
    def size(self) -> float:
        """Return the size of the change [N or N m]."""
        return hypot(*self.change)

    @property
    def description(self) -> str:
        """Return the result as text, in base axes."""
        x, y, z = self.R_base_sensor @ self.change
        unit = "N" if self.request.action == "push" else "N m"
        reading = f"read x {x:+.2f}, y {y:+.2f}, z {z:+.2f} {unit}"
        verdict = "right" if self.cosine > LEAST_COSINE else "not along it"
        return f"{self.request.action} {self.request.name}: {reading}: {verdict}"


@dataclass(slots=True)
class PushDetector:
    """Detector of one push or twist: threshold, peak and end."""

    action: PushAction
    _samples: list[tuple[float, float, Array]] = field(default_factory=list)  # time, size, change
    _peak: float = 0.0

    def update(self, time_s: float, change: Array) -> Array | None:
        """Take the change of the reading from rest; return the mean of the push when it is over.

        Args:
            time_s: Time of the sample, on any clock.
            change: Change of force [N] and torque [N m] from rest. Shape (6,).
        """
        size = hypot(*change[:3] if self.action == "push" else change[3:])
        if not self._samples and size < LEAST[self.action]:
            return None
        self._peak = max(self._peak, size)
        self._samples.append((time_s, size, change))
        if size > END_SHARE * self._peak:
            return None
        full = [(t, v) for t, s, v in self._samples if s >= FULL_SHARE * self._peak]
        duration_s = full[-1][0] - full[0][0]
        self._samples, self._peak = [], 0.0
        if duration_s < LEAST_DURATION_S:
            return None
        return np.asarray(np.mean([v for _, v in full], axis=0))


def judge_pushes(
    done: list[PushResult], expected: ExpectedInstallation
) -> tuple[list[InstallationFinding], list[str]]:
    """Return the findings on axes and signs of three pushes and a twist, and what is not shown.

    Args:
        done: Pushes along +x, +y and +z of the base at the tip of the tool, and twists.
        expected: Expected installation, from the cell file.
    """
    pushes = [each for each in done if each.request.action == "push"]

    def cosines(W: Array) -> list[float]:
        return [cosine(W @ push.direction, push.change_N) for push in pushes]

    wiring: Array = max(SIGNED, key=lambda W: sum(cosines(W)))
    if min(cosines(wiring)) <= LEAST_COSINE:
        text = "the pushes fit no axis map: they were not along the axes, or not in this order"
        return [
            InstallationFinding("pushes", text, "repeat them, along the axes of the base", "unsure")
        ], []
    torques = _torque_wirings(done, expected)
    finding = _finding(wiring, torques, expected)
    unidentified = []
    if len(torques) > 1:
        rows = ", ".join(uncertain_torques(torques))
        unidentified = [f"all of {rows}: push at the tip of the tool, and twist it"]
    return ([] if finding is None else [finding]), unidentified


def cosine(a: Array, b: Array) -> float:
    """Return the cosine of the angle between two vectors; 0 when one of them is zero."""
    return float(a @ b) / max(hypot(*a) * hypot(*b), 1e-12)


def _torque_wirings(done: list[PushResult], expected: ExpectedInstallation) -> list[Array]:
    """Return every signed permutation of the torques that explains the measured moments.

    A push at the tip has a moment about the sensor's origin by its lever, if the tool is known.
    """
    pairs = []
    for each in done:
        if each.request.action == "twist":
            moment, lever_m = each.direction, LEVER_M
        elif expected.p_sensor_tcp_m is None:
            continue
        else:
            moment = np.cross(expected.p_sensor_tcp_m, each.direction)
            lever_m = hypot(*moment)
        if lever_m >= LEVER_M and hypot(*each.change_Nm) >= MOMENT_NM:
            pairs.append((moment, each.change_Nm))
    return [W for W in SIGNED if all(cosine(W @ t, r) > LEAST_MOMENT_COSINE for t, r in pairs)]


def _finding(
    wiring: Array, torques: list[Array], expected: ExpectedInstallation
) -> InstallationFinding | None:
    right = any(same(W, EYE) for W in torques)
    if same(wiring, EYE):
        if right:
            return None
        if not torques:
            text = "the forces are right, but the torques match no axis of the pushes and twists"
            remedy = "push at the tip of the tool, then check again"
            return InstallationFinding("torque_axes", text, remedy)
        W = max(torques, key=lambda W: float(np.trace(W)))
        text = f"the forces are right, but of the torques {wrong_channels(W, 'M')}"
        return InstallationFinding("torque_axes", text, driver_remedy(W, "M"))
    torques_match = any(same(W, wiring) for W in torques)
    if torques_match and np.linalg.det(wiring) > 0.0:
        return turned_finding(wiring, expected, shown=not right)
    remedy = driver_remedy(wiring, "FM" if torques_match else "F")
    if same(wiring, -EYE):
        text = (
            "the force reads against the push: the sensor reports reactions, or its sign is wrong"
        )
        return InstallationFinding("reaction", text, remedy)
    torque_text = ", and the torques alike" if torques_match else ""
    text = f"of the forces {wrong_channels(wiring, 'F')}{torque_text}: no mounting does that"
    return InstallationFinding("force_axes", text, remedy)
