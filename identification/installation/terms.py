"""What is believed of an installation, and what is found of it. Pure."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from common.config.cell import Cell
from common.config.payload import DOWN
from common.motion.frames import Array
from identification.installation.units import in_millimetres

Verdict = Literal["right", "wrong", "cannot tell"]
# An axis, a sign or a unit is wrong; the payload that the cell file says is; more must be seen.
Kind = Literal["installation", "payload", "unsure"]


@dataclass(frozen=True, slots=True)
class Belief:
    """What the cell file says; None: not known.

    `com_m` in sensor axes from the sensor's origin; `down_in_base` a unit vector; positions in
    flange axes [m], `oat_deg` the sensor's orientation in the flange as the cell file has it.
    """

    mass_kg: float | None = None
    com_m: Array | None = None
    down_in_base: Array = field(default_factory=lambda: np.array(DOWN))
    oat_deg: tuple[float, float, float] | None = None
    R_flange_sensor: Array | None = None
    p_flange_sensor_m: Array | None = None
    p_flange_tcp_m: Array | None = None

    @classmethod
    def of(cls, cell: Cell) -> "Belief":
        """Take it out of a cell file, its calibration if it has one."""
        payload = cell.payload if cell.calibration is None else cell.calibration.payload
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
        """From the sensor to the tool centre point, in sensor axes [m]."""
        R, p_sensor, p_tcp = self.R_flange_sensor, self.p_flange_sensor_m, self.p_flange_tcp_m
        if R is None or p_sensor is None or p_tcp is None:
            return None
        return np.asarray(R.T @ (p_tcp - p_sensor))

    @property
    def lengths_m(self) -> dict[str, Array | None]:
        """Every length of the cell file that this is about, by its key."""
        return {
            "sensor.T_flange_sensor.position_m": self.p_flange_sensor_m,
            "tool.T_flange_tcp.position_m": self.p_flange_tcp_m,
            "payload.com_m": self.com_m,
        }

    def in_metres(self) -> "Belief":
        """Return the same with the lengths that must be millimetres taken for such."""
        sensor, tcp, com = (
            v / 1e3 if v is not None and in_millimetres(v) else v for v in self.lengths_m.values()
        )
        return replace(self, p_flange_sensor_m=sensor, p_flange_tcp_m=tcp, com_m=com)


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that looks wrong: a code for programs, a sentence, and what to write or to do."""

    code: str
    text: str
    mend: str
    kind: Kind = "installation"

    def __str__(self) -> str:
        """The sentence, and after it what to do."""
        return f"{self.text}; {self.mend}"


@dataclass(frozen=True, slots=True)
class Installation:
    """What static readings say of an installation.

    `unseen` is what they could not show although nothing looks wrong; `evidence` the numbers
    behind it, units in the names; `force_wiring` which axes the force channels show, if told.
    """

    findings: tuple[Finding, ...]
    unseen: tuple[str, ...]
    evidence: dict[str, float]
    force_wiring: Array | None = None
    com_m: Array | None = None

    @property
    def verdict(self) -> Verdict:
        """Right, wrong, or cannot tell."""
        kinds = {finding.kind for finding in self.findings}
        if kinds & {"installation", "payload"}:
            return "wrong"
        return "cannot tell" if kinds else "right"

    @property
    def complaint(self) -> str | None:
        """Why a calibration from these readings must not be written, None when it may be.

        A payload that is not the one of the cell file is no reason: the calibration corrects it.
        An installation that the readings cannot tell is one.
        """
        return next((str(each) for each in self.findings if each.kind != "payload"), None)

    @property
    def misfit(self) -> float:
        """What the best explanation leaves of the force [N]; infinite without one."""
        return self.evidence.get("rms_force_N", math.inf)
