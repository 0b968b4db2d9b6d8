"""Tabs of the panel: their texts, fields, questions and requests, on a form without a browser."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.config.evidence import (
    BringupEvidence,
    StepEvidence,
    evidence_file,
    input_hashes,
    save_evidence,
)
from common.config.load import dump_cell, load_cell
from forcemesh.clock import NS_PER_S
from forcemesh.errors import BusError, RefusedError
from forcemesh.faults import tripped
from forcemesh.messages import RecorderStatus, RobotSignals, Trip
from forcemesh.requests import ForceStartRequest
from services.panel.tabs import all_tabs, move, signals
from services.panel.tabs.calibrate import LADDER_PERIOD_S, _add_ladder, ladder_text
from services.panel.tabs.force import SyncedField, forecast_line
from services.panel.tabs.record import words
from services.panel.viewer import RequestOutcome, Viewer
from services.panel.watch import Snapshot
from tests.fakes.bench import CELL, DEMO, HALF_RATES
from tests.fakes.lab import Lab
from tests.fakes.signals import ALL_OFF, FOLLOWING
from tools.tree import ROOT


class Element(SimpleNamespace):
    """An element of a form."""

    def on_click(self, action: Any) -> None:
        """Keep the action."""
        self.click = action


class Gui:
    """A form that keeps its elements."""

    def __init__(self) -> None:
        self.texts: list[Element] = []
        self.buttons: dict[str, Element] = {}

    def add_html(self, content: str) -> Element:
        """Add a text."""
        self.texts.append(Element(content=content))
        return self.texts[-1]

    def add_button(self, label: str, *, disabled: bool = False, **_: Any) -> Element:
        """Add a button, found by its first label."""
        self.buttons[label] = Element(label=label, disabled=disabled)
        return self.buttons[label]

    @contextmanager
    def add_folder(self, _label: str, **_style: Any) -> Iterator[None]:
        """Add the elements of a folder to the form."""
        yield


class ConfirmingViewer(Viewer):
    """A viewer whose person confirms every question at once; it keeps questions and answers."""

    def __init__(self, client: Any = None, cell: CellConfig = CELL, cell_file: Any = None) -> None:
        browser, watch = SimpleNamespace(gui=Gui()), SimpleNamespace(client=client)
        wizard, log = SimpleNamespace(cell_file=cell_file), None
        parts: dict[str, Any] = {"client": browser, "watch": watch, "wizard": wizard, "log": log}
        super().__init__(cell=cell, **parts)
        self.form: Gui = browser.gui
        self.questions: list[tuple[str, str]] = []  # label and text
        self.answers: list[tuple[str, str]] = []

    def confirm(self, what: str, text: Any, label: str, action: Any, **_: Any) -> None:
        """Confirm the question."""
        self.questions.append((label, f"{what}: {text}"))
        action()

    def show(self, what: str, answer: RequestOutcome) -> None:
        """Keep the answer."""
        self.answers.append((answer.word, answer.text))


def test_each_tab_is_there_once() -> None:
    """In this order."""
    labels = [tab.label for tab in all_tabs()]
    assert labels == ["Force", "Move", "Calibrate", "Signals", "Record", "Faults"]


# --- force ----------------------------------------------------------------------------------------

VALUES = st.sampled_from([7.0, 15.0, 25.0])
STEPS = st.lists(st.tuples(st.sampled_from(["cell", "types", "unknown"]), VALUES), max_size=12)


@given(STEPS)
def test_a_field_follows_the_cell_unless_a_user_has_changed_it(steps) -> None:
    """An input stays until the cell has the same value; other fields follow the cell."""
    handle = SimpleNamespace(value=15.0)
    field, typed, shown = SyncedField(handle), None, 15.0
    for action, value in steps:
        if action == "types":
            handle.value = typed = value
            typed = None if value == shown else value
        elif action == "unknown":
            field.follow(None)
        else:
            field.follow(value)
            typed = None if typed == value else typed
            shown = shown if typed is not None else value
        assert handle.value == (shown if typed is None else typed)
        assert field.is_own is (typed is not None)


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (ForceStartRequest(setpoint_N=15.0, law="plain"), "forecast: settles 0."),
        (ForceStartRequest(setpoint_N=15.0, law="adaptive"), "follows 20 mm/s across 10 degrees"),
        (ForceStartRequest(setpoint_N=2.0), "no forecast: set point is 2 N"),
        (ForceStartRequest(setpoint_N=15.0, mode="both"), "no forecast for mode both"),
        (ForceStartRequest(setpoint_N=15.0, host="controller"), "no forecast for host controller"),
        (ForceStartRequest(law="admittance"), "no forecast for law admittance"),
    ],
)
def test_the_forecast_follows_the_entries(request_: ForceStartRequest, text: str) -> None:
    """Set point, law, mode and host; otherwise why there is no forecast."""
    assert text in str(forecast_line(request_, CELL))


# --- back off -------------------------------------------------------------------------------------

NO_DIRECTION = RefusedError("no_direction", "no force can be followed: <b>", remedy="inspect")
STILL_LOADED = tripped("still_loaded", "the force is still 40 N")


@pytest.mark.parametrize(
    ("ends", "answer"),
    [
        ([tripped("back_off", "free after 3.5 mm")], ("done", "free after 3.5 mm")),
        ([STILL_LOADED], ("stopped", "not free yet: the force is still 40 N")),
        ([RefusedError("already", "nothing")], ("refused", "nothing")),
        ([RefusedError("state", "hold first")], ("refused", "hold first")),
        ([NO_DIRECTION, tripped("back_off", "5.0 mm back")], ("done", "5.0 mm back")),
        ([NO_DIRECTION, NO_DIRECTION], ("refused", "no force can be followed: <b>")),
    ],
)
def test_back_off_asks_again_only_where_no_force_can_be_followed(
    ends: list[Trip | RefusedError], answer: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reason stands in the second question as text; there is no third one."""
    ahead, asked = iter(ends), []

    def back_off(*, without_force: bool) -> Trip:
        asked.append(without_force)
        end = next(ahead)
        if isinstance(end, RefusedError):
            raise end
        return end

    monkeypatch.setattr(move, "in_background", lambda run: run())
    viewer = ConfirmingViewer(SimpleNamespace(back_off=back_off))
    move.add_back_off(viewer)
    viewer.form.buttons["Back off"].click(None)
    assert asked == [False, True][: len(ends)]
    labels = [label for label, _ in viewer.questions]
    assert labels == ["Back off now", "Move 5 mm back"][: len(ends)]
    assert all("followed: &lt;b&gt;" in text for _, text in viewer.questions[1:])
    assert (len(viewer.answers), viewer.answers[-1][0]) == (len(ends), answer[0])
    assert answer[1] in viewer.answers[-1][1]


