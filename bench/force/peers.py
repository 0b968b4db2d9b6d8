"""Two peer control laws, minimal implementations after the documentation of their ROS packages.

`admittance`: M a + D v = F - F_set, as ros2_controllers' admittance_controller with stiffness zero.
`fdcc`: the force part of FZI's forward dynamics compliance control: a PD law on the net wrench
drives a virtual mass that loses a tenth of its speed at every step.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from bench.force.rig import LawSample
from common.motion.frames import Array

KEPT_SPEED = 0.9  # of the virtual model at each step


@dataclass(slots=True)
class _Body:
    """The commanded tool as a virtual body: position and velocity, constant orientation."""

    T_base_tcp: pin.SE3
    speed_m_s: Array

    def moved(self, speed_m_s: Array, dt_s: float, longest_m_s: float) -> pin.SE3:
        size = float(np.linalg.norm(speed_m_s))
        self.speed_m_s = speed_m_s * min(1.0, longest_m_s / size) if size > 0.0 else speed_m_s
        place_m = self.T_base_tcp.translation + self.speed_m_s * dt_s
        self.T_base_tcp = pin.SE3(self.T_base_tcp.rotation, place_m)
        return self.T_base_tcp


class _Peer:
    """A law around a virtual body."""

    _body: _Body
    setpoint_N: float

    def place(self, T_base_tcp: pin.SE3) -> None:
        """Continue from another commanded pose, at the present speed."""
        self._body.T_base_tcp = T_base_tcp


class Admittance(_Peer):
    """Virtual mass and damper between the force error and the tool."""

    def __init__(
        self, T_base_tcp: pin.SE3, gain_m_per_Ns: float, time_s: float, *, longest_m_s: float
    ) -> None:
        """Start at rest; gain is 1 / D, time is M / D."""
        self._body = _Body(T_base_tcp, np.zeros(3))
        self._gain, self._time_s, self._longest_m_s = gain_m_per_Ns, time_s, longest_m_s
        self.setpoint_N = 0.0

    def step(self, sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        error_N = _error_N(sample, self.setpoint_N)
        if sample.limited:
            self._body.T_base_tcp = sample.T_let_through
        share = 1.0 - float(np.exp(-sample.dt_s / self._time_s))
        target_speed = self._gain * error_N
        speed = self._body.speed_m_s + share * (target_speed - self._body.speed_m_s)
        return self._body.moved(speed, sample.dt_s, self._longest_m_s)


class Fdcc(_Peer):
    """PD on the net force, a virtual mass, a tenth of the speed lost at every step."""

    def __init__(
        self, T_base_tcp: pin.SE3, gain_m_per_Ns: float, time_s: float, *, longest_m_s: float
    ) -> None:
        """Start at rest; gain is the steady speed per force, time the weight of the D part."""
        self._body = _Body(T_base_tcp, np.zeros(3))
        self._gain, self._time_s, self._longest_m_s = gain_m_per_Ns, time_s, longest_m_s
        self._last_N: Array | None = None
        self.setpoint_N = 0.0

    def step(self, sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        error_N = _error_N(sample, self.setpoint_N)
        change = np.zeros(3) if self._last_N is None else (error_N - self._last_N) / sample.dt_s
        self._last_N = error_N
        if sample.limited:
            self._body.T_base_tcp = sample.T_let_through
        push = (1.0 / KEPT_SPEED - 1.0) * self._gain * (error_N + self._time_s * change)
        speed = KEPT_SPEED * (self._body.speed_m_s + push)
        return self._body.moved(speed, sample.dt_s, self._longest_m_s)


def _error_N(sample: LawSample, setpoint_N: float) -> Array:
    return np.asarray(sample.force_N + setpoint_N * sample.T_base_tcp.rotation[:, 2])
