"""Name and hub of a cell, from a cell file or from two words: all that a client needs."""

from pathlib import Path

import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.info import cell_info
from common.config.load import load_cell
from forcemesh import Cell, ConfigError, LostError
from forcemesh.cell_info import ask_for_info
from forcemesh.connection import read_connection
from forcemesh.topics import TOPICS
from launch.virtual_cell import VirtualCell

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted((ROOT / "cells").glob("*.yaml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_cell_file_gives_the_connection_that_its_cell_has(path: Path) -> None:
    """The two sections are read as the whole file is."""
    whole, found = load_cell(path), read_connection(path)
    assert (found.cell, found.bus) == (whole.cell, whole.bus)


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("bus: {}\n", "cell: missing"),
        ("cell: lab\nbus: {endpiont: tcp/1:1}\n", "bus.endpiont: unknown name; did you mean endp"),
        ("- a list\n", "the file must hold a map of sections"),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path: Path, text: str, mistake: str) -> None:
    """As for a whole cell file."""
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_connection(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert mistake in str(caught.value)


@pytest.mark.parametrize(
    ("endpoint", "name", "mistake"),
    [("127.0.0.1", "demo", "bus.endpoint"), ("tcp/127.0.0.1:1", "De mo", "cell: must be")],
)
def test_a_wrong_endpoint_or_name_is_refused_before_anything_is_sent(
    endpoint: str, name: str, mistake: str
) -> None:
    """The two words are checked as a file is."""
    with pytest.raises(ConfigError, match=mistake):
        Cell(endpoint, name)


def test_the_hub_sends_a_client_the_facts_of_its_cell_file() -> None:
    """Rates and deadlines of every topic, roles and tool: as the file has them."""
    world = VirtualCell(load_cell(ROOT / "cells" / "demo.yaml"))
    world.advance(0.5)
    info = ask_for_info(world.client.transport, "demo")
    assert info == cell_info(world.cell)
    for topic in TOPICS:
        assert info.stale_after_s(topic) == world.cell.stale_after_s(topic)
        assert info.rate_hz(topic) == world.cell.rate_hz(topic)
    client = Cell(world.cell, bus=world.client)
    assert client.info == ConfiguredCell(world.cell, bus=world.client).info
    with pytest.raises(LostError, match=r"did not answer other/info .* is other the cell's name\?"):
        ask_for_info(world.client.transport, "other", 0.1)
