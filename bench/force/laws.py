"""The control laws on the rig: those of the regulator, and minimal versions of two peers.

The peers follow the documentation of their ROS packages:
- admittance: M a + D v = F - F_set, as ros2_controllers' admittance_controller with stiffness zero;
- FDCC-like: the force part of FZI's forward dynamics compliance control: a PD law on the net wrench
  drives a virtual mass that loses a tenth of its speed at every step.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from bench.force.rig import ForceRig, LawSample, SceneSettings, Trace
from bench.harness import grid
from bench.results import Row
from common.motion.convert import vec3
from common.motion.frames import Array
from control.axis_task import NONE, AxisTask, VirtualMass, mode_task
from control.compliance import ComplianceState
from control.gain_rule import rule_gain, tune
from control.law import LawInput, LawMotion, back_calculate, start_at
from control.laws import LAWS, ControlSettings, advance
from forcemesh.messages import Gains, Mode

HOLD_N = 10.0
KEPT_SPEED = 0.9  # of FDCC's virtual mass at each step
PEER_TIME_S = 0.01  # second parameter of both peers, where they are not tuned
ADAPTIVE, SAFE, TUNED, GUIDED = (
    "adaptive", "plain, safe at 2e5 N/m", "plain, known k", "hand guiding"
)  # fmt: skip
OF_REGULATOR = {ADAPTIVE: "adaptive", SAFE: "plain", TUNED: "plain", GUIDED: "plain"}
PEERS = {"admittance, known k": "admittance", "FDCC-like, known k": "FDCC-like"}
LOOPS_HZ = (250.0, 60.0, 30.0)
KNOWN_K = (ADAPTIVE, TUNED, *PEERS)  # all but the adaptive one know the stiffness of the plate


class LawRunner:
    """A law of the regulator, as the regulator runs it."""

    def __init__(
        self, rig: ForceRig, law: str, gain_m_per_Ns: float | None = None, gain_p_m_N: float = 0.0
    ) -> None:
        """Start at rest, with the rule's gains or one tuned by hand."""
        self._law, gains = LAWS[law], tune(rig.cell).gains
        if gain_m_per_Ns is not None:
            force_i, force_p = (gain_m_per_Ns,) * 3, (gain_p_m_N,) * 3
            gains = gains.replaced(force_i_m_per_Ns=force_i, force_p_m_per_N=force_p)
        self._settings, self._gains = ControlSettings.of(rig.cell, self._law), gains
        self.mode: Mode = "position"
        self.setpoint_N, self.across_m_s = 0.0, np.zeros(3)
        self.presses_only = False  # force control acts along the tool's axis alone
        self.motion, self._rig = start_at(rig.T_base_tcp), rig
        self.predicts = self._law.predicts
        self.restart()

    def restart(self) -> None:
        """Forget the estimates and the last errors, as in another task frame."""
        self.motion = replace(self.motion, error_force_N=None, error_torque_Nm=None)
        T_measured = self._rig.arm.T_base_tcp
        T = self.motion.T_base_tcp
        self.state = self._law.begin(T, T_measured, None, self._settings.of_law)
        self._compliance = ComplianceState.at(self.task(), T, T_measured)

    def place(self, T_base_tcp: pin.SE3) -> None:
        """Continue from another commanded pose."""
        self.motion = replace(self.motion, T_base_tcp=T_base_tcp)

    def task(self) -> AxisTask:
        """Return the task of the mode; axes of an imposed lateral motion are not controlled."""
        led = self.presses_only or bool(self.across_m_s.any())
        axes = (not led, not led, True, True, True, True)
        return mode_task(self.mode, self.setpoint_N, axes=axes)

    def step(self, sample: LawSample, task: AxisTask | None = None) -> pin.SE3:
        """Return the TCP's next pose."""
        motion = self.motion
        if sample.limited:
            motion = back_calculate(motion, sample.T_let_through)
        given = law_input(sample, task or self.task(), self._gains, motion)
        self.state, motion = advance(self.state, self._compliance, given, self._settings)
        T, travel_m = motion.T_base_tcp, self.across_m_s * sample.dt_s
        across_m = travel_m - (travel_m @ T.rotation[:, 2]) * T.rotation[:, 2]
        self.motion = replace(motion, T_base_tcp=pin.SE3(T.rotation, T.translation + across_m))
        return self.motion.T_base_tcp


class GuidingRunner(LawRunner):
    """Hand guiding: three compliant axes, as the regulator runs them."""

    def task(self) -> AxisTask:
        """Return the task of every period."""
        return AxisTask(force_along=NONE, compliant_along=(VirtualMass(),) * 3)


