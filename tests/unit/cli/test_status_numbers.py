"""Numbers of a health message: permitted values, and their format in `forcemesh status`."""

import json
import threading
from math import inf, nan
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.status import describe_number
from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import dump_cell
from forcemesh import topics
from forcemesh.errors import MessageError
from forcemesh.messages import Health
from launch.processes import Supervisor
from launch.started_process import ProcessSpec
from tests.fakes.bench import Bench

pytestmark = pytest.mark.realtime

HUB = ProcessSpec("services.hub", ("hub",))
NUMBERS = {"framed_round_trip_p50_s": 0.0123, "sender_hz": 40.0, "monitor_speed_fraction": 0.1}


@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_number_that_is_not_finite_is_refused(number: float) -> None:
    """Every message that is received is valid."""
    with pytest.raises(MessageError, match=r"numbers\.sender_hz: must be a finite number"):
        Health.from_dict({"numbers": {"sender_hz": number}})


@pytest.mark.parametrize(
    ("name", "number", "words"),
    [
        ("framed_round_trip_p50_s", 0.0123, "network round trip (median) 12.3 ms"),
        ("sender_hz", 40.04, "reports of the controller 40.0 /s"),
        ("monitor_speed_fraction", 0.1, "monitor speed 10.0 %"),
        ("odd", 3.0, "odd 3"),
    ],
)
def test_the_suffix_of_a_name_is_its_unit(name: str, number: float, words: str) -> None:
    """Seconds as milliseconds, hertz as per second, fractions as percent."""
    assert describe_number(name, number) == words


def test_a_cell_on_the_virtual_clock_carries_them_on_its_bus() -> None:
    """A reader receives the map of the writer."""
    bench = Bench("robot", lambda bus, cell: HealthOnly(bus.publisher(topics.HEALTH["robot"])))
    assert bench.after_step(topics.HEALTH["robot"]).numbers == NUMBERS


class HealthOnly:
    """A robot that only publishes one health message a step."""

    def __init__(self, publisher) -> None:
        self._publisher = publisher
        self.period_s, self.trigger, self.fault = 0.004, None, ""

    def step(self, now_ns: int) -> None:
        """Publish the message."""
        self._publisher.put(Health(numbers=NUMBERS))

    def counters(self) -> dict[str, int]:
        """Return no counters."""
        return {}


@pytest.mark.processes
def test_status_shows_them_for_people_and_for_programs(cell: CellConfig, tmp_path: Path) -> None:
    """The table has one line below for each role with numbers; each row of --json has a map."""
    path = tmp_path / "file.yaml"
    path.write_text(dump_cell(cell))
    with Supervisor(cell, path, processes=[HUB]), open_bus(cell, "robot") as bus:
        publisher = bus.publisher(topics.HEALTH["robot"])
        report = json.loads(output_of(publisher, ["status", "--json", "--cell", str(path)]))
        text = output_of(publisher, ["status", "--cell", str(path)])
    rows = {row["name"]: row["numbers"] for row in report["services"]}
    assert rows["robot"] == NUMBERS
    assert set(rows["hub"]) | set(rows["arbiter"]) <= {"processor_fraction", "put_max_s"}
    line = next(line for line in text.splitlines() if line.startswith("  robot: "))
    assert line == (
        "  robot: network round trip (median) 12.3 ms, monitor speed 10.0 %, "
        "reports of the controller 40.0 /s"
    )


def output_of(publisher, words: list[str]) -> str:
    """Run a verb while the robot publishes."""
    stop = threading.Event()

    def publish() -> None:
        while not stop.wait(0.05):
            publisher.put(Health(pid=1, numbers=NUMBERS))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        return CliRunner().invoke(app, words).stdout
    finally:
        stop.set()
        thread.join()
