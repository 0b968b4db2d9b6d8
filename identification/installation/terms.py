"""Expected installation from the cell file, findings, and result of the check. Pure."""

from dataclasses import dataclass, field, replace
from math import hypot
from typing import Literal

import numpy as np

from common.config.calibration import CalibrationSection
from common.config.cell import CellConfig
from common.config.payload import DOWN
from common.motion.frames import Array

Verdict = Literal["right", "wrong", "cannot tell"]
# A wrong axis, sign or unit; a wrong payload in the cell file; more readings are needed.
FindingKind = Literal["installation", "payload", "unsure"]


LONGEST_M = 2.0  # sensors and tools are closer to the flange


def in_millimetres(length_m: Array) -> bool:
    """Return whether a vector of the cell file must be in millimetres."""
    return hypot(*length_m) > LONGEST_M


@dataclass(frozen=True, slots=True)
class ExpectedInstallation:
    """Expected installation, from the cell file; None: not known.

    `com_m` in sensor axes from the sensor's origin; `down_in_base` a unit vector; positions in
    flange axes [m], `oat_deg` the sensor's orientation in the flange in cell-file format.
    """

    mass_kg: float | None = None
    com_m: Array | None = None
    down_in_base: Array = field(default_factory=lambda: np.array(DOWN))
    oat_deg: tuple[float, float, float] | None = None
    R_flange_sensor: Array | None = None
    p_flange_sensor_m: Array | None = None
    p_flange_tcp_m: Array | None = None

    @classmethod
    def of(cls, cell: CellConfig) -> "ExpectedInstallation":
        """Return the expected installation of a cell, its calibration included."""
        found = cell.calibration
        payload = found.payload if isinstance(found, CalibrationSection) else cell.payload
        sensor, tcp = cell.sensor.T_flange_sensor, cell.tool.T_flange_tcp
        return cls(
            mass_kg=payload.mass_kg if payload.mass_kg > 0.0 else None,
            com_m=np.array(payload.com_m) if payload.weighs else None,
            down_in_base=np.array(payload.gravity_direction_in_base),
            oat_deg=sensor.oat_deg,
            R_flange_sensor=np.asarray(sensor.pose.rotation),
            p_flange_sensor_m=np.array(sensor.position_m),
            p_flange_tcp_m=np.array(tcp.position_m),
        )

    @property
    def p_sensor_tcp_m(self) -> Array | None:
        """Return the vector from the sensor to the tool centre point, in sensor axes [m]."""
        R, p_sensor, p_tcp = self.R_flange_sensor, self.p_flange_sensor_m, self.p_flange_tcp_m
        if R is None or p_sensor is None or p_tcp is None:
            return None
        return np.asarray(R.T @ (p_tcp - p_sensor))

    @property
    def lengths_m(self) -> dict[str, Array | None]:
        """Return the lengths of the cell file that are checked, by key."""
        return {
            "sensor.T_flange_sensor.position_m": self.p_flange_sensor_m,
            "tool.T_flange_tcp.position_m": self.p_flange_tcp_m,
            "payload.com_m": self.com_m,
        }

    def in_metres(self) -> "ExpectedInstallation":
        """Return a copy in which lengths that must be in millimetres are converted."""
        sensor, tcp, com = (
            v / 1e3 if v is not None and in_millimetres(v) else v for v in self.lengths_m.values()
        )
        return replace(self, p_flange_sensor_m=sensor, p_flange_tcp_m=tcp, com_m=com)


@dataclass(frozen=True, slots=True)
class InstallationFinding:
    """One suspected error: a code for programs, a sentence, and the remedy."""

    code: str
    text: str
    remedy: str
    kind: FindingKind = "installation"

    def __str__(self) -> str:
        """Return the sentence, followed by the remedy."""
        return f"{self.text}; {self.remedy}"


@dataclass(frozen=True, slots=True)
class Installation:
    """Result of the installation check.

    `unidentified` lists properties that the readings do not identify; `evidence` the numbers behind
    it, units in the names; `force_wiring` the signed permutation of the force channels, if any.
    """

    findings: tuple[InstallationFinding, ...]
    unidentified: tuple[str, ...]
    evidence: dict[str, float]
    force_wiring: Array | None = None
    com_m: Array | None = None
    shows_torques: bool = True  # every axis and sign of the torques

    @property
    def verdict(self) -> Verdict:
        """Return right, wrong, or cannot tell."""
        kinds = {finding.kind for finding in self.findings}
        if kinds & {"installation", "payload"}:
            return "wrong"
        return "cannot tell" if kinds else "right"

    @property
    def rejection_reason(self) -> str | None:
        """Return why a calibration from these readings must not be written, None when it may be.

        A payload that differs from the cell file is not a reason: the calibration corrects it.
        An installation that the readings do not identify is one.
        """
        return next((str(each) for each in self.findings if each.kind != "payload"), None)
