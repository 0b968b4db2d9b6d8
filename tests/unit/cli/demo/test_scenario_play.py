"""End of the demo when its cell fails."""

from contextlib import nullcontext

import pytest

from cli.demo import scenario
from cli.demo.scenario import ScenarioError, ScenarioPlan
from common.config.load import load_cell
from forcemesh.errors import BusError, ForcemeshError
from tests.fakes.bench import DEMO

NO_REPLY = "arbiter did not answer demo/arbiter/arm within 2 s"


class FakeSupervisor:
    """A supervisor whose processes may have died; it records how long the others stay up."""

    def __init__(self, *died: str) -> None:
        """Set the processes that died."""
        self.died = died
        self.lingers_s: list[float] = []

    def __enter__(self) -> "FakeSupervisor":
        """Start nothing."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop nothing."""

    def wait_ready(self) -> None:
        """Be ready."""

    def hold_after_death(self, linger_s: float) -> None:
        """Record the duration."""
        self.lingers_s.append(linger_s)


def play(monkeypatch: pytest.MonkeyPatch, supervisor: FakeSupervisor) -> ForcemeshError:
    """Return the error of a demo whose request gets no reply."""

    def fail(_scenario: object) -> None:
        raise BusError(NO_REPLY)

    monkeypatch.setattr(scenario, "Supervisor", lambda _cell: supervisor)
    monkeypatch.setattr(scenario, "open_bus", lambda *_: nullcontext())
    monkeypatch.setattr(scenario, "Scenario", lambda *_, **__: type("S", (), {"run": fail})())
    with pytest.raises(ForcemeshError) as caught:
        scenario.play_real(load_cell(DEMO), ScenarioPlan(), lambda *_: None, 7.0)
    return caught.value


def test_a_death_during_a_request_is_reported_as_a_death(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The hub was killed during a request: the others stay up, and the error names the hub."""
    supervisor = FakeSupervisor("hub (pid 7) was ended by SIGKILL")
    error = play(monkeypatch, supervisor)
    assert isinstance(error, ScenarioError)
    assert str(error) == f"hub (pid 7) was ended by SIGKILL: {NO_REPLY}"
    assert supervisor.lingers_s == [7.0]


def test_a_request_without_reply_is_reported_as_no_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    """No process died: the exit code is that of no reply, and a hold was requested."""
    supervisor = FakeSupervisor()
    error = play(monkeypatch, supervisor)
    assert isinstance(error, BusError)
    assert str(error) == NO_REPLY
    assert supervisor.lingers_s == [7.0]
