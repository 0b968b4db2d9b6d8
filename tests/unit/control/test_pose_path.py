"""Curve, feed and look-ahead of a path of poses."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall
from common.config.load import load_cell
from common.motion.convert import record_of
from common.motion.frames import apart
from control.path_curve import ROTATION_RADIUS_M, PathCurve, TurnLimits
from control.pose_path import is_missed
from forcemesh import topics
from forcemesh.codec import Envelope, decode_record, encode_record
from forcemesh.force_task import parse_task
from forcemesh.requests import Empty, ForceStartRequest, PathRequest, Reply
from services.regulator import service
from services.regulator.path_request import turn_limits
from tests.fakes.bench import CELL, DEMO
from tests.fakes.regulator_bench import PERIOD_S, FollowingBench

DT_S, FEED_M_S, ACCEL_M_S2, TURN_RAD_S = 0.004, 0.02, 0.3, 1.0
IN_PLACE_RAD_S = 0.3
TURNS = TurnLimits(TURN_RAD_S, IN_PLACE_RAD_S)
MOST_M, SLOW_S = 1.0, 0.05
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
angles = st.floats(-0.5, 0.5).map(lambda x: round(x, 3))
places = st.tuples(*[coordinates] * 3, *[angles] * 3)
routes = st.lists(places, min_size=1, max_size=6)
blends = st.sampled_from([0.0, 0.002, 0.02])


def pose_at(place: tuple[float, ...]) -> pin.SE3:
    """Return a pose of three coordinates and a rotation vector."""
    return pin.SE3(pin.exp3(np.array(place[3:])), np.array(place[:3]))


def start(**changes: float) -> PathCurve:
    """Return a path without poses at the origin."""
    return PathCurve(pin.SE3.Identity(), FEED_M_S, ACCEL_M_S2, TURNS)


def joined(path: PathCurve, poses: list[pin.SE3], blend_m: float) -> PathCurve:
    """Return the path with more poses, all joined."""
    path = path.extended(poses, blend_m)
    while path.waiting:
        path = path.joined()
    return path


def followed(path: PathCurve, dt_s: float = DT_S) -> list[PathCurve]:
    """Return the path at each period until it stands at its end."""
    passed = [path]
    while passed[-1].pending:
        assert len(passed) < 20_000, "the path does not end"
        passed.append(passed[-1].advanced(dt_s, share=1.0, most_m=MOST_M))
    return passed


@settings(max_examples=10)
@given(routes, blends)
def test_the_feed_never_exceeds_its_limits_and_the_end_is_reached_exactly(route, blend_m) -> None:
    """Travel, turn and acceleration of each period; the length that is left only falls."""
    poses = [pose_at(place) for place in route]
    passed = followed(start().extended(poses, blend_m), SLOW_S)
    assert apart(passed[-1].T_reference, poses[-1]) == pytest.approx((0.0, 0.0), abs=1e-9)
    for before, after in pairwise(passed):
        moved_m, turned_rad = apart(before.T_reference, after.T_reference)
        assert moved_m <= FEED_M_S * SLOW_S * 1.01
        assert turned_rad <= TURN_RAD_S * SLOW_S * 1.05 + 1e-9
        assert after.left_m <= before.left_m
        assert after.now_m_s <= before.now_m_s + ACCEL_M_S2 * SLOW_S + 1e-12


def test_the_tool_stops_at_a_sharp_corner_and_not_at_a_blended_one() -> None:
    """A blend of 3 mm is passed at the speed that its curvature and the acceleration permit."""
    corner = [pose_at((0.02, 0, 0, 0, 0, 0)), pose_at((0.02, 0.02, 0, 0, 0, 0))]
    slowest = [
        min(each.now_m_s for each in followed(start().extended(corner, blend_m))[20:-40])
        for blend_m in (0.0, 0.003)
    ]
    assert slowest[0] < 0.003
    assert slowest[1] == pytest.approx(FEED_M_S)


def test_it_brakes_over_several_short_pieces() -> None:
    """Not only in the last one."""
    route = [pose_at((1e-4 * number, 0, 0, 0, 0, 0)) for number in range(1, 60)]
    passed = followed(joined(start(), route, 0.0))
    for before, after in pairwise(passed):
        assert before.now_m_s - after.now_m_s <= 2.0 * ACCEL_M_S2 * DT_S + 1e-9


def test_a_corner_that_is_near_already_is_blended_without_a_jump() -> None:
    """The blend begins no earlier than where the tool is."""
    near = followed(start().extended([pose_at((0.02, 0, 0, 0, 0, 0))], 0.0))[-20]
    after = near.extended([pose_at((0.02, 0.02, 0, 0, 0, 0))], 0.01).joined()
    assert apart(near.T_reference, after.T_reference) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert after.pieces[0].length_m - after.done_m >= -1e-9


def test_a_tool_turns_in_place_at_the_feed_of_a_small_radius() -> None:
    """A rotation has no direction of travel, so the path stops before and after it."""
    turn = pose_at((0.0, 0.0, 0.0, 0.0, 0.0, 0.4))
    path = joined(start(), [turn, turn, pose_at((0.01, 0, 0, 0, 0, 0.4))], 0.005)
    assert len(path.pieces) == 2
    assert path.pieces[0].length_m == pytest.approx(0.4 * ROTATION_RADIUS_M)
    assert path.tangent == pytest.approx(np.zeros(3))
    assert path.ends_m_s == (0.0, 0.0)
    assert len(followed(path)) > 0.4 / IN_PLACE_RAD_S / DT_S


@given(st.floats(0.0, 0.1), st.floats(1e-3, 1.0))
def test_a_turn_that_the_travel_does_not_explain_has_a_speed_of_its_own(travel_m, angle) -> None:
    """A tool that travels over a convex body turns as fast as its feed; in place it is slow."""
    (piece,) = joined(start(), [pose_at((travel_m, 0, 0, 0, angle, 0))], 0.0).pieces
    turn_rad_s = piece.fastest_m_s * angle / piece.length_m
    explained = min(travel_m / (ROTATION_RADIUS_M * angle), 1.0)
    assert turn_rad_s <= TURN_RAD_S * (1 + 1e-6)
    assert turn_rad_s * (1.0 - explained) <= IN_PLACE_RAD_S * (1 + 1e-6)
    assert turn_rad_s >= IN_PLACE_RAD_S * (1 - 1e-6)


def test_a_blend_turns_its_tangent_by_half_in_the_middle() -> None:
    """Of a right angle."""
    corner = [pose_at((0.02, 0, 0, 0, 0, 0)), pose_at((0.02, 0.02, 0, 0, 0, 0))]
    _, blend, _ = joined(start(), corner, 0.005).pieces
    assert blend.tangent(0.5 * blend.length_m) == pytest.approx([0.5**0.5, 0.5**0.5, 0.0])


@settings(max_examples=20)
@given(routes, blends)
def test_a_pose_that_is_joined_while_the_tool_moves_changes_nothing(route, blend_m) -> None:
    """One is joined in each period, and the tool moves as on a curve that is joined at once."""
    poses = [pose_at(place) for place in route]
    lazy, whole = start().extended(poses, blend_m), joined(start(), poses, blend_m)
    for count in range(100):
        lazy = lazy.advanced(DT_S, share=1.0, most_m=MOST_M)
        whole = whole.advanced(DT_S, share=1.0, most_m=MOST_M)
        assert len(lazy.waiting) <= max(len(poses) - 1 - count, 0)
        assert apart(lazy.T_reference, whole.T_reference) == pytest.approx((0.0, 0.0), abs=1e-9)


# --- while the tool presses ---------------------------------------------------------------------

STIFFNESS_N_M, PRESS_N, LENGTH_M = 2e4, 10.0, 0.03
HELD = ForceStartRequest(
    mode="position", setpoint_N=PRESS_N, axes=(False, False, True) * 2, frame="tool"
)


class PlateBench(FollowingBench):
    """A tool that presses on a plate, which ends at one side; the path is along tool x."""

    lateral_N = 0.0  # across the path
    height_m = 0.0  # of the plate over the start

    def __init__(self, request: ForceStartRequest = HELD, edge_m: float = 1.0) -> None:
        """Begin in contact, with its set point."""
        self.edge_m = edge_m
        super().__init__()
        self.height_m = PRESS_N / STIFFNESS_N_M
        assert self.start(request).accepted
        self.pass_s(0.5)

    def travel_m(self) -> np.ndarray:
        """Return the travel since the start, in the tool axes of the start."""
        travel: np.ndarray = self.poses[0].actInv(self.poses[-1]).translation
        return travel

    def step(self, times: int = 1) -> None:
        """Let periods pass with the force of the plate."""
        for _ in range(times):
            x_m, _, z_m = self.travel_m()
            press_N = STIFFNESS_N_M * max(self.height_m + z_m, 0.0) * (x_m <= self.edge_m)
            x, y, z = (self.poses[0].rotation @ [0.0, self.lateral_N, -press_N]).tolist()
            self.push((x, y, z))
            super().step()

    def path(self, **fields: Any) -> PathRequest:
        """Return a path along tool x, on which the tool turns about its axis."""
        shares = np.linspace(0.0, 1.0, 20)
        steps = (
            pin.SE3(pin.utils.rotate("z", 0.5 * share), np.array([share * LENGTH_M, 0.0, 0.0]))
            for share in shares
        )
        poses = tuple(record_of(self.poses[0] * T) for T in steps)
        return PathRequest(poses=poses, speed_m_s=FEED_M_S, **fields)

    def follow_path(self, **fields: Any) -> None:
        """Send the path."""
        reply = self.ask(topics.FORCE_PATH, self.path(**fields))
        assert reply.text == "the tool follows 20 poses"


def test_without_contact_a_path_waits_or_goes_on_and_counts_what_it_missed() -> None:
    """Beyond the edge of the plate there is no force."""
    bench = PlateBench(edge_m=0.01)
    bench.follow_path()
    bench.pass_s(1.2)
    waiting = bench.published()
    assert waiting.path_missed_m is not None
    assert waiting.path_left_m == pytest.approx(LENGTH_M - 0.01, abs=1.5e-3)
    assert waiting.path_speed_m_s == 0.0
    assert waiting.path_missed_m < 1e-3
    bench = PlateBench(edge_m=0.01)
    bench.follow_path(in_contact=False)
    bench.pass_s(1.8)
    passed = bench.published()
    assert passed.path_left_m == 0.0, passed.reason
    assert bench.travel_m()[2] < 0.0012  # it has not dived into the gap
    assert passed.path_missed_m == pytest.approx(LENGTH_M - 0.01, abs=1.5e-3)


@pytest.mark.parametrize("law", ["plain", "adaptive"])
def test_the_feed_drops_while_the_force_is_wrong(law: str) -> None:
    """A jump of the surface slows the path until the force is there again."""
    bench = PlateBench(HELD.replaced(law=law))
    bench.follow_path()
    bench.pass_s(0.5)
    assert bench.published().path_speed_m_s == pytest.approx(FEED_M_S)
    bench.height_m += 0.0004
    speeds_m_s = []
    for _ in range(50):
        bench.step()
        speeds_m_s.append(bench.published().path_speed_m_s or 0.0)
    assert 0.0 < min(speeds_m_s) < 0.5 * FEED_M_S
    bench.pass_s(0.2)
    assert bench.published().path_speed_m_s == pytest.approx(FEED_M_S)


def test_a_path_is_missed_at_an_error_of_a_fifth_of_the_set_point() -> None:
    """And of 1 N at least."""
    assert [is_missed(error_N, 10.0) for error_N in (1.9, -2.1)] == [False, True]
    assert [is_missed(error_N, 0.0) for error_N in (0.9, 1.1)] == [False, True]


def test_a_path_waits_for_a_tool_that_limits_keep_behind() -> None:
    """The arbiter releases the same pose again and again: the reference does not run away."""
    bench = PlateBench()
    bench.follow_path()
    bench.pass_s(0.3)
    stuck = bench.published().pose
    bench.command = bench.command.replaced(kind="setpoint", pose=stuck, limited=True)
    bench.pass_s(1.0)
    left_m = bench.published().path_left_m
    bench.pass_s(0.5)
    assert bench.published().path_left_m == left_m
    assert left_m is not None
    assert left_m > 0.5 * LENGTH_M


def test_a_lateral_set_point_keeps_its_correction_along_a_path_of_poses() -> None:
    """In the frame of the path: what force control moves aside is not moved back."""
    bench = PlateBench(ForceStartRequest(task=parse_task("z=force:10 y=force:0", "path")))
    bench.follow_path()
    bench.pass_s(0.3)
    before_m, bench.lateral_N = bench.travel_m()[1], 2.0
    bench.pass_s(0.2)
    pushed_m, bench.lateral_N = bench.travel_m()[1] - before_m, 0.0
    assert pushed_m > 1e-4
    bench.pass_s(1.5)
    assert bench.travel_m()[1] - before_m > 0.5 * pushed_m


def test_a_path_turns_no_faster_than_the_arbiter_permits() -> None:
    """It slows travel and turn by one factor, so that a faster turn would slow force control."""
    fast = load_cell(DEMO, {"force.speed_max_rad_s": 2.0})
    assert turn_limits(fast).rad_s == pytest.approx(np.radians(fast.limits.speed_deg_s))
    assert turn_limits(CELL).rad_s == CELL.force.speed_max_rad_s


# --- check in parts -------------------------------------------------------------------------------

SAMPLES = 40


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A check in which each sample is found good and noted: this arm has no joint angles."""
    noted: list[int] = []

    def samples(*_: Any, **__: Any) -> Iterator[None]:
        for sample in range(SAMPLES):
            noted.append(sample)
            yield None

    monkeypatch.setattr(service, "tool_path_trips", samples)
    return noted


