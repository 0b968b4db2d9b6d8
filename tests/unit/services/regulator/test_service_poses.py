"""A path of poses over a sphere: force, offset, feed, what is missed, and what is refused."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall
from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import apart
from forcemesh import topics
from forcemesh.codec import Envelope, decode_record, encode_record
from forcemesh.errors import MessageError
from forcemesh.force_task import parse_task
from forcemesh.messages import PoseRecord
from forcemesh.requests import Empty, ForceStartRequest, PathRequest, Reply
from services.regulator import service
from services.regulator.path_request import turn_limits
from services.regulator.tcp_path import MOST_PATH_POINTS
from tests.fakes.bench import CELL, DEMO
from tests.fakes.regulator_bench import PERIOD_S, FollowingBench

STIFFNESS_N_M, RADIUS_M, PRESS_N, FEED_M_S = 2e4, 0.08, 10.0, 0.02
TOOL = "z=force:10"
HELD = ForceStartRequest(
    mode="position", setpoint_N=PRESS_N, axes=(False, False, True) * 2, frame="tool"
)


class SphereBench(FollowingBench):
    """A tool that presses on the top of a sphere; the arm is where it is commanded, at once."""

    centre_m: np.ndarray | None = None
    lateral_N = 0.0  # a push across the path

    def __init__(self, lower_m: float = 0.0) -> None:
        """Begin in contact.

        Args:
            lower_m: By which the sphere ends at one side: no contact beyond it. 0: it does not end.
        """
        super().__init__()
        self.T_top = self.poses[-1]
        self.up = -self.T_top.rotation[:, 2]
        self.side = self.T_top.rotation[:, 0]
        self.axis = np.cross(self.up, self.side)
        sunk_m = PRESS_N / STIFFNESS_N_M
        self.centre_m = self.T_top.translation - self.up * (RADIUS_M - sunk_m)
        self.reaches_m = np.inf if lower_m == 0.0 else lower_m

    def force_N(self) -> np.ndarray:
        """Return the force of the sphere on the tool, base axes."""
        if self.centre_m is None:
            return np.zeros(3)
        away = self.p_tcp_m - self.centre_m
        size_m = float(np.linalg.norm(away))
        if away @ self.side > self.reaches_m:
            return np.zeros(3)
        return STIFFNESS_N_M * max(0.0, RADIUS_M - size_m) * away / size_m

    @property
    def lateral_m(self) -> float:
        """Travel across the path."""
        return float((self.p_tcp_m - self.T_top.translation) @ self.axis)

    def step(self, times: int = 1) -> None:
        """Let periods pass with the force of the sphere."""
        for _ in range(times):
            aside_N = 0.0 if self.centre_m is None else self.lateral_N * self.axis
            x, y, z = (self.force_N() + aside_N).tolist()
            self.push((x, y, z))
            super().step()

    def arc(
        self, end_rad: float, off_m: tuple[float, ...] = (0.0,) * 3, count: int = 20
    ) -> tuple[PoseRecord, ...]:
        """Return poses over the top, along the side, off as a program may be."""
        turns = [pin.exp3(self.axis * a) for a in np.linspace(0.0, end_rad, count)]
        return tuple(
            record_of(
                pin.SE3(
                    R @ self.T_top.rotation,
                    self.centre_m + R @ (self.up * RADIUS_M) + np.array(off_m),
                )
            )
            for R in turns
        )

    def errors_until_end(self, most_s: float = 20.0) -> list[float]:
        """Follow the path to its end; return the force errors [N]."""
        errors_N = []
        for _ in range(round(most_s / PERIOD_S)):
            self.step()
            target = self.published()
            assert target.valid, target.reason
            errors_N.append(float(np.linalg.norm(self.force_N())) - PRESS_N)
            if target.path_left_m == 0.0 and target.path_speed_m_s == 0.0:
                return errors_N
        raise AssertionError(f"{1e3 * (self.published().path_left_m or 0.0):.1f} mm are left")


def pressed(law: str, *, lower_m: float = 0.0, request: ForceStartRequest = HELD) -> SphereBench:
    """Return a bench that presses with its set point."""
    bench = SphereBench(lower_m)
    assert bench.start(request.replaced(law=law)).accepted
    bench.pass_s(0.5)
    return bench


@pytest.mark.parametrize("law", ["plain", "adaptive"])
def test_over_a_sphere_the_force_stays_and_the_tool_turns_with_it(law: str) -> None:
    """With an exact program: no correction is needed, and the end is reached exactly."""
    bench = pressed(law)
    poses = bench.arc(0.5)
    reply = bench.ask(topics.FORCE_PATH, PathRequest(poses=poses, speed_m_s=FEED_M_S))
    assert reply.text == "the tool follows 20 poses"
    errors_N = bench.errors_until_end()
    assert max(map(abs, errors_N)) < 0.2
    assert len(errors_N) * PERIOD_S == pytest.approx(0.5 * RADIUS_M / FEED_M_S, rel=0.05)
    away_m, away_rad = apart(bench.poses[-1], pose_of(poses[-1]))
    assert away_rad < 1e-6
    assert away_m == pytest.approx(PRESS_N / STIFFNESS_N_M, abs=1e-4)  # pressed in
    assert max(bench.steps_m) <= CELL.force.speed_max_m_s * PERIOD_S * (1 + 1e-9)
    assert bench.published().path_missed_m == 0.0


@pytest.mark.parametrize("law", ["plain", "adaptive"])
@settings(max_examples=5)
@given(st.tuples(*[st.floats(-0.001, 0.001)] * 3))
def test_a_program_that_is_off_changes_the_force_little_and_the_line_not_at_all(law, off) -> None:
    """Force control corrects the height alone; along the held axes the tool is as programmed."""
    bench = pressed(law)
    bench.ask(topics.FORCE_PATH, PathRequest(poses=bench.arc(0.4, off), speed_m_s=FEED_M_S))
    errors_N = bench.errors_until_end()
    assert float(np.mean(np.abs(errors_N[len(errors_N) // 3 :]))) < (
        0.6 if law == "adaptive" else 1.5
    )
    last = pose_of(bench.arc(0.4, off)[-1])
    aside = last.actInv(bench.poses[-1]).translation
    assert aside[:2] == pytest.approx([0.0, 0.0], abs=2e-5)


def test_a_given_direction_of_force_stays_while_the_tool_turns() -> None:
    """The force is along base z; the path moves along and about the other axes."""
    request = ForceStartRequest(task=parse_task("z=force:-10", "base"))
    bench = pressed("plain", request=request)
    poses = bench.arc(0.3)
    bench.ask(topics.FORCE_PATH, PathRequest(poses=poses, speed_m_s=FEED_M_S))
    for _ in range(2000):
        bench.step()
    assert bench.force_N()[2] == pytest.approx(10.0, abs=0.5)
    last = pose_of(poses[-1])
    assert bench.p_tcp_m[:2] == pytest.approx(last.translation[:2], abs=1e-5)
    assert apart(bench.poses[-1], last)[1] < 1e-6


def test_without_contact_a_path_waits_or_goes_on_and_counts_what_it_missed() -> None:
    """Beyond the edge of the surface there is no force."""
    bench = pressed("plain", lower_m=0.01)
    path = PathRequest(poses=bench.arc(0.3), speed_m_s=FEED_M_S)
    bench.ask(topics.FORCE_PATH, path)
    bench.pass_s(1.2)
    waiting = bench.published()
    assert waiting.path_missed_m is not None
    assert waiting.path_left_m == pytest.approx(0.3 * RADIUS_M - 0.01, abs=1.5e-3)
    assert waiting.path_speed_m_s == 0.0
    assert waiting.path_missed_m < 1e-3
    bench = pressed("plain", lower_m=0.01)
    bench.ask(topics.FORCE_PATH, path.replaced(in_contact=False))
    bench.pass_s(1.8)
    passed = bench.published()
    assert passed.path_left_m == 0.0, passed.reason
    below_m = pose_of(path.poses[-1]).actInv(bench.poses[-1]).translation[2]
    assert below_m < PRESS_N / STIFFNESS_N_M + 0.0012  # it has not dived into the gap
    assert passed.path_missed_m == pytest.approx(0.3 * RADIUS_M - 0.01, abs=1.5e-3)


def test_the_feed_drops_while_the_force_is_wrong() -> None:
    """A jump of the surface slows the path until the force is there again."""
    bench = pressed("plain")
    bench.ask(topics.FORCE_PATH, PathRequest(poses=bench.arc(0.6), speed_m_s=FEED_M_S))
    bench.pass_s(0.5)
    assert bench.published().path_speed_m_s == pytest.approx(FEED_M_S)
    bench.centre_m = bench.centre_m + 0.0004 * bench.up
    slowest = FEED_M_S
    for _ in range(50):
        bench.step()
        slowest = min(slowest, bench.published().path_speed_m_s or 0.0)
    assert slowest < 0.5 * FEED_M_S
    bench.pass_s(1.0)
    assert bench.published().path_speed_m_s == pytest.approx(FEED_M_S)


def test_a_path_waits_for_a_tool_that_limits_keep_behind() -> None:
    """The arbiter releases the same pose again and again: the reference does not run away."""
    bench = pressed("plain")
    bench.ask(topics.FORCE_PATH, PathRequest(poses=bench.arc(0.6), speed_m_s=FEED_M_S))
    bench.pass_s(0.3)
    stuck = bench.published().pose
    bench.command = bench.command.replaced(kind="setpoint", pose=stuck, limited=True)
    bench.pass_s(1.0)
    left_m = bench.published().path_left_m
    bench.pass_s(0.5)
    assert bench.published().path_left_m == left_m


def refused(bench: SphereBench, **changes) -> str:
    """Return code and text of the reply to a path request."""
    reply = bench.ask(topics.FORCE_PATH, PathRequest(**changes))
    return f"{reply.code}: {reply.text}"


def test_paths_that_cannot_be_followed_are_refused_by_name() -> None:
    """Each with what is wrong, and nothing of the path is followed."""
    bench = pressed("plain")
    first, *_, last = bench.arc(0.3)
    turned = record_of(pose_of(first) * pin.SE3(pin.utils.rotate("x", 2.0), np.zeros(3)))
    assert "pose 2 is turned by" in refused(bench, poses=(first, turned))
    far = first.replaced(position_m=(5.0, 0.0, 0.0))
    assert refused(bench, poses=(first, far)).startswith("workspace: point 2: ")
    x, y, z = bench.p_tcp_m.tolist()
    assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=((x + 0.01, y, z),))).accepted
    assert "cannot continue a path of points" in refused(bench, poses=(last,), append=True)
    assert bench.ask(topics.FORCE_PATH, PathRequest(poses=(first,))).accepted
    assert "cannot continue a path of poses" in refused(bench, points_m=((x, y, z),), append=True)
    both = refused(bench, poses=(first,), points_m=((x, y, z),))
    assert both == "setpoint: a path has points or poses, not both"
    many = PathRequest(poses=bench.arc(0.3, count=30), append=True)
    codes = [bench.ask(topics.FORCE_PATH, many).code for _ in range(MOST_PATH_POINTS // 30 + 1)]
    assert (codes[0], codes[-1]) == ("ok", "busy")
    assert bench.ask(topics.FORCE_PATH, PathRequest()).accepted
    bench.pass_s(0.1)
    assert bench.published().path_left_m == 0.0
    free = pressed("plain", request=ForceStartRequest(mode="position", setpoint_N=PRESS_N))
    assert refused(free, poses=(last,)).startswith("axes: the force controls every axis")


def record(x_m: float, w: float) -> dict[str, list[float]]:
    """Return a pose as JSON has it."""
    return {"position_m": [x_m, 0.0, 0.0], "orientation_xyzw": [0.0, 0.0, 0.0, w]}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"poses": [record(200.0, 1.0)]}, "position_m.0: must be at most 100"),
        ({"blend_m": -1.0}, "blend_m"),
    ],
)
def test_numbers_that_no_path_has_are_refused_on_decoding(changes, text) -> None:
    """Before they reach the regulator."""
    with pytest.raises(MessageError, match=text):
        PathRequest.from_dict(changes)


def test_a_lateral_set_point_keeps_its_correction_along_a_path_of_poses() -> None:
    """In the frame of the path: what force control moves aside is not moved back."""
    request = ForceStartRequest(task=parse_task("z=force:10 y=force:0", "path"))
    bench = pressed("plain", request=request)
    poses = bench.arc(0.3)
    bench.ask(topics.FORCE_PATH, PathRequest(poses=poses, speed_m_s=FEED_M_S))
    bench.pass_s(0.3)
    before_m, bench.lateral_N = bench.lateral_m, 2.0
    bench.pass_s(0.2)
    pushed_m, bench.lateral_N = bench.lateral_m, 0.0
    assert pushed_m > before_m + 1e-4
    bench.pass_s(1.5)
    assert bench.lateral_m > before_m + 0.5 * (pushed_m - before_m)


def test_a_path_turns_no_faster_than_the_arbiter_permits() -> None:
    """It slows travel and turn by one factor, so that a faster turn would slow force control."""
    fast = load_cell(DEMO, {"force.speed_max_rad_s": 2.0})
    assert turn_limits(fast).rad_s == pytest.approx(np.radians(fast.limits.speed_deg_s))
    assert turn_limits(CELL).rad_s == CELL.force.speed_max_rad_s


SAMPLES = 40  # of the check of a path


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A check in which each sample is found good and noted: this arm has no joint angles."""
    noted: list[int] = []

    def samples(*_: Any, **__: Any) -> Iterator[None]:
        for sample in range(SAMPLES):
            noted.append(sample)
            yield None

    monkeypatch.setattr(service, "tool_path_refusals", samples)
    return noted


def waiting_path(bench: SphereBench) -> MemoryCall:
    """Return a request for a path that waits for its reply."""
    request = PathRequest(poses=bench.arc(0.5), speed_m_s=FEED_M_S)
    call = MemoryCall(encode_record(request, Envelope(client=bench.client.client)))
    bench.transport.serve(f"{CELL.cell}/{topics.FORCE_PATH.key}").waiting.append(call)
    return call


def test_a_path_is_checked_in_parts_that_are_short_beside_a_period(checked: list[int]) -> None:
    """Some samples in each step; force control continues, and the reply comes at the end."""
    bench = pressed("plain")
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
    bench = pressed("plain")
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
