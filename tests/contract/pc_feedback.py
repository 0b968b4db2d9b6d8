"""Force feedback on the PC for the contract: the regulator's control law without the bus."""

from dataclasses import replace

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import record_of
from control.law import LawSettings, next_motion, start_at
from control.shape import MotionLimits
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Gains, Mode, PoseRecord, WrenchAtTcp
from tests.fakes.law_input import mode_input, shaped


class PcFeedback:
    """Force feedback on the PC: wrench in, set point of the regulator's law out."""

    def __init__(
        self, cell: CellConfig, T_start: pin.SE3, mode: Mode, gains: Gains, *, now_ns: int
    ):
        """Start at a flange pose, without a dead band because the tests push with small forces."""
        settings = LawSettings.of(cell)
        self._settings = replace(settings, deadband_N=0.0, deadband_Nm=0.0)
        self._limits = MotionLimits.of(cell, predicts=False)
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._law = start_at(T_start * self._T_flange_tcp)
        self._mode = mode
        self._at_ns = now_ns
        self.use(gains)

    def use(self, gains: Gains) -> None:
        """Change the gains."""
        self._gains = gains

    def next_pose(self, wrench: WrenchAtTcp, now_ns: int) -> PoseRecord:
        """Return the set point of the next sample."""
        sample = mode_input(
            force_N=wrench.force_N,
            torque_Nm=wrench.torque_Nm,
            setpoint_N=0.0,
            mode=self._mode,
            dt_s=(now_ns - self._at_ns) / NS_PER_S,
            gains=self._gains,
            motion=self._law,
            T_measured=self._law.T_base_tcp,
        )
        self._at_ns = now_ns
        self._law = shaped(next_motion(sample, self._settings), sample, self._limits)
        return record_of(self._law.T_base_tcp * self._T_flange_tcp.inverse())
