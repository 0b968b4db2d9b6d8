"""Every error that forcemesh raises on purpose passes from a worker process to its parent."""

import pickle

import pytest

from forcemesh import errors

MADE = [
    errors.ConfigError("cell.yaml", ["rates: too fast", "tool: no name"]),
    errors.DataError("line 3: no number"),
    errors.LostError("the wrench is silent", ("wrench",)),
    errors.MisroutedError("for another topic", "misrouted"),
    errors.RefusedError("rate", "too fast", remedy="slower", value=2.0, limit=1.0),
    errors.ArmStoppedError("stale", "stopped", "arm again"),
    errors.NotValidError("wrench", "no sample", "check the sensor"),
    errors.RemoteProtocolError("half a packet"),
]


@pytest.mark.parametrize("text", ["the arbiter is IDLE: arm first", "arm first"])
def test_a_remedy_in_the_text_is_not_repeated(text: str) -> None:
    """A sentence that ends with a remedy is enough."""
    assert str(errors.RefusedError("not_armed", text, remedy="arm first")) == text
    assert str(errors.RefusedError("x", text, remedy="wait")) == f"{text} -> wait"


@pytest.mark.parametrize("error", MADE, ids=lambda error: type(error).__name__)
def test_an_error_travels_between_processes_whole(error: errors.ForcemeshError) -> None:
    """The same kind, the same sentence, and its fields for programs."""
    came = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own bytes
    assert type(came) is type(error)
    assert str(came) == str(error)
    assert vars(came) == vars(error)
