"""Scenes of the force benchmark as regression tests of the adaptive law, and their judgement."""

import numpy as np
import pytest

from bench.force import scenes
from bench.force.laws import ADAPTIVE, Peer, holding
from bench.force.requirements import closest, requirements
from bench.force.rig import ForceRig, LawSample, SceneSettings, means, settling_s
from bench.force.tables import TABLES, release_row, scene_row, with_ours
from bench.results import read

IN_TAU = {"first_tau": 9.0, "identified_tau": 5.0, "overshoot_pct": 5.0}
OVERSHOOT = {"overshoot_pct": 5.0}
WRONG_DELAY = {"first_tau": 11.0, "overshoot_pct": 10.0}


@pytest.mark.parametrize(
    ("k", "delay_ms", "changes", "least_ratio", "limits"),
    [
        (5e3, 10, {}, 0.99, IN_TAU),
        (2e4, 0, {}, 0.97, IN_TAU),
        (2e4, 30, {}, 0.97, IN_TAU),
        (1e5, 60, {}, 0.88, IN_TAU),
        (5e3, 10, {"loop_hz": 60.0}, 0.98, OVERSHOOT),
        (2e4, 30, {"loop_hz": 80.0}, 0.98, OVERSHOOT),
        (5e3, 30, {"loop_hz": 30.0}, 0.98, OVERSHOOT),
        (2e4, 10, {"delay_error_ms": 10.0}, 0.0, WRONG_DELAY),
        (2e4, 10, {"delay_error_ms": -5.0}, 0.0, WRONG_DELAY),
        (2e4, 10, {"loop_hz": 60.0}, 0.0, {"first_s": 0.5, "identified_s": 0.35, **OVERSHOOT}),
        (2e4, 10, {"loop_hz": 15.0}, 0.0, {"first_s": 1.4, "identified_s": 0.65, **OVERSHOOT}),
    ],
)
def test_one_setting_releases_every_stiffness_in_time(
    k, delay_ms, changes, least_ratio, limits
) -> None:
    """From 30 N; found: in slow loops the stiffness was underestimated, the overshoot 84 %.

    The estimate may be lower than the plate's stiffness because the servos yield as well.
    """
    row = release_row({"stiffness_N_m": k, "delay_ms": delay_ms, **changes})
    assert None not in (row["first_s"], row["identified_s"])
    assert {name: row[name] for name, limit in limits.items() if row[name] > limit} == {}
    assert least_ratio == 0.0 or least_ratio <= row["stiffness_ratio"] <= 1.35


@pytest.mark.parametrize("stiffness_N_m", [5e3, 1e5])
def test_a_surface_is_followed(stiffness_N_m) -> None:
    """10 N on a slope of 10 degrees at 20 mm/s: 0.1 N of error, on hard and soft surfaces."""
    found = scenes.slope(SceneSettings(stiffness_N_m, 10), ADAPTIVE)
    assert found["mean_error_N"] <= 0.1
    assert found["onset_of_k_v_tau"] <= 1.2
    assert found["contact_lost"] == 0.0


@pytest.mark.parametrize(("stiffness_N_m", "delay_ms"), [(5e3, 10), (5e3, 30), (2e4, 30)])
def test_a_changed_set_point_is_reached_and_held(stiffness_N_m, delay_ms) -> None:
    """By 10 N: at most 5 % beyond, and within a quarter of a newton for three seconds more."""
    world = SceneSettings(stiffness_N_m, delay_ms)
    assert scenes.set_point_step(world, ADAPTIVE)["overshoot_pct"] <= 5.0
    rig, pilot, _ = holding(world, ADAPTIVE)
    pilot.setpoint_N = 20.0
    rig.run(pilot, 1.5)
    assert np.abs(rig.run(pilot, 3.0).smooth_N - 20.0).max() <= 0.25


def test_the_arm_travels_little_after_a_wall_vanishes() -> None:
    """At 50 mm/s at most three millimetres."""
    world = SceneSettings(5e3, 10, speed_m_s=0.05)
    assert scenes.wall_vanishes(world, ADAPTIVE)["travel_mm"] <= 3.0


def test_every_scene_that_needs_a_plate_ten_times_softer_can_have_one() -> None:
    """A world that the simulated cell refuses would end the whole benchmark."""
    for k in {case["stiffness_N_m"] / 10.0 for case in TABLES["ten-times-stiffer"].cases}:
        SceneSettings(k).cell()


def test_settling_is_the_last_entry_into_the_band() -> None:
    """The means are over 8 ms; a short stay does not count; None means never."""
    t = np.arange(0.0, 1.0, 0.004)
    assert settling_s(t, np.where(t < 0.5, 5.0, 0.0)) == pytest.approx(0.508, abs=0.005)
    assert settling_s(t, np.where((t > 0.2) & (t < 0.3), 0.0, 5.0)) is None
    assert settling_s(t, np.zeros_like(t)) == 0.0
    assert means(t, np.ones_like(t)) == pytest.approx(np.ones_like(t))


@pytest.mark.parametrize("kind", ["admittance", "FDCC-like"])
def test_a_peer_moves_at_a_steady_speed_of_gain_times_force(kind) -> None:
    """Both reach gain times force, so the same search can tune them."""
    rig = ForceRig(SceneSettings().cell())
    T, pilot = rig.T_base_tcp, Peer(kind, rig, 1e-3, 0.01)
    force = np.array([0.0, 0.0, 10.0])
    sample = LawSample(force, np.zeros(3), T, T, limited=False, dt_s=0.004)
    places = [pilot.step(sample).translation[2] for _ in range(200)]
    assert (places[-1] - places[-2]) / 0.004 == pytest.approx(1e-3 * 10.0, rel=0.01)


def test_the_requirements_are_judged_from_the_rows() -> None:
    """Those that the rows cover; a release over TCP that was stopped is not met."""
    row = release_row({"stiffness_N_m": 2e4, "delay_ms": 10})
    tcp = {"law": ADAPTIVE, "stiffness_N_m": 2e4, "outcome": "stopped: E1117"}
    peer = {"law": "plain PI", "stiffness_N_m": 2e4, "delay_ms": 10, "tuned_here_s": 0.2}
    wall = {"law": ADAPTIVE, "stiffness_N_m": 2e4, "delay_ms": 10, "speed_m_s": 0.02}
    rows = {
        **dict.fromkeys(TABLES, ()),
        "release": [row],
        "over-tcp": [tcp],
        "fixed-gain": [{"fixed_s": 5.0, "identified_s": 0.13}],
        "wall-vanishes": [scene_row(wall, scenes.wall_vanishes)],
        "peers": [*with_ours([peer], [row])],
    }
    made = requirements(rows)
    assert [each["group"] for each in made if not each["met"]] == ["over TCP", "over TCP"]
    assert {each["group"] for each in made} == {"releases", "over TCP", "scenes", "other laws"}
    nearest = {each["group"]: each for each in closest(made)}
    assert (nearest["over TCP"]["met"], nearest["releases"]["met"]) == (False, True)
    worse = requirements({**rows, "release": [{**row, "first_tau": 9.9}]})
    assert [e["met"] for e in worse if e["quantity"] == "first contact, tau"] == [False]


def test_the_stored_result_has_every_requirement_and_its_nearest_to_the_limit() -> None:
    """All 41 are met; the nearest ones follow from them."""
    stored = read("force").tables
    required = stored["requirements"].records
    assert len(required) == 41
    assert all(each["met"] == (each["worst_result"] <= each["limit"]) for each in required)
    assert [each["worst_result"] for each in closest(required)] == [
        each["worst_result"] for each in stored["closest"].records
    ]
