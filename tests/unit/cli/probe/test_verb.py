"""`forcemesh probe`: questions, files and exit codes, on a controller in lock step."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from cli.context import INTERRUPTED, OK, REFUSED
from cli.probe import link as probe_link
from cli.probe import verb as probe_verb
from cli.probe.link import ProbeError, ProbeLink, SocketWire
from common.config.load import dump_cell, load_cell, read_probe
from sim.controller.behaviour import Behaviour
from tests.chaos.common_net import free_port
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


Serve = Callable[[socket.socket], None]


@contextmanager
def served(*conversations: Serve) -> Iterator[int]:
    """Serve connections one after the other; give the port."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def run() -> None:
            for serve in conversations:
                connection, _ = server.accept()
                with connection:
                    serve(connection)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        thread.join(10.0)


def echo(connection: socket.socket) -> None:
    """Reply to one command."""
    connection.recv(100)
    connection.sendall(b"receives  1\ndone echo\n")


def opened(port: int) -> ProbeLink:
    """Connect as the verb does."""
    return ProbeLink(lambda: SocketWire("127.0.0.1", port), "here", lambda _: None, time.monotonic)


@pytest.fixture
def controller() -> ProbedController:
    """A controller whose stage a has ended."""
    return ProbedController(Behaviour(step_s=5e-4))


# --- sockets --------------------------------------------------------------------------------------


def test_a_command_is_answered_over_a_socket() -> None:
    """Nothing received in time is no bytes; the end is an error."""

    def more(connection: socket.socket) -> None:
        echo(connection)
        connection.recv(100)
        connection.sendall(b"don")
        connection.sendall(b"e list\n")

    with served(more) as port:
        link = opened(port)
        assert link.wire.receive(0.0) == b""
        assert not link.command("list").numbers
        began_s = link.wire.now_s()
        link.wire.wait(0.01)
        assert link.wire.now_s() - began_s >= 0.01
        with pytest.raises(ConnectionError, match="closed by the controller"):
            link.wire.receive(10.0)
        link.close()


def test_a_port_without_a_listener_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the remedy."""
    monkeypatch.setattr(probe_link, "LINK_WITHIN_S", 0.6)
    with pytest.raises(ProbeError, match=r"here: no connection: .*refused; is fmprobe\.as loaded"):
        opened(free_port())


# --- replies --------------------------------------------------------------------------------------
