"""Link to the probe program: sockets, replies, and one clear error for each failure."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from cli.probe import link as probe_link
from cli.probe.link import ProbeError, ProbeLink, SocketWire
from sim.controller.behaviour import Behaviour
from tests.chaos.common_net import free_port
from tests.fakes.probed_controller import ProbedController

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


def test_a_program_that_does_not_reply_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when forcemesh.as has the port, or a stage has not ended."""
    monkeypatch.setattr(probe_link, "LINK_WITHIN_S", 0.2)
    monkeypatch.setattr(probe_link, "ATTEMPT_S", 0.2)

    def be_silent(connection: socket.socket) -> None:
        while connection.recv(100):
            pass

    with (
        served(be_silent) as port,
        pytest.raises(ProbeError, match="`echo`: nothing and no `done echo`"),
    ):
        opened(port)
