"""Set points that the packet rounds: the law comes to rest, and does not alternate between two."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.frames import Oat, R_from_oat
from services.regulator import adaptive
from services.regulator.adaptive import AdaptiveSettings
from services.regulator.gains import PiGains
from services.regulator.law import LawSettings, next_motion, soft_deadband, start_at
from tests.fakes.bench import CELL, DEMO
from tests.fakes.law_input import mode_input
from tuning.gain_rule import tune

PER_MM = 98
STIFFEST_N_M = 1.1e5
SETTLES_S, RESTS_S = 8.0, 2.0
ROUNDING = 1e-9  # of the sizes of vectors
AXES = R_from_oat(Oat(0.3, 3.0, 0.2))
vectors = hnp.arrays(float, 3, elements=st.floats(-20.0, 20.0))
offsets_m = st.tuples(*[st.floats(0.0, 1e-3 / PER_MM)] * 3)


def cell_with_contact(k_N_m: float) -> CellConfig:
    """Return the cell over TCP for one stiffest contact."""
    return load_cell(DEMO.with_name("demo-tcp.yaml"), {"contact.stiffness_N_m": k_N_m})


def packets(cell: CellConfig, law: str, k_N_m: float, centre_m: np.ndarray) -> np.ndarray:
    """Return the rounded positions of a release against a spring in every axis [m]. Shape (n, 3).

    The spring's rest, at which the force is zero, is anywhere between the packet's positions.
    """
    gains, dt_s = PiGains.of(tune(cell).gains), 1.0 / cell.rates.control_hz
    start = pin.SE3(AXES, centre_m + np.array([2e-4, -1e-4, -20.0 / k_N_m]))
    motion, settings_of = start_at(start), AdaptiveSettings.of(cell)
    sent: list[np.ndarray] = []
    state = adaptive.begin(start, start, None, settings_of) if law == "adaptive" else None
    late = round(cell.loop_delay_s / dt_s)
    for _ in range(round((SETTLES_S + RESTS_S) / dt_s)):
        at_m = sent[-late] if len(sent) >= late else start.translation
        sample = mode_input(
            vec3(-k_N_m * (at_m - centre_m)), (0.0, 0.0, 0.0), 0.0, "position", dt_s, gains, motion,
            pin.SE3(AXES, at_m),
        )  # fmt: skip
        if state is None:
            motion = next_motion(sample, LawSettings.of(cell))
        else:
            state, motion = adaptive.step(state, sample, settings_of)
        sent.append(np.round(motion.T_base_tcp.translation * 1e3 * PER_MM) / PER_MM * 1e-3)
    return np.array(sent)


@pytest.mark.parametrize("law", ["plain", "adaptive"])
@settings(max_examples=8, deadline=None)
@given(st.floats(5e3, STIFFEST_N_M), offsets_m)
def test_it_comes_to_rest_wherever_the_contact_is_between_two_packets(law, k_N_m, offset_m) -> None:
    """For any stiffness and place the last two seconds are one packet, within 1 N of the goal."""
    cell = cell_with_contact(k_N_m)
    centre_m = np.array([0.1, 0.5, 0.2]) + offset_m
    sent = packets(cell, law, k_N_m, centre_m)[-round(RESTS_S * cell.rates.control_hz) :]
    assert np.ptp(sent, axis=0).max() == 0.0
    allowed_N = k_N_m * cell.setpoint_rounding_m + cell.force.deadband_N
    assert k_N_m * np.linalg.norm(sent[-1] - centre_m) <= allowed_N


def test_only_a_packet_rounds() -> None:
    """Half the diagonal of a cube of packet units; nothing where no set points are packets."""
    cell = cell_with_contact(2e4)
    assert cell.setpoint_rounding_m == pytest.approx(np.sqrt(3.0) / 2.0 / PER_MM * 1e-3)
    assert CELL.setpoint_rounding_m == 0.0
    plain = load_cell(DEMO.with_name("demo-plain.yaml"))
    assert plain.setpoint_rounding_m == 0.0
    assert LawSettings.of(plain).rest_N == LawSettings.of(CELL).rest_N == 0.0
    assert LawSettings.of(cell).rest_N == pytest.approx(2e4 * cell.setpoint_rounding_m)


@given(vectors, st.floats(0.0, 10.0))
def test_a_larger_error_counts_in_full_and_a_smaller_one_not_at_all(error, least) -> None:
    """A shortened one would make the last newton slow."""
    size = np.linalg.norm(error)
    assume(abs(size - least) > ROUNDING)
    expected = error if size > least else np.zeros(3)
    assert soft_deadband(vec3(error), 0.0, least) == vec3(expected)
