"""The simulated arm and its cell: lag, delay, weight, sensor sign, honesty about divergence."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import GRAVITY_M_S2
from forcemesh.errors import SimulationError
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S, SimSettings

QUIET: dict[str, Any] = {
    "noise_force_N": 0.0,
    "noise_torque_Nm": 0.0,
    "bias_force_N": (0.0, 0.0, 0.0),
    "bias_torque_Nm": (0.0, 0.0, 0.0),
    "quantum_force_N": 0.0,
    "quantum_torque_Nm": 0.0,
}


def flange_moved(arm: SimArm, move_m: Sequence[float], T: pin.SE3) -> np.ndarray:
    """Return the joints that put the flange `move_m` from T, in base axes."""
    goal = pin.SE3(T.rotation, T.translation + np.array(move_m))
    result = arm.kinematics.solve(goal, arm.q, jump_rad=1.0)
    assert result.q is not None, result.reason
    return result.q


def run(arm: SimArm, duration_s: float) -> None:
    """Let simulated time pass."""
    for _ in range(round(duration_s / TICK_S)):
        arm.step()


def pressed(arm: SimArm, depth_m: float) -> SimArm:
    """Let the arm push the disc `depth_m` beyond first contact and come to rest."""
    gap = arm.settings.gap_m
    arm.command_joints(flange_moved(arm, (0.0, 0.0, -gap - depth_m), arm.T_base_flange))
    run(arm, 0.6)
    return arm


@pytest.mark.parametrize(
    "settings",
    [
        SimSettings(smoothing_s=0.016),
        SimSettings(smoothing_s=0.001, delay_s=0.012, servo_lag_s=0.024),
        SimSettings(tool_mass_kg=3.0),
    ],
)
@pytest.mark.parametrize("axis", range(3))
def test_lag_of_the_motion_is_the_documented_one(settings, axis):
    """The area over the step answer is delay + half the smoothing + servo lag, within 0.1 ms."""
    arm = SimArm(settings, seed=0)
    T = arm.T_base_flange
    move = [0.0, 0.0, 0.0]
    move[axis] = 0.002
    arm.command_joints(flange_moved(arm, move, T))
    area_s = 0.0
    for _ in range(400):
        arm.step()
        share = (arm.T_base_flange.translation[axis] - T.translation[axis]) / 0.002
        area_s += (1.0 - share) * TICK_S
    smoothing_s = (settings.smoothing_ticks - 1) / 2 * TICK_S
    assert area_s == pytest.approx(settings.delay_s + smoothing_s + settings.servo_lag_s, abs=1e-4)


def test_the_hanging_tool_pulls_the_sensor_with_gravity():
    """Free of contact the load is m g at the centre of mass, in sensor axes, at any attitude."""
    settings = SimSettings(**QUIET)
    weight = settings.tool_mass_kg * GRAVITY_M_S2
    arm = SimArm(settings, seed=0)
    rng = np.random.default_rng(3)
    attitudes = 0
    while attitudes < 4:
        q = settings.home_rad + rng.uniform(-0.5, 0.5, 6)
        arm.command_joints(np.clip(q, arm.kinematics.lower_rad, arm.kinematics.upper_rad))
        arm.data.qpos[:6] = arm.q_command  # put it there: this is about the rest
        run(arm, 0.8)
        if arm.true_wrench().force_N.any():
            continue
        attitudes += 1
        R_base_sensor = arm.T_base_flange.rotation @ settings.T_flange_sensor.rotation
        pull = R_base_sensor.T @ np.array([0.0, 0.0, -weight])
        sample = arm.ft_sensor.sample()
        assert sample.force_N == pytest.approx(pull, abs=1e-4)
        assert sample.torque_Nm == pytest.approx(np.cross(settings.tool_com_m, pull), abs=1e-4)


def test_pressing_reads_as_the_plate_pushing_the_robot():
    """In contact the sensor reads weight plus the plate's true wrench, moved to its origin."""
    settings = SimSettings(**QUIET, tilt_deg=10.0)
    arm = pressed(SimArm(settings, seed=0), 0.001)
    truth, sample = arm.true_wrench(), arm.ft_sensor.sample()
    assert truth.force_N[2] > 5.0  # up: the environment pushes the robot
    R = arm.T_base_flange.rotation @ settings.T_flange_sensor.rotation
    pull = R.T @ np.array([0.0, 0.0, -settings.tool_mass_kg * GRAVITY_M_S2])
    assert R @ (sample.force_N - pull) == pytest.approx(truth.force_N, abs=1e-3)
    lever = R @ settings.T_sensor_tcp.translation
    torque = R @ (sample.torque_Nm - np.cross(settings.tool_com_m, pull))
    assert torque - np.cross(lever, truth.force_N) == pytest.approx(truth.torque_Nm, abs=1e-3)


def test_divergence_is_an_error_and_leaves_no_log_behind(tmp_path, monkeypatch):
    """MuJoCo would put the state back silently and write a file; neither happens here."""
    monkeypatch.chdir(tmp_path)
    arm = SimArm(SimSettings(), seed=0)
    run(arm, 0.01)
    arm.data.qvel[1] = 1e13
    with pytest.raises(SimulationError, match="diverged"):
        run(arm, 0.01)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", [(0, 0, np.nan, 0, 0, 0), (0, 0, 0), (0, 3, 0, 0, 0, 0)])
def test_an_impossible_joint_command_is_refused(command: tuple[float, ...]) -> None:
    """Not finite, too few, beyond a limit: the arm stays."""
    arm = SimArm(SimSettings(), seed=0)
    with pytest.raises(SimulationError):
        arm.command_joints(np.array(command))
    assert np.array_equal(arm.q_command, arm.q)
