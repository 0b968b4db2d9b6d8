"""Section `signals`: what is refused at loading, groups of 16, who may set what."""

from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.config.signals import GROUP, INPUTS, OUTPUTS, SignalSection, groups, judge, resolve
from forcemesh.errors import ConfigError
from forcemesh.faults import tripped
from forcemesh.messages import MAX_SIGNALS, Asker
from tests.fakes.bench import DEMO
from tests.fakes.signals import NAMED

HOLD = tripped("hold", "a test")
ASKERS: tuple[Asker, ...] = get_args(Asker)


def cell_of(signals: Any, file: str = "demo.yaml", **changes: Any) -> CellConfig:
    """Return a cell with these signals."""
    values = {name.replace("__", "."): value for name, value in changes.items()}
    return load_cell(DEMO.with_name(file), {"signals": signals, **values})


@pytest.mark.parametrize(
    ("signals", "text"),
    [
        ({"a": {}}, "give either output: NUMBER or input: NUMBER"),
        ({"a": {"output": 1, "input": 1001}}, "give either output"),
        ({"a": {"output": 0}}, "outputs of the controller are 1 to 960"),
        ({"a": {"output": 961}}, "output 961: outputs of the controller are 1 to 960"),
        ({"a": {"input": 1}}, "inputs of the controller are 1001 to 1960 (its first is 1001)"),
        ({"a": {"input": 1961}}, "input 1961"),
        ({"a": {"input": 1001, "set_by": ["program"]}}, "set_by and while_held are for outputs"),
        ({"a": {"input": 1001, "while_held": True}}, "set_by and while_held are for outputs"),
        ({"a": {"output": 1, "while_held": True}}, "while_held needs set_by"),
        ({"a": {"output": 1, "set_by": ["regulator"]}}, "operator"),
        ({"A b": {"output": 1}}, "lower-case letters"),
        (
            {"lamp": {"output": 1, "setby": []}},
            "signals.lamp.setby: unknown name; did you mean",
        ),
        (
            {"output": {"output": 1, "setby": []}},
            "signals.output.setby: unknown name; did you",
        ),
        ({"a": {"output": 1}, "b": {"output": 1}}, "a and b are both output 1"),
        ({f"a{k}": {"output": 16 * k + 1} for k in range(7)}, "in 7 groups of 16"),
        ({f"a{k}": {"output": k + 1} for k in range(MAX_SIGNALS + 1)}, "24"),
    ],
)
def test_a_mistake_is_refused_with_its_place(signals: Any, text: str) -> None:
    """At loading; six groups are not too many."""
    cell_of({f"a{k}": {"output": 16 * k + 1} for k in range(6)})
    with pytest.raises(ConfigError) as refused:
        cell_of(signals)
    assert text in str(refused.value)
    assert "signals" in str(refused.value)


@pytest.mark.parametrize("number", [9, 1001])
def test_a_dedicated_signal_cannot_be_named(number: int) -> None:
    """The controller uses it by itself; the message names the signal and the list."""
    with pytest.raises(ConfigError, match=r"is in gateway\.dedicated_signals"):
        cell_of(NAMED, "demo-tcp.yaml", gateway__dedicated_signals=[500, number])
    with pytest.raises(ConfigError, match="961 is not a signal"):
        cell_of({}, "demo-tcp.yaml", gateway__dedicated_signals=[961])


def test_protocol_plain_has_no_signals() -> None:
    """It is refused by name, and without signals it loads."""
    with pytest.raises(ConfigError, match=r"signals: gateway\.protocol is plain"):
        cell_of(NAMED, "demo-plain.yaml")
    assert cell_of({}, "demo-plain.yaml").signals == {}


@pytest.mark.parametrize("follows", [{"part": "none"}, {"lamp": "lamp"}, {"part": "part"}])
def test_only_an_input_follows_an_output(follows: dict[str, str]) -> None:
    """Of the section signals, in the simulation."""
    with pytest.raises(ConfigError, match=r"sim\.inputs_follow"):
        cell_of(NAMED, sim__inputs_follow=follows)


numbers = st.sampled_from([*OUTPUTS, *INPUTS])


@given(st.sets(numbers, min_size=1, max_size=MAX_SIGNALS))
def test_every_signal_is_in_one_group(chosen: set[int]) -> None:
    """A group begins at 1 of every 16, ends within outputs or inputs, and none is empty."""
    named = {f"s{n}": section(n) for n in chosen}
    found = groups(named)
    for number in chosen:
        assert sum(first <= number < first + GROUP for first in found) == 1
    for first in found:
        kind = OUTPUTS if first in OUTPUTS else INPUTS
        assert first + GROUP - 1 in kind
        assert any(first <= number < first + GROUP for number in chosen)


def section(number: int) -> SignalSection:
    """Return the section of a signal that is only reported."""
    kind = "output" if number in OUTPUTS else "input"
    return SignalSection.model_validate({kind: number})


@pytest.mark.parametrize("hold", [None, HOLD])
@pytest.mark.parametrize("commander", ASKERS)
@pytest.mark.parametrize("asked", [*NAMED, "unknown", "10", "12"])
def test_only_what_the_cell_file_permits_is_set(asked: str, commander: Asker, hold: Any) -> None:
    """Every signal, every commander, holding or not: an output, in set_by, while held if so."""
    signals = cell_of(NAMED).signals
    trip = judge(signals, asked, commander, hold=hold)
    name = resolve(signals, asked)
    signal = None if name is None else signals[name]
    permitted = signal is not None and commander in signal.set_by
    if permitted and signal is not None and (hold is None or signal.while_held):
        assert trip is None
    else:
        assert trip is not None
        expected = "signal_held" if permitted else "signal_not_permitted"
        assert trip.code == ("signal_unknown" if signal is None else expected)
