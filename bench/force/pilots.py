"""The control laws of the regulator, adapted to the test rig."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from bench.force.rig import LawSample
from common.config.cell import CellConfig
from common.motion.convert import vec3
from common.motion.frames import Array
from forcemesh.messages import Mode
from services.regulator.axis_task import mode_task
from services.regulator.gains import PiGains
from services.regulator.law import LawInput, LawMotion, back_calculate, start_at
from services.regulator.laws import LAWS
from tuning.gain_rule import tune


class LawRunner:
    """A law as the regulator runs it."""

    def __init__(
        self,
        law: str,
        cell: CellConfig,
        T_base_tcp: pin.SE3,
        T_measured: pin.SE3 | None = None,
        *,
        gain_m_per_Ns: float | None = None,
        gain_p_m_per_N: float = 0.0,
        mode: Mode = "position",
        setpoint_N: float = 0.0,
    ) -> None:
        """Start at rest, with the rule's gains or one tuned by hand.

        The measured pose is the commanded one unless `T_measured` is given.
        """
        self._law, gains = LAWS[law], PiGains.of(tune(cell).gains)
        if gain_m_per_Ns is not None:
            gains = replace(
                gains,
                force_i_m_per_Ns=(gain_m_per_Ns,) * 3,
                force_p_m_per_N=(gain_p_m_per_N,) * 3,
            )
        self._settings, self._gains = self._law.settings(cell), gains
        self.mode, self.setpoint_N, self.across_m_s = mode, setpoint_N, np.zeros(3)
        self.presses_only = False  # force control acts along the tool's axis alone
        self.motion = start_at(T_base_tcp)
        T_measured = T_base_tcp if T_measured is None else T_measured
        self.state = self._law.begin(T_base_tcp, T_measured, None, self._settings)

    @property
    def predicts(self) -> bool:
        """Whether the law has a predictor."""
        return self._law.predicts

    def place(self, T_base_tcp: pin.SE3) -> None:
        """Continue from another commanded pose."""
        self.motion = replace(self.motion, T_base_tcp=T_base_tcp)

    def step(self, law_sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose; axes of an imposed lateral motion are not controlled."""
        motion, led = self.motion, self.presses_only or bool(self.across_m_s.any())
        if law_sample.limited:
            motion = back_calculate(motion, law_sample.T_let_through)
        axes = (not led, not led, True, True, True, True)
        sample = LawInput(
            vec3(law_sample.force_N),
            vec3(law_sample.torque_Nm),
            mode_task(self.mode, self.setpoint_N, axes=axes),
            law_sample.dt_s,
            self._gains,
            motion,
            law_sample.T_base_tcp,
        )
        self.state, motion = self._law.step(self.state, sample, self._settings)
        self.motion = with_lateral_travel(motion, self.across_m_s * law_sample.dt_s)
        return self.motion.T_base_tcp


def with_lateral_travel(motion: LawMotion, travel_m: Array) -> LawMotion:
    """Move the tool perpendicular to its axis, independent of the force."""
    T, axis = motion.T_base_tcp, motion.T_base_tcp.rotation[:, 2]
    across_m = travel_m - (travel_m @ axis) * axis
    return replace(motion, T_base_tcp=pin.SE3(T.rotation, T.translation + across_m))
