"""Section `signals` of a cell file: digital inputs and outputs, and who sets them.

Numbers are those of the controller: outputs 1 to 960, inputs 1001 to 1960. An output that is not
named here cannot be set. A signal that the controller uses by itself (a dedicated signal, DEFSIG)
is listed in `gateway.dedicated_signals` and cannot be named.
"""

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from forcemesh.connection import ConfigSection
from forcemesh.faults import tripped
from forcemesh.messages import MAX_SIGNALS, Asker, Trip
from forcemesh.patterns import SIGNAL_NAME

OUTPUTS, INPUTS = range(1, 961), range(1001, 1961)
GROUP = 16  # signals that one number of the packet reports
GROUPS = 6  # of one report


class SignalSection(ConfigSection):
    """One digital signal: an input, or an output with the commanders that may set it."""

    output: int | None = None
    input: int | None = None
    set_by: tuple[Asker, ...] = ()  # empty: the output is only reported
    while_held: bool = False  # may be set while the robot holds, also before the first arming

    @property
    def number(self) -> int:
        """Number of the signal in the controller."""
        return self.output or self.input or 0

    @property
    def label(self) -> str:
        """Kind and number, for people."""
        return f"input {self.input}" if self.output is None else f"output {self.output}"

    @model_validator(mode="after")
    def _is_one_signal(self) -> "SignalSection":
        if (self.output is None) == (self.input is None):
            raise ValueError("give either output: NUMBER or input: NUMBER")
        if self.output is not None and self.output not in OUTPUTS:
            raise ValueError(f"output {self.output}: outputs of the controller are 1 to 960")
        if self.input is not None and self.input not in INPUTS:
            raise ValueError(
                f"input {self.input}: inputs of the controller are 1001 to 1960 (its first is 1001)"
            )
        if self.input is not None and (self.set_by or self.while_held):
            raise ValueError(f"input {self.input}: set_by and while_held are for outputs")
        if self.while_held and not self.set_by:
            raise ValueError(f"output {self.output}: while_held needs set_by")
        return self


SignalName = Annotated[str, Field(pattern=SIGNAL_NAME)]
Signals = Annotated[dict[SignalName, SignalSection], Field(max_length=MAX_SIGNALS)]


def _existing(number: int) -> int:
    if number not in OUTPUTS and number not in INPUTS:
        raise ValueError(f"{number} is not a signal: outputs are 1 to 960, inputs 1001 to 1960")
    return number


Dedicated = Annotated[
    tuple[Annotated[int, AfterValidator(_existing)], ...], Field(max_length=200)
]  # signals that the controller uses by itself


def signals_mistake(
    signals: Mapping[str, SignalSection],
    dedicated: tuple[int, ...],
    follows: Mapping[str, str],
) -> str:
    """Return why these signals cannot be used together, or in this cell; empty: they can.

    Args:
        signals: Section of the cell file.
        dedicated: Signals that the controller uses by itself.
        follows: Simulated inputs, and the output that each of them follows.
    """
    names: dict[int, str] = {}
    for name, signal in signals.items():
        if signal.number in names:
            return f"signals: {names[signal.number]} and {name} are both {signal.label}"
        names[signal.number] = name
        if signal.number in dedicated:
            return (
                f"signals.{name}: {signal.label} is in gateway.dedicated_signals: the controller "
                "uses it by itself, choose another"
            )
    if len(found := groups(signals)) > GROUPS:
        starts = ", ".join(map(str, found))
        return (
            f"signals: they are in {len(found)} groups of {GROUP} (that begin at {starts}), the "
            f"packet reports {GROUPS}: use signals with numbers closer together"
        )
    return _follow_mistake(signals, follows)


def _follow_mistake(signals: Mapping[str, SignalSection], follows: Mapping[str, str]) -> str:
    for name, output in follows.items():
        for each, kind in ((name, "input"), (output, "output")):
            if each not in signals or getattr(signals[each], kind) is None:
                return f"sim.inputs_follow: {each} is not an {kind} of the section signals"
    return ""


def groups(signals: Mapping[str, SignalSection]) -> tuple[int, ...]:
    """Return the first signal of each group of 16 that holds a named one: 1, 17, .. 1001, .."""
    numbers = [signal.number - 1 for signal in signals.values()]
    return tuple(sorted({n // 1000 * 1000 + n % 1000 // GROUP * GROUP + 1 for n in numbers}))


def resolve(signals: Mapping[str, SignalSection], asked: str) -> str | None:
    """Return the name of the signal that a client means, by name or by number; None: none."""
    if asked in signals:
        return asked
    return next((name for name, each in signals.items() if str(each.number) == asked), None)


def judge(
    signals: Mapping[str, SignalSection], asked: str, commander: Asker, *, hold: Trip | None
) -> Trip | None:
    """Return why a commander may not set a signal now, None when it may.

    Args:
        signals: Section of the cell file.
        asked: Name or number of the signal.
        commander: Who asks.
        hold: Why the robot holds, None while it may move.
    """
    name = resolve(signals, asked)
    settable = [each for each, signal in signals.items() if signal.set_by]
    which = f"outputs that can be set: {', '.join(settable) or 'none'}"
    if name is None:
        return tripped("signal_unknown", f"{asked!r} is not in the section signals; {which}")
    signal = signals[name]
    if not signal.set_by:
        return tripped("signal_not_permitted", f"{name} ({signal.label}) cannot be set; {which}")
    if commander not in signal.set_by:
        who = " and ".join(signal.set_by)
        text = f"{name} ({signal.label}) may be set by {who}, not by {commander}"
        return tripped("signal_not_permitted", text)
    if hold is not None and not signal.while_held:
        text = f"{name} ({signal.label}) is not set while the robot holds: {hold.text}"
        return tripped("signal_held", text)
    return None