# --- calibrate: the bring-up ladder ---------------------------------------------------------------

NOW = datetime(2026, 11, 27, 8, 0, tzinfo=UTC)


def test_every_step_of_the_bringup_is_shown_and_read_again(tmp_path: Path) -> None:
    """With its state and what is next; what a person wrote is text; a wrong file is reported."""
    cell_file = tmp_path / "lab.yaml"
    cell = load_cell(ROOT / "cells" / "demo-tcp.yaml")
    cell_file.write_text(dump_cell(cell))
    viewer = ConfirmingViewer(cell=cell, cell_file=cell_file)
    refresh = _add_ladder(viewer)
    refresh(Snapshot(now_ns=1))
    (rows,) = viewer.form.texts
    assert "<code>forcemesh bringup</code>" in rows.content
    passed = StepEvidence(passed_at=NOW, inputs=input_hashes(cell_file, ["gateway"]))
    failed = StepEvidence(failed_at=NOW, why="<b>off</b>")
    steps = {"network": passed, "doctor": failed, "jog": StepEvidence()}
    save_evidence(cell_file, BringupEvidence(steps=steps))
    later_ns = round(LADDER_PERIOD_S * NS_PER_S)
    refresh(Snapshot(now_ns=later_ns))
    assert "no evidence" in rows.content
    refresh(Snapshot(now_ns=later_ns + 1))
    assert "✔ <b>network</b> passed 2026-11-27 08:00 UTC" in rows.content
    assert "✖ <b>doctor</b> failed &lt;b&gt;off" in rows.content
    assert rows.content.endswith("<p>next: doctor</p></div>")
    save_evidence(cell_file, BringupEvidence(steps={"network": passed}))
    assert "all steps have passed" in ladder_text(cell_file)
    evidence_file(cell_file).write_text("bringup: 2\n")
    assert "⚠" in ladder_text(cell_file)
    without = ConfirmingViewer(cell=CELL.model_copy(update={"gateway": None}))
    _add_ladder(without)(Snapshot(now_ns=1))
    assert without.form.texts == []


