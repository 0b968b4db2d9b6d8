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


DIED = "hub (pid 7) was ended by SIGKILL"


@pytest.mark.parametrize(
    ("died", "kind", "text"),
    [((DIED,), ScenarioError, f"{DIED}: {NO_REPLY}"), ((), BusError, NO_REPLY)],
)
def test_a_death_during_a_request_is_reported_as_a_death(
    monkeypatch: pytest.MonkeyPatch, died: tuple[str, ...], kind: type[Exception], text: str
) -> None:
    """The others stay up. Without a death the error, and so the exit code, is that of no reply."""
    supervisor = FakeSupervisor(*died)
    error = play(monkeypatch, supervisor)
    assert (type(error), str(error)) == (kind, text)
    assert supervisor.lingers_s == [7.0]
