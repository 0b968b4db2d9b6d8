"""The law of the sprung plate: stored energy, push, sticking and slipping."""

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sim.robot.plate import HALF_SIDE_M, ContactWrench, Disc, SprungPlate

RADIUS_M = 0.025
TICK_S = 0.001
DOWN = np.diag([1.0, -1.0, -1.0])  # a tool that stands upright on the plate


def plate(**changes: Any) -> SprungPlate:
    """Return the demo's plate."""
    values: dict[str, Any] = {
        "stiffness_N_m": 2e4,
        "tilt_stiffness_Nm_rad": 12.5,
        "relaxation_s": 0.001,
        "friction": 0.3,
    }
    return SprungPlate(**(values | changes))


def energy_J(plate: SprungPlate) -> float:
    """Return the elastic energy of the plate's springs [J]."""
    lengths2 = plate.travel_m**2 + plate.shear_m[0] ** 2 + plate.shear_m[1] ** 2
    angles2 = plate.slope[0] ** 2 + plate.slope[1] ** 2 + plate.twist_rad**2
    return 0.5 * (plate.stiffness_N_m * lengths2 + plate.tilt_stiffness_Nm_rad * angles2)


class DiscMover:
    """Moves a disc over a plate on command and counts the work of the plate on it."""

    def __init__(self, springs: SprungPlate, *, tilt_rad: float = 0.0, gap_m: float = 0.0) -> None:
        """Hold the disc over the plate's middle, turned about x."""
        self.springs = springs
        rim_m = RADIUS_M * abs(math.sin(tilt_rad))
        self.T = pin.SE3(pin.utils.rotate("x", tilt_rad) @ DOWN, np.array([0, 0, gap_m + rim_m]))
        self.work_J = self.taken_J = 0.0
        self.push = ContactWrench()

    def move(self, velocity_m_s, turn_rad_s=(0.0, 0.0, 0.0), steps: int = 1, dt_s=TICK_S) -> None:
        """Move with constant speeds for some steps."""
        v, w = np.array(velocity_m_s, dtype=float), np.array(turn_rad_s, dtype=float)
        for _ in range(steps):
            self.T = pin.SE3(pin.exp3(w * dt_s) @ self.T.rotation, self.T.translation + v * dt_s)
            disc = Disc(
                centre_m=tuple(self.T.translation.tolist()),
                back=tuple((-self.T.rotation[:, 2]).tolist()),
                velocity_m_s=tuple(v.tolist()),
                turn_rad_s=tuple(w.tolist()),
                radius_m=RADIUS_M,
            )
            self.push = self.springs.step(disc, dt_s)
            done_J = dt_s * float(v @ self.push.force_N + w @ self.push.torque_Nm)
            self.work_J += done_J
            self.taken_J += max(0.0, -done_J)

    def sink(self, depth_m: float) -> None:
        """Go down until the disc's lowest point is so far below the plate at rest, and wait."""
        tilt = math.hypot(*self.T.rotation[:2, 2])
        travel_m = self.T.translation[2] - RADIUS_M * tilt + depth_m
        self.move((0, 0, -travel_m / 0.1), steps=100)
        self.move((0, 0, 0), steps=50)


# --- energy ---------------------------------------------------------------------------------------

speeds = hnp.arrays(float, 3, elements=st.floats(-0.1, 0.1))
turns = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0))
legs = st.lists(st.tuples(speeds, turns, st.integers(5, 60)), min_size=1, max_size=8)


@settings(max_examples=30, deadline=None)
@given(
    legs,
    st.floats(0.0, 0.3),
    st.sampled_from([1e3, 2e4, 2e5]),
    st.floats(0.0, 1.5),
    st.floats(5e-4, 0.02),
    st.sampled_from([0.001, 0.0005, 0.00025]),
)
def test_the_plate_never_gives_more_work_than_it_took(
    path, tilt_rad, stiffness, friction, relaxation_s, dt_s
):
    """Approach, press, slide, turn, release at random: work and stored energy never add up to more.

    At every step, not only at the end; what is left is the second order of a step's turn.
    """
    springs = plate(
        stiffness_N_m=stiffness,
        tilt_stiffness_Nm_rad=stiffness * 0.025**2,
        friction=friction,
        relaxation_s=relaxation_s,
    )
    hand = DiscMover(springs, tilt_rad=tilt_rad, gap_m=0.0005)
    hand.move((0.0, 0.0, -0.05), steps=30, dt_s=dt_s)
    for velocity, turn, steps in path:
        for _ in range(steps):
            hand.move(velocity, turn, dt_s=dt_s)
            assert hand.work_J + energy_J(springs) <= 1e-9 + 2e-3 * hand.taken_J
            assert hand.push.normal_N >= 0.0
    hand.move((0.0, 0.0, 0.2), steps=300, dt_s=dt_s)
    assert hand.push == ContactWrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    assert hand.work_J <= 1e-9 + 2e-3 * hand.taken_J