# --- record ---------------------------------------------------------------------------------------

FILE = "/somewhere/demo-20261122T080000Z-01.mcap"


@pytest.mark.parametrize(
    ("status", "shown"),
    [
        (None, "no data from the recorder"),
        (RecorderStatus(memory_s=61.0), "not recording"),
        (RecorderStatus(memory_s=61.0), "Ring buffer: 61 s"),
        (RecorderStatus(recording=True, cause="asked", recorded_s=7.0), "● recording</b> for 7 s"),
        (RecorderStatus(recording=True, cause="force"), "started by <code>force</code>"),
        (
            RecorderStatus(file=FILE, messages=5, lost=2),
            "<code>demo-20261122T080000Z-01.mcap</code>: 5 messages",
        ),
        (RecorderStatus(valid=False, reason="0.5 GB are free"), "⚠ 0.5 GB are free"),
    ],
)
def test_the_recorders_status_is_shown(status: RecorderStatus | None, shown: str) -> None:
    """Silence, rest, a recording of either cause, losses, and a fault."""
    assert shown in words(status)


# --- signals --------------------------------------------------------------------------------------

NAMED_CELL = load_cell(DEMO, {**FOLLOWING, "rates": HALF_RATES})


def test_the_tab_shows_the_state_and_switches_what_is_permitted() -> None:
    """A button for each output of the operator; it confirms, switches, and changes its label."""
    lab = Lab(NAMED_CELL)
    client = ConfiguredCell(NAMED_CELL, bus=lab.cell.client, commander="operator")
    viewer = ConfirmingViewer(client, NAMED_CELL)
    refresh: Any = signals.build(viewer)
    assert list(viewer.form.buttons) == ["gripper_close: switch", "lamp: switch"]
    client.signals.read()
    refresh(None)
    button = viewer.form.buttons["lamp: switch"]
    assert (button.label, button.disabled) == ("lamp: switch on", False)
    button.click(None)
    client.signals.wait("part", timeout_s=1.0)
    refresh(None)
    assert button.label == "lamp: switch off"
    shown = viewer.form.texts[0].content
    assert shown.count("● on") == 2  # the lamp, and the part follows it
    assert shown.count("○ off") == len(ALL_OFF) - 2
    ((label, text),) = viewer.questions
    assert label == "Switch on"
    assert text.startswith("Switch lamp on: ")
    assert "may move" in text


def test_without_a_state_nothing_can_be_switched() -> None:
    """It is unknown, the buttons are disabled, a late click does nothing; or nothing is named."""

    class Unreachable:
        """A client without a connection."""

        @property
        def signals(self) -> Any:
            """Fail as a feed does that cannot be opened."""
            raise BusError("no hub")

    viewer = ConfirmingViewer(Unreachable(), NAMED_CELL)
    refresh: Any = signals.build(viewer)
    refresh(None)
    assert viewer.form.texts[0].content.count("unknown") == 1 + len(ALL_OFF)
    assert all(button.disabled for button in viewer.form.buttons.values())
    viewer.form.buttons["lamp: switch"].click(None)
    assert viewer.questions == []
    assert signals.word(RobotSignals(), "lamp") == "unknown"
    without = ConfirmingViewer()
    refresh = signals.build(without)
    refresh(None)
    assert "names no signals" in without.form.texts[0].content
    assert without.form.buttons == {}
