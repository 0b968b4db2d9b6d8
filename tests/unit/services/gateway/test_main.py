"""Start of the gateway's process."""

import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from controller.plain import NOT_PROTECTED
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from services.gateway.__main__ import start
from services.gateway.service import Gateway
from tools.tree import ROOT


@pytest.mark.parametrize("name", ["demo-plain", "demo-tcp"])
def test_the_gateway_writes_at_its_start_what_protocol_plain_gives_up(name: str, capsys) -> None:
    """Line by line; nothing with our own protocol."""
    cell = load_cell(ROOT / "cells" / f"{name}.yaml")
    bus = Bus("robot", cell.cell, MemoryTransport(), cell, ManualClock())
    assert isinstance(start(bus, cell), Gateway)
    written = capsys.readouterr().err.splitlines()
    expected = ["gateway.protocol is plain, without:", *(f"  {line}" for line in NOT_PROTECTED)]
    assert written == (expected if name == "demo-plain" else [])
