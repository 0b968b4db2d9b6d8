"""Fault-injection switches of the simulated sensor, set at run time by HTTP. Pure."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace

TRUE, FALSE = ("on", "1", "true", "yes"), ("off", "0", "false", "no")
EVENT = "restart"  # an event, not a state


@dataclass(frozen=True, slots=True)
class FaultSwitches:
    """Fault switches, all off by default. Shares are of records, 0 to 1."""

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    stall: bool = False  # sample and sequence number stay constant
    freeze: bool = False  # the reading stays constant, the sequence number increases
    saturate: bool = False
    mute: bool = False  # nothing is sent
    garbage: bool = False  # malformed records are sent
    steal: bool = False  # a second client requests the stream repeatedly
    status: int = 0

    def changed(self, words: Mapping[str, str]) -> "FaultSwitches":
        """Return a copy with some switches set by name.

        Raises:
            ValueError: A name or a value is invalid; the text lists the valid ones.
        """
        names = {field.name: type(getattr(self, field.name)) for field in fields(self)}
        values: dict[str, float | bool | int] = {}
        for name, word in words.items():
            if name not in names:
                raise ValueError(f"no switch {name!r}: use one of {', '.join(names)}, {EVENT}")
            values[name] = _value(name, names[name], word.strip().lower())
        return replace(self, **values)  # type: ignore[arg-type]

    def words(self) -> dict[str, float | bool | int]:
        """Return every switch by name."""
        return asdict(self)


def _value(name: str, kind: type, word: str) -> float | bool | int:
    if kind is bool:
        if word not in (*TRUE, *FALSE):
            raise ValueError(f"{name}={word}: on or off")
        return word in TRUE
    try:
        if kind is int:
            number = int(word, 0)
            if 0 <= number < 2**32:
                return number
        elif 0.0 <= float(word) <= 1.0:
            return float(word)
    except ValueError:
        pass
    raise ValueError(f"{name}={word}: {'32 bits' if kind is int else 'a share, 0 to 1'}")
