"""The gain share lowers every law: force, torque and damping."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.frames import vector_from_rotation
from forcemesh.messages import ZERO3
from services.regulator import admittance
from services.regulator.admittance import AdmittanceSettings
from services.regulator.gains import PiGains
from services.regulator.law import LawSettings, next_motion, start_at
from tests.fakes.bench import CELL
from tests.fakes.law_input import mode_input
from tuning.gain_rule import tune

DT_S = 0.004
GAINS = PiGains.of(tune(CELL).gains)
FORCE_N, TORQUE_NM = (3.0, -2.0, 1.0), (0.4, 0.3, -0.2)


def sample_of(share: float, mode="both", force_N=FORCE_N, torque_Nm=TORQUE_NM):
    """Return a sample at set point 0 whose gains a share lowers."""
    T = pin.SE3.Identity()
    return mode_input(
        force_N, torque_Nm, 0.0, mode, DT_S, GAINS.times(share), start_at(T), T, gain_share=share
    )  # fmt: skip


@given(st.floats(0.05, 1.0))
def test_the_plain_law_moves_and_turns_by_that_share(share: float) -> None:
    """Below its speed limits."""
    settings = LawSettings.of(CELL)
    for mode in ("position", "orientation"):
        whole, lowered = (
            next_motion(sample_of(each, mode), settings).T_base_tcp for each in (1.0, share)
        )
        moved_m = share * whole.translation
        assert lowered.translation == pytest.approx(moved_m, rel=1e-9, abs=1e-15)
        turned_rad = share * np.array(vector_from_rotation(whole.rotation))
        found_rad = np.array(vector_from_rotation(lowered.rotation))
        assert found_rad == pytest.approx(turned_rad, rel=1e-6, abs=1e-12)


def test_full_gains_are_the_same_object() -> None:
    """Share 1 multiplies nothing: stored runs stay equal to the last bit."""
    assert sample_of(1.0).gains is GAINS


def test_hand_guiding_is_damped_more_by_that_share() -> None:
    """A hand that pushes steadily moves the tool more slowly."""
    settings = AdmittanceSettings.of(CELL)
    speeds = []
    for share in (1.0, 0.5, 0.25):
        T = pin.SE3.Identity()
        state = admittance.begin(T, T, None, settings)
        for _ in range(500):
            pushed = sample_of(share, "position", (8.0, 0.0, 0.0), ZERO3)
            admittance.step(state, pushed, settings)
        speeds.append(state.speed_m_s[0])
    assert speeds[0] > speeds[1] > speeds[2] > 0.0
    assert speeds[2] < 0.6 * speeds[0]