def law_input(sample: LawSample, task: AxisTask, gains: Gains, motion: LawMotion) -> LawInput:
    """Return the input of a law of the regulator."""
    force_N, torque_Nm = vec3(sample.force_N), vec3(sample.torque_Nm)
    return LawInput(force_N, torque_Nm, task, sample.dt_s, gains, motion, sample.T_base_tcp)


class Peer:
    """A peer's law: it moves a virtual body along the force error, with constant orientation."""

    def __init__(self, kind: str, rig: ForceRig, gain_m_per_Ns: float, time_s: float) -> None:
        """Start at rest.

        Args:
            kind: admittance or FDCC-like.
            rig: The arm, and the limit of the speed.
            gain_m_per_Ns: Steady speed per force; of the admittance law 1 / D.
            time_s: M / D of the admittance law, weight of FDCC's D part.
        """
        self._kind, self._gain, self._time_s = kind, gain_m_per_Ns, time_s
        self._T, self._speed_m_s = rig.T_base_tcp, np.zeros(3)
        self._longest_m_s = rig.cell.force.speed_max_m_s
        self._last_N: Array | None = None
        self.setpoint_N = 0.0

    def place(self, T_base_tcp: pin.SE3) -> None:
        """Continue from another commanded pose, at the present speed."""
        self._T = T_base_tcp

    def step(self, sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""
        if sample.limited:
            self._T = sample.T_let_through
        error_N = sample.force_N + self.setpoint_N * sample.T_base_tcp.rotation[:, 2]
        speed_m_s = self._next_speed_m_s(error_N, sample.dt_s)
        size = float(np.linalg.norm(speed_m_s))
        share = min(1.0, self._longest_m_s / size) if size > 0.0 else 1.0
        self._speed_m_s, self._last_N = speed_m_s * share, error_N
        self._T = pin.SE3(self._T.rotation, self._T.translation + self._speed_m_s * sample.dt_s)
        return self._T

    def _next_speed_m_s(self, error_N: Array, dt_s: float) -> Array:
        before_m_s = self._speed_m_s
        if self._kind == "admittance":
            share = 1.0 - float(np.exp(-dt_s / self._time_s))
            return before_m_s + share * (self._gain * error_N - before_m_s)
        change = np.zeros(3) if self._last_N is None else (error_N - self._last_N) / dt_s
        push = (1.0 / KEPT_SPEED - 1.0) * self._gain * (error_N + self._time_s * change)
        return np.asarray(KEPT_SPEED * (before_m_s + push))


AnyLaw = LawRunner | Peer


def runner_of(law: str, rig: ForceRig) -> LawRunner:
    """Return a law of the regulator by its name in the tables."""
    if law == GUIDED:
        return GuidingRunner(rig, OF_REGULATOR[law])
    return LawRunner(rig, OF_REGULATOR[law], known_gain(rig) if law == TUNED else None)


def law_of(law: str, rig: ForceRig) -> AnyLaw:
    """Return a law of `KNOWN_K`."""
    if law in PEERS:
        return Peer(PEERS[law], rig, known_gain(rig), PEER_TIME_S)
    return runner_of(law, rig)


def places_of(**places: Iterable[float]) -> list[Row]:
    """Return the cases of every law in a fast loop, and of ours in every one."""
    cases = grid(law=KNOWN_K, **places)
    return [each for each in cases if each["law"] == ADAPTIVE or each["loop_hz"] == LOOPS_HZ[0]]


def ours(rows: Iterable[Row]) -> list[Row]:
    """Return the rows of our law."""
    return [row for row in rows if row.get("law") == ADAPTIVE]


def known_gain(rig: ForceRig) -> float:
    """Return the gain rule's result for the stiffness of the plate [m/(N s)]."""
    cell, stiffness_N_m = rig.cell, rig.arm.settings.stiffness_N_m
    plant = cell.plant
    tau_s, bandwidth_rad_s = plant.tau_s, plant.bandwidth_rad_s
    return rule_gain(stiffness_N_m, plant.inertia_kg, tau_s=tau_s, bandwidth_rad_s=bandwidth_rad_s)


def pressing(world: SceneSettings, law: str) -> tuple[ForceRig, LawRunner]:
    """Return a rig in light contact, and a law with the set point of the scenes."""
    rig = ForceRig(world.cell())
    rig.press(3.0)
    pilot = runner_of(law, rig)
    pilot.setpoint_N = HOLD_N
    return rig, pilot


def holding(world: SceneSettings, law: str) -> tuple[ForceRig, LawRunner, Trace]:
    """Return a rig at the set point of the scenes, and the trace from the contact on."""
    rig, pilot = pressing(world, law)
    return rig, pilot, rig.run(pilot, 1.5 if law != SAFE else 4.0)
