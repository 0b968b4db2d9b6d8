"""A pressed tool that follows a path of poses; its check in parts."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.bus.memory_bus import MemoryCall
from common.config.load import load_cell
from common.motion.convert import record_of
from control.path_follower import is_missed
from forcemesh import topics
from forcemesh.codec import Envelope, decode_record, encode_record
from forcemesh.force_task import parse_task
from forcemesh.requests import Empty, ForceStartRequest, PathRequest, Reply
from services.regulator import service
from services.regulator.path_request import turn_limits
from tests.fakes.bench import CELL, DEMO
from tests.fakes.regulator_bench import PERIOD_S, FollowingBench

FEED_M_S = 0.02
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


def test_points_lead_a_tool_that_yields_across_its_axis_until_their_end() -> None:
    """Friction does not push it off the path while there is one, and does afterwards."""
    bench = PlateBench(ForceStartRequest(mode="position", setpoint_N=PRESS_N, law="plain"))
    x_m, y_m, z_m = (bench.poses[-1].act(np.array([LENGTH_M, 0.0, 0.0]))).tolist()
    bench.lateral_N = 1.0
    path = PathRequest(points_m=((x_m, y_m, z_m),), speed_m_s=FEED_M_S)
    assert bench.ask(topics.FORCE_PATH, path).accepted
    bench.pass_s(1.0)
    aside_m = bench.travel_m()[1]
    bench.pass_s(0.3)
    assert (bench.published().path_left_m or 0.0) > 0.0
    assert bench.travel_m()[1] == pytest.approx(aside_m, abs=1e-5)
    bench.pass_s(1.0)
    assert bench.published().path_left_m == 0.0
    aside_m = bench.travel_m()[1]
    bench.pass_s(0.5)
    assert abs(bench.travel_m()[1] - aside_m) > 1e-4


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
