"""Order and search of the probe, with replies of a controller that does not exist."""

from collections.abc import Callable
from typing import cast

import pytest

from cli.probe.link import ProbeError, ProbeLink
from cli.probe.readings import ProbeReadings
from cli.probe.stages import Found, middle_round_trip_s, stage_b, stage_c
from sim.controller.behaviour import Behaviour
from tests.fakes.probed_controller import ProbedController

Reply = Callable[[str], dict[str, float]]


class Scripted:
    """A link whose replies come from a function; keeps the commands."""

    def __init__(self, reply: Reply, speed_mm_s: float = 0.0) -> None:
        """Take the function, and the speed of the motions in traces."""
        self.reply, self.commands, self.speed_mm_s = reply, list[str](), speed_mm_s

    def command(self, text: str, _: float = 0.0) -> ProbeReadings:
        """Return the function's values."""
        self.commands.append(text)
        if text == "trace":
            return ProbeReadings(samples=[(0.01 * k, 0.01 * k * self.speed_mm_s)
                                          for k in range(100)])  # fmt: skip
        return ProbeReadings(numbers={name: [value] for name, value in self.reply(text).items()})


def moved(
    reply: Reply, *, mspeed: float = 50.0, speed_mm_s: float = 0.0, **still: float
) -> tuple[Found, Scripted]:
    """Run stage c against a function."""
    found, link = Found(), Scripted(lambda text: reply(text) or {"x": 1.0}, speed_mm_s)
    found.still.numbers = {"mspeed": [mspeed]} | {name: [value] for name, value in still.items()}
    stage_c(cast("ProbeLink", link), found, lambda _: None)
    return found, link


def planner(least_s: float, slowest_s: float = 0.0) -> Reply:
    """Return the replies of a controller with this least segment, and this slow a program."""

    def reply(text: str) -> dict[str, float]:
        word, *numbers = text.split()
        if word == "go":
            return {"go": 1.0}
        if word != "segs":
            return {}
        asked_s = float(numbers[0]) / float(numbers[1])
        code = -31117.0 if asked_s < least_s else 0.0
        return {"segs.code": code, "segs.each_s": max(asked_s, slowest_s)}

    return reply


# --- stage b --------------------------------------------------------------------------------------


@pytest.mark.parametrize("cable", ["kept", "broken", "declined"])
def test_an_unplugged_cable_may_keep_or_end_the_connection(cable: str) -> None:
    """A person is asked twice; without a yes nothing is awaited."""
    controller = ProbedController(Behaviour(step_s=5e-4))
    link, found, questions = controller.link(), Found(), list[str]()

    def ask(question: str) -> bool:
        questions.append(question)
        if cable == "broken" and len(questions) == 2:
            link.wire.reset()
        return cable != "declined"

    stage_b(link, found, unplug=ask)
    assert len(questions) == (1 if cable == "declined" else 2)
    code = found.wire.get("end.unplug.code")
    assert code == (-34025.0 if cable == "broken" else None)
    assert found.stages == ["b"]
    assert (middle_round_trip_s(found) or 0.0) > 0.0


# --- stage c --------------------------------------------------------------------------------------


@pytest.mark.parametrize("least_s", [0.006, 0.016, 0.03, 0.09])
def test_the_search_ends_around_the_least_segment(least_s: float) -> None:
    """At most five errors, at intervals that fall until the first of them."""
    found, link = moved(planner(least_s))
    failed = [asked_s for asked_s, code, _ in found.segments if code]
    passed = [asked_s for asked_s, code, _ in found.segments if not code]
    assert max(failed) < least_s <= min(passed)
    assert min(passed) / max(failed) < 1.05
    assert len(failed) <= 4
    assert link.commands[-1] == "stay"


def test_without_e1117_the_search_ends_at_the_shortest_or_at_the_slowest_program() -> None:
    """A program that cannot give segments in time would show nothing.

    With E1117 at the longest one there is nothing to halve.
    """
    assert len(moved(planner(0.2))[0].segments) == 1
    quick, slow = (moved(planner(0.0, slowest_s))[0].segments for slowest_s in (0.0, 0.05))
    assert quick[-1][0] == pytest.approx(0.005, rel=0.3)
    assert slow[-1][0] == pytest.approx(0.02, rel=0.3)
    assert not any(code for _, code, _ in quick + slow)


@pytest.mark.parametrize(
    ("mspeed", "speed_mm_s", "absolute", "scale", "follows"),
    [
        (50.0, 5.1, 0.0, "0.5", True),
        (50.0, 9.5, -1.0, "1.0", False),
        (65.0, 6.5, 0.0, "0.65", True),
        (65.0, 9.5, 0.0, "1.0", False),
        (50.0, 0.0, 0.0, "0.5", None),
        (100.0, 10.0, 0.0, "1.0", None),
        (80.0, 8.0, 0.0, "0.8", None),
        (80.0, 8.0, -1.0, "1.0", None),
    ],
)
def test_the_first_motion_shows_whether_speed_follows_the_monitor_speed(
    mspeed: float, speed_mm_s: float, absolute: float, scale: str, follows: bool | None
) -> None:
    """Where it cannot, the switch ABS.SPEED decides for the program speeds, and null is written."""
    found, link = moved(
        planner(0.0), mspeed=mspeed, speed_mm_s=speed_mm_s, **{"switch.abs.speed": absolute}
    )
    assert f"scale {scale}" in link.commands
    assert found.follows is follows


@pytest.mark.parametrize(
    ("word", "values", "words"),
    [
        ("go", {"go": 0.0}, "fp.ok=1"),
        ("go", {"go": -1.0}, "out of reach"),
        ("brake", {"moved_away": 1.0}, "`brake`: the arm is not where stage c began"),
        ("segs", {"x": 1.0}, "the program gave no result"),
    ],
)
def test_stage_c_ends_with_the_reason(word: str, values: dict[str, float], words: str) -> None:
    """And the program is informed that it is over."""
    usual = planner(0.0)
    link = Scripted(
        lambda text: values if text.startswith(word) else usual(text) or {"x": 1.0}
    )  # fmt: skip
    found = Found()
    with pytest.raises(ProbeError, match=words):
        stage_c(cast("ProbeLink", link), found, lambda _: None)
    assert found.stages == []
    assert link.commands[-1] == ("go" if word == "go" else "stay")
