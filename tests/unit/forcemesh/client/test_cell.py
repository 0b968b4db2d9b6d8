"""The client's short verbs on a whole cell in virtual time."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.bus.configured_cell import ConfiguredCell
from forcemesh import topics
from forcemesh.client import ArmStoppedError, DataError, LostError, NotReachedError, RefusedError
from forcemesh.faults import FAULTS
from forcemesh.messages import PoseRecord
from forcemesh.requests import Empty, HoldRequest, MoveRequest
from tests.fakes.lab import Lab

SELDOM_NS = 30_000_000
README = Path(__file__).resolve().parents[4] / "README.md"


@pytest.fixture
def lab() -> Lab:
    """A cell that was tared and armed."""
    return Lab()


@pytest.fixture
def cell(lab: Lab) -> Iterator[ConfiguredCell]:
    """A client on it."""
    with ConfiguredCell(lab.cell.cell, bus=lab.cell.client) as client:
        yield client


@pytest.fixture(scope="module")
def calm() -> ConfiguredCell:
    """A client on a cell that stays armed and still; tests share it."""
    lab = Lab()
    return ConfiguredCell(lab.cell.cell, bus=lab.cell.client)


def up(cell: ConfiguredCell) -> MoveRequest:
    """A move up that takes a while."""
    state = cell.state()
    x, y, z = state.position_m
    pose = PoseRecord(position_m=(x, y, z + 0.05), orientation_xyzw=state.orientation_xyzw)
    return MoveRequest(kind="pose", pose=pose, commander="program")


def test_the_example_of_the_readme_presses(lab: Lab) -> None:
    """Word for word, but for the cell: this one lives in virtual time."""
    example = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[0]
    here = 'Cell("cells/demo.yaml")'
    assert example.count(here) == 1
    printed: list[float] = []
    code = example.replace(here, "Cell(config, bus=bus)")
    exec(code, {"config": lab.cell.cell, "bus": lab.cell.client, "print": printed.append})  # noqa: S102
    assert printed == [pytest.approx(15.0, abs=1.0)]
    assert lab.force_N == pytest.approx(8.0, abs=1.0)


def test_every_verb_waits_until_it_is_so(lab: Lab, cell: ConfiguredCell) -> None:
    """Hold, clear, arm, press, stop; the example of the README changes the set point."""
    cell.hold("a test")
    cell.clear()
    assert cell.status().state == "IDLE"
    cell.arm()
    assert cell.force.press(15.0).force_N == pytest.approx(15.0, abs=1.0)
    assert lab.force_N == pytest.approx(15.0, abs=1.0)
    cell.force.stop()
    lab.cell.advance(0.2)
    assert cell.status().commander == "none"


def test_a_refusal_carries_code_remedy_and_the_number_that_was_too_much(
    calm: ConfiguredCell,
) -> None:
    """Codes and numbers for a program, and the sentence for a person."""
    with pytest.raises(RefusedError) as caught:
        calm.force.start(500.0)
    error = caught.value
    assert (error.code, error.value) == ("setpoint", 500.0)
    assert error.limit == calm.config.force.setpoint_max_N
    assert error.remedy == FAULTS["setpoint"].remedy
    assert str(error).endswith(f"[value 500, limit {error.limit:g}] -> {error.remedy}")


def test_a_move_returns_where_the_arm_is(lab: Lab, cell: ConfiguredCell) -> None:
    """To a pose and by joint angles; the state that comes back is that of the end."""
    before = cell.state()
    x, y, z = before.position_m
    there = cell.move.to((x, y, z + 0.03), speed_m_s=0.1)
    assert there.position_m == pytest.approx((x, y, z + 0.03), abs=1e-4)
    turned = cell.move.by((0.0, 0.0, 0.0, 0.0, 0.0, 0.1))
    assert turned.joint_rad[5] == pytest.approx(there.joint_rad[5] + 0.1, abs=1e-3)
    assert lab.state.goal.state == "done"


def test_a_move_that_returned_may_be_followed_by_the_next_at_once(
    lab: Lab, cell: ConfiguredCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the arbiter receives the arrival after the client, as on a busy machine."""
    arbiter = lab.cell.runners["arbiter"]
    step = arbiter.step
    monkeypatch.setattr(arbiter, "step", lambda now_ns: now_ns % SELDOM_NS == 0 and step(now_ns))
    x_m, y_m, z_m = cell.state().position_m
    for number in range(8):
        cell.move.to((x_m, y_m, z_m + 0.001 * (1 + number % 2)))


def test_a_move_that_is_stopped_reports_the_reason(lab: Lab, cell: ConfiguredCell) -> None:
    """A hold by another client ends the waiting with its reason and the remedy."""
    going = cell.move.begin(up(cell))
    lab.cell.advance(0.3)
    lab.ask(topics.HOLD, HoldRequest(reason="a visitor"))
    with pytest.raises(ArmStoppedError, match="a visitor") as caught:
        going.wait()
    assert caught.value.code == "hold"
    assert caught.value.remedy == FAULTS["hold"].remedy


def test_pressing_that_does_not_come_about_stops_force_feedback(
    lab: Lab, cell: ConfiguredCell
) -> None:
    """The time is up while the tool is still above the plate."""
    with pytest.raises(NotReachedError, match=r"15 N were not reached within 0\.1 s"):
        cell.force.press(15.0, within_s=0.1)
    lab.cell.advance(0.2)
    assert cell.status().commander == "none"
    assert cell.target.reading().message.mode is None  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("do", "names"),
    [
        (lambda cell: cell.force.press(-1.0), "setpoint_N: must be at least 0 N, found -1 N"),
        (lambda cell: cell.force.path((("a", 0.0, 0.0),)), "points_m.0.0: .*found 'a'"),
        (lambda cell: cell.force.gains(force_i_m_per_Ns=(1.0, 2.0)), "force_i_m_per_Ns"),
        (lambda cell: cell.jog(shift_m=(float("nan"), 0.0, 0.0)), "position_m"),
        (
            lambda cell: cell.speed(mechanical_m_s=-1.0),
            "mechanical_m_s: must be above 0 m/s, found -1 m/s",
        ),
        (lambda cell: cell.arm("weld"), "purpose: .*found 'weld'"),
    ],
)
def test_an_argument_that_no_request_can_carry_is_named(
    calm: ConfiguredCell, do, names: str
) -> None:
    """One sentence of ours, nothing was sent."""
    with pytest.raises(DataError, match=names):
        do(calm)


def test_a_service_that_died_is_named(lab: Lab, cell: ConfiguredCell) -> None:
    """By its feed that ended, and by the request without an answer."""
    lab.cell.kill("wrench")
    with pytest.raises(LostError, match=r"silent: wrench\b") as caught:
        cell.ask(topics.TARE, Empty(), answer_s=0.1)
    assert caught.value.roles == ("wrench",)
    with pytest.raises(LostError, match="wrench missing"):
        cell.wrench(within_s=0.05)


def test_a_stream_yields_each_message_once_and_in_order(calm: ConfiguredCell) -> None:
    """At the rate of the cell, with the stamps of its writer."""
    received = list(calm.wrench.stream(seconds=0.5))
    numbers = [each.header.seq for each in received]
    assert numbers == sorted(set(numbers))
    rate_hz = calm.config.rate_hz(topics.WRENCH)
    assert len(received) == pytest.approx(0.5 * rate_hz, rel=0.1)
    assert received[-1].stamp_s - received[0].stamp_s == pytest.approx(0.5, rel=0.1)
