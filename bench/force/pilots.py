"""The control laws of the regulator, adapted to the test rig."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from bench.force.rig import LawSample
from common.config.cell import CellConfig
from common.motion.frames import Array
from forcemesh.messages import Mode
from services.regulator import adaptive, admittance
from services.regulator.adaptive import AdaptiveSettings
from services.regulator.admittance import AdmittanceSettings
from services.regulator.law import LawInput, LawState, PiGains, back_calculate, start_at, step
from services.regulator.settings import law_settings, pi_gains
from tuning.gain_rule import tune


class AdaptiveLawRunner:
    """The adaptive law as the regulator runs it."""

    def __init__(
        self,
        cell: CellConfig,
        T_base_tcp: pin.SE3,
        T_measured: pin.SE3 | None = None,
        *,
        mode: Mode = "position",
        setpoint_N: float = 0.0,
    ) -> None:
        """Start at rest; the measured pose is the commanded one unless `T_measured` is given."""
        self.settings, self.plain = AdaptiveSettings.of(cell), law_settings(cell)
        self.gains = pi_gains(tune(cell).gains)
        self.mode, self.setpoint_N, self.across_m_s = mode, setpoint_N, np.zeros(3)
        self.law = start_at(T_base_tcp)
        self.memory = adaptive.begin(T_base_tcp, T_measured or T_base_tcp, self.settings)

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        law = back_calculate(self.law, law_sample.T_let_through) if law_sample.limited else self.law
        sample = _sample(law_sample, self, law)
        self.law, self.memory = adaptive.advance(
            law,
            self.memory,
            sample,
            law_sample.T_base_tcp,
            gains=self.gains,
            plain=self.plain,
            settings=self.settings,
        )
        self.law = with_lateral_travel(self.law, self.across_m_s * law_sample.dt_s)
        return self.law.T_base_tcp


class PlainLawRunner:
    """The specification's PI law."""

    def __init__(
        self,
        cell: CellConfig,
        T_base_tcp: pin.SE3,
        gain_m_per_Ns: float | None = None,
        *,
        gain_p_m_per_N: float = 0.0,
        mode: Mode = "position",
        setpoint_N: float = 0.0,
    ) -> None:
        """Start at rest, with a gain tuned by hand or by the rule."""
        self.plain, gains = law_settings(cell), pi_gains(tune(cell).gains)
        if gain_m_per_Ns is not None:
            by_hand = np.full(3, gain_m_per_Ns), np.full(3, gain_p_m_per_N)
            gains = replace(gains, force_i_m_per_Ns=by_hand[0], force_p_m_per_N=by_hand[1])
        self.gains: PiGains = gains
        self.mode, self.setpoint_N, self.across_m_s = mode, setpoint_N, np.zeros(3)
        self.law = start_at(T_base_tcp)

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        law = back_calculate(self.law, law_sample.T_let_through) if law_sample.limited else self.law
        sample = _sample(law_sample, self, law)
        self.law = step(law, sample, self.gains, self.plain)
        self.law = with_lateral_travel(self.law, self.across_m_s * law_sample.dt_s)
        return self.law.T_base_tcp


class GuidingLawRunner:
    """Hand guiding as the regulator runs it."""

    def __init__(self, cell: CellConfig, T_base_tcp: pin.SE3, T_measured: pin.SE3) -> None:
        """Start at rest, without a hand on the tool."""
        self.settings, self.plain = AdmittanceSettings.of(cell), law_settings(cell)
        self.gains = pi_gains(tune(cell).gains)
        self.mode: Mode = "position"
        self.setpoint_N, self.across_m_s = 0.0, np.zeros(3)
        self.law, self.memory = start_at(T_base_tcp), admittance.begin(T_measured)

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        law = back_calculate(self.law, law_sample.T_let_through) if law_sample.limited else self.law
        self.law, self.memory = admittance.advance(
            law,
            self.memory,
            LawInput(law_sample.force_N, law_sample.torque_Nm, 0.0, self.mode, law_sample.dt_s),
            law_sample.T_base_tcp,
            gains=self.gains,
            plain=self.plain,
            settings=self.settings,
        )
        return self.law.T_base_tcp


def _sample(
    law_sample: LawSample, pilot: "AdaptiveLawRunner | PlainLawRunner", law: LawState
) -> LawInput:
    """Return the input of a law; axes of an imposed lateral motion are not force-controlled."""
    led = bool(pilot.across_m_s.any())
    return LawInput(
        law_sample.force_N,
        law_sample.torque_Nm,
        pilot.setpoint_N,
        pilot.mode,
        law_sample.dt_s,
        R_base_task=law.T_base_tcp.rotation,
        axes=(not led, not led, True, True, True, True),
    )


def with_lateral_travel(law: LawState, travel_m: Array) -> LawState:
    """Move the tool perpendicular to its axis, independent of the force."""
    T, axis = law.T_base_tcp, law.T_base_tcp.rotation[:, 2]
    across_m = travel_m - (travel_m @ axis) * axis
    return replace(law, T_base_tcp=pin.SE3(T.rotation, T.translation + across_m))