def waiting_path(bench: PlateBench) -> MemoryCall:
    """Return a request for a path that waits for its reply."""
    envelope = Envelope(client=bench.client.client)
    call = MemoryCall(encode_record(bench.path(), envelope))
    bench.transport.serve(f"{CELL.cell}/{topics.FORCE_PATH.key}").waiting.append(call)
    return call


def test_a_path_is_checked_in_parts_that_are_short_beside_a_period(checked: list[int]) -> None:
    """Some samples in each step; force control continues, and the reply comes at the end."""
    bench = PlateBench()
    call, counts = waiting_path(bench), list[int]()
    while call.reply is None:
        bench.step()
        assert bench.published().valid
        counts.append(len(checked) - sum(counts))
    assert decode_record(call.reply, Reply).accepted
    assert sum(counts) == SAMPLES
    assert max(counts) == round(PERIOD_S / service.CHECKED_S)


@pytest.mark.parametrize(
    ("key", "request_", "code"),
    [
        (topics.FORCE_STOP, Empty(), "not_armed"),
        (topics.FORCE_START, HELD.replaced(mode="both", axes=(True,) * 6), "axes"),
    ],
)
def test_a_path_whose_force_control_ends_or_changes_during_the_check_is_refused(
    checked: list[int], key: Any, request_: Any, code: str
) -> None:
    """It is not kept for the next start."""
    bench = PlateBench()
    call = waiting_path(bench)
    bench.step()
    assert 0 < len(checked) < SAMPLES
    assert bench.ask(key, request_).accepted
    bench.step(SAMPLES)
    assert call.reply is not None
    assert decode_record(call.reply, Reply).code == code
    bench.ask(topics.FORCE_STOP, Empty())
    assert bench.start(HELD).accepted
    bench.step()
    assert bench.published().path_left_m is None
