"""`forcemesh probe`: questions, files and exit codes, on a controller in lock step."""

from pathlib import Path

import pytest
import yaml

from cli.context import INTERRUPTED, OK, REFUSED
from cli.probe import verb as probe_verb
from common.config.load import dump_cell, load_cell, read_probe
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
    file = read_probe(out)
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
    assert read_probe(out).stages == ("a", "b")
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
