"""The bring-up ladder in the panel's tab of the calibration."""

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from common.config.evidence import (
    BringupEvidence,
    StepEvidence,
    evidence_file,
    input_hashes,
    save_evidence,
)
from common.config.load import dump_cell, load_cell
from forcemesh.clock import NS_PER_S
from services.panel.tabs.calibrate import LADDER_PERIOD_S, _add_ladder, ladder_text
from services.panel.watch import Snapshot
from tools.tree import ROOT

NOW = datetime(2026, 11, 27, 8, 0, tzinfo=UTC)


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    """A cell with a controller."""
    path = tmp_path / "lab.yaml"
    path.write_text(dump_cell(load_cell(ROOT / "cells" / "demo-tcp.yaml")))
    return path


def test_every_step_is_shown_with_its_state_and_what_is_next(cell_file: Path) -> None:
    """What a person or a device wrote is text."""
    assert "<code>forcemesh bringup</code>" in ladder_text(cell_file)
    passed = StepEvidence(passed_at=NOW, inputs=input_hashes(cell_file, ["gateway"]))
    failed = StepEvidence(failed_at=NOW, why="<b>off</b>")
    steps = {"network": passed, "doctor": failed, "jog": StepEvidence()}
    save_evidence(cell_file, BringupEvidence(steps=steps))
    text = ladder_text(cell_file)
    assert "✔ <b>network</b> passed 2026-11-27 08:00 UTC" in text
    assert "✖ <b>doctor</b> failed &lt;b&gt;off" in text
    assert text.endswith("<p>next: doctor</p>")
    save_evidence(cell_file, BringupEvidence(steps={"network": passed}))
    assert "all steps have passed" in ladder_text(cell_file)


def test_a_wrong_evidence_file_is_reported(cell_file: Path) -> None:
    """The page continues without it."""
    evidence_file(cell_file).write_text("bringup: 2\n")
    assert "⚠" in ladder_text(cell_file)


class CountedGui:
    """A form that counts what is sent to the browser."""

    def __init__(self) -> None:
        """Start empty."""
        self.elements: list[Any] = []

    def add_html(self, content: str) -> Any:
        """Add an element."""
        self.elements.append(SimpleNamespace(content=content))
        return self.elements[-1]

    def add_folder(self, _label: str, **_style: Any) -> "CountedGui":
        """Return the folder, itself."""
        return self

    def __enter__(self) -> None:
        """Begin the folder."""

    def __exit__(self, *_: object) -> None:
        """End the folder."""


def test_the_ladder_is_read_again_every_two_seconds(cell_file: Path) -> None:
    """A cell without a controller has none."""
    gui, cell = CountedGui(), load_cell(cell_file)
    viewer: Any = SimpleNamespace(gui=gui, cell=cell, wizard=SimpleNamespace(cell_file=cell_file))
    refresh = _add_ladder(viewer)
    refresh(Snapshot(now_ns=1))
    assert "no evidence" in gui.elements[0].content
    save_evidence(cell_file, BringupEvidence(steps={"jog": StepEvidence()}))
    later_ns = round(LADDER_PERIOD_S * NS_PER_S)
    refresh(Snapshot(now_ns=later_ns))
    assert "no evidence" in gui.elements[0].content
    refresh(Snapshot(now_ns=later_ns + 1))
    assert "next: jog" in gui.elements[0].content

    viewer.cell = cell.model_copy(update={"gateway": None})
    _add_ladder(viewer)(Snapshot(now_ns=1))
    assert len(gui.elements) == 1