@given(st.floats(0.0, 0.2), st.floats(0.0, 0.04), st.floats(2e-4, 1e-3))
@settings(max_examples=15, deadline=None)
def test_the_push_at_rest_is_the_slope_of_the_energy(tilt_rad, off_m, depth_m):
    """Moved by a hair in any direction, the energy changes by the push times the travel."""

    def rested(move, turn) -> tuple[ContactWrench, float]:
        hand = DiscMover(plate(friction=0.0), tilt_rad=tilt_rad)
        hand.move((off_m / 0.1, 0.3 * off_m / 0.1, 0.1), steps=100)
        hand.sink(depth_m)
        hand.move(1e3 * np.array(move), 1e3 * np.array(turn))
        hand.move((0, 0, 0), steps=60)
        return hand.push, energy_J(hand.springs)

    push, _ = rested((0, 0, 0), (0, 0, 0))
    wrench = np.concatenate((push.force_N, push.torque_Nm))
    hair = np.array([1e-7] * 3 + [1e-6] * 3)
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = hair[axis]
        rise_J = rested(step[:3], step[3:])[1] - rested(-step[:3], -step[3:])[1]
        assert -rise_J / (2 * hair[axis]) == pytest.approx(wrench[axis], rel=0.02, abs=3e-3)


# --- what it feels like ---------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_static_friction_holds_below_the_cone(share):
    """A push within the cone moves the disc as far as the spring gives, and stays for ever."""
    springs = plate()
    hand = DiscMover(springs)
    hand.sink(0.0005)
    limit_N = 0.3 * hand.push.normal_N
    travel_m = share * limit_N / springs.stiffness_N_m
    hand.move((travel_m / 0.02, 0, 0), steps=20)
    hand.move((0, 0, 0), steps=50)
    held_N = hand.push.force_N[0]
    assert held_N == pytest.approx(-share * limit_N, rel=1e-3)
    hand.move((0, 0, 0), steps=1000)
    assert hand.push.force_N[0] == pytest.approx(held_N, rel=1e-9)
    hand.move((-travel_m / 0.02, 0, 0), steps=20)
    hand.move((0, 0, 0), steps=50)
    assert hand.push.force_N[0] == pytest.approx(0.0, abs=1e-6)


def test_beyond_the_cone_it_slips_with_the_limit_and_the_twist_shares_it():
    """Coulomb's force against the travel; a disc that also turns gets less of it."""
    hand = DiscMover(plate())
    hand.sink(0.0005)
    hand.move((0.02, 0, 0), steps=500)
    limit_N = 0.3 * hand.push.normal_N
    assert hand.push.force_N[0] == pytest.approx(-limit_N, rel=1e-6)
    hand.move((0.02, 0, 0), (0, 0, 2.0), steps=100)
    used = math.hypot(hand.push.force_N[0], hand.push.torque_Nm[2] / RADIUS_M)
    assert used == pytest.approx(limit_N, rel=0.01)
    assert -hand.push.force_N[0] < 0.9 * limit_N
    assert hand.push.torque_Nm[2] < 0.0


@pytest.mark.parametrize("start", [(HALF_SIDE_M + 0.001, 0.0, 0.001), (0.2, -0.01, -0.02)])
def test_outside_and_below_the_plate_there_is_nothing_to_touch(start):
    """Nor does a tool that comes from the side below it get a blow."""
    hand = DiscMover(plate())
    hand.T.translation[:] = start
    hand.move((0.0, 0.0, -0.1), steps=50)
    hand.move((-0.2, 0.0, 0.0), steps=1000)
    assert hand.work_J == 0.0
