"""`forcemesh probe`: questions, files and exit codes, on a controller in lock step."""

import os
import re
from pathlib import Path

import pytest
import yaml

from cli.context import INTERRUPTED, NOT_WELL, OK, REFUSED, USAGE
from cli.probe import verb as probe_verb
from common.config.load import dump_cell, load_cell
from common.config.probe import ProbeFile
from forcemesh.yaml_file import read_model
from sim.controller.behaviour import Behaviour
from tests.fakes.probed_controller import TEXT, ProbedController
from tests.fakes.verb_calls import run
from tools.tree import ROOT

BEHAVIOUR = Behaviour(step_s=5e-4, least_segment_s=0.08)


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    """A cell with a controller."""
    path = tmp_path / "cell.yaml"
    path.write_text(dump_cell(load_cell(ROOT / "cells" / "demo-tcp.yaml")))
    return path


def connected(monkeypatch: pytest.MonkeyPatch, text: str = TEXT) -> ProbedController:
    """Return a controller to which the verb connects."""
    controller = ProbedController(BEHAVIOUR, text=text)
    monkeypatch.setattr(probe_verb, "_connect", lambda _: controller.link())
    return controller


def test_all_stages_write_a_file_that_cell_and_emulator_read(
    cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a yes; a previous file is kept, and the program on the controller ends."""
    controller = connected(monkeypatch)
    controller.permit_motion()
    out = tmp_path / "probe.yaml"
    out.write_text("before\n")
    done = run("probe", "--cell", cell_file, "--out", out, "--controller", "F60", text="y\n")
    assert done.exit_code == OK, done.output
    assert "lines of forcemesh.as give what they must" in done.stdout
    assert (tmp_path / "probe.before.yaml").read_text() == "before\n"
    file = read_model(ProbeFile, out)
    assert (file.controller, file.address) == ("F60", "127.0.0.1:49152")
    assert file.stages == ("a", "b", "c")
    assert file.gateway.least_segment_s == pytest.approx(0.08, rel=0.1)
    assert file.gateway.least_speed_m_s == pytest.approx(0.0004, rel=0.1)
    assert controller.advance(3.0, lambda: controller.machine.robot_task.state == "idle")
    cell = yaml.safe_load(cell_file.read_text())
    cell["robot"]["probe"] = "probe.yaml"
    cell_file.write_text(yaml.safe_dump(cell))
    gateway = load_cell(cell_file).gateway
    assert gateway is not None
    assert gateway.least_segment_s == file.gateway.least_segment_s


def test_without_a_yes_nothing_moves_and_the_rest_is_written(
    cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code: refused."""
    controller = connected(monkeypatch)
    controller.permit_motion()
    out = tmp_path / "new" / "probe.yaml"
    done = run("probe", "--cell", cell_file, "--out", out, text="n\n")
    assert done.exit_code == REFUSED
    assert "nothing has moved" in done.output
    assert "emergency stop" in done.output
    assert read_model(ProbeFile, out).stages == ("a", "b")
    assert controller.machine.hardware.motions == 0


def test_an_interruption_closes_the_connection(
    cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So the program permits no further motion; nothing is written."""
    controller = connected(monkeypatch)
    controller.permit_motion()

    def interrupt(text: str) -> None:
        if text.startswith("line"):
            raise KeyboardInterrupt

    monkeypatch.setattr(probe_verb, "print_note", interrupt)
    out = tmp_path / "probe.yaml"
    done = run("probe", "--cell", cell_file, "--out", out, "--yes")
    assert done.exit_code == INTERRUPTED
    controller.advance(1.0)
    assert controller.machine.memory.read("fp.go") == 0
    assert not out.exists()


def test_what_was_measured_before_a_failure_is_written(
    cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the variable on the controller was not set; a line that is no result is shown."""
    connected(monkeypatch, TEXT.replace('$fp.n="mspeed"', '$fp.n="m speed"'))
    out = tmp_path / "probe.yaml"
    done = run("probe", "--cell", cell_file, "--out", out, "--yes")
    assert done.exit_code == NOT_WELL
    assert "must type fp.ok=1" in done.output.splitlines()[-1]
    assert "stage a: not a result: m speed" in done.stderr
    assert read_model(ProbeFile, out).stages == ("a", "b")


def test_a_place_that_cannot_be_written_is_refused_before_anything_is_measured(
    cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arm would move for nothing: a file in place of the folder, a folder without the right."""
    controller, out = connected(monkeypatch), tmp_path / "place" / "probe.yaml"
    before = controller.machine.now_ns
    for spoil in (out.parent.touch, out.parent.unlink):
        spoil()
        done = run("probe", "--cell", cell_file, "--out", out, "--to", "a")
        assert done.exit_code == USAGE
        assert re.search(rf"--out {out}: {tmp_path}\S* cannot be written", done.output)
        monkeypatch.setattr(os, "access", lambda _, mode: mode != os.W_OK)
    assert controller.machine.now_ns == before
