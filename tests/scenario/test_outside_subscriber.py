"""The subscriber of docs/bus.md reads the bus with Zenoh and MessagePack alone."""

import ast
import re
from pathlib import Path

import pytest

from common.config.load import load_cell

PAGE = Path(__file__).parents[2] / "docs" / "bus.md"

pytestmark = pytest.mark.processes


def snippet(cell_file: Path) -> str:
    """Return the subscriber of the bus page, for the cell of this test."""
    cell = load_cell(cell_file)
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert code is not None
    text = code.group(1).replace("tcp/127.0.0.1:7447", cell.bus.endpoint)
    return text.replace("demo/wrench", f"{cell.cell}/wrench").replace("print(", "print(*", 1)


def test_the_subscriber_of_the_bus_page_reads_the_wrench(cell_file, start):
    """Only zenoh and msgpack are imported, and the force is printed in newtons."""
    code = snippet(cell_file).replace("])", "], flush=True)")
    imports = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Import)]
    assert {name.name for node in imports for name in node.names} == {"msgpack", "zenoh"}
    up = start("-m", "cli", "up", "--cell", cell_file)
    assert "is up" in next(line for line in up.stderr if "is up" in line)

    subscriber = start("-c", code)
    numbers = [float(word) for word in subscriber.stdout.readline().split()]

    assert len(numbers) == 3
    assert all(abs(number) < 5.0 for number in numbers)  # in the air: the old bias is nearly right
