"""What can be wrong with the simulated sensor, set by a small request while it runs. Pure."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace

TRUE, FALSE = ("on", "1", "true", "yes"), ("off", "0", "false", "no")
EVENT = "restart"  # not a state: it happens once


@dataclass(frozen=True, slots=True)
class Switches:
    """All off. Shares are of records, 0 to 1."""

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    stall: bool = False  # the sample stays, also its number
    freeze: bool = False  # the reading stays, its number goes on
    saturate: bool = False
    mute: bool = False  # nothing is sent
    garbage: bool = False  # what is sent is no record
    steal: bool = False  # a second client asks again and again
    status: int = 0

    def changed(self, words: Mapping[str, str]) -> "Switches":
        """Return them with some set by their names.

        Raises:
            ValueError: A name or a value is none; says which are.
        """
        names = {field.name: type(getattr(self, field.name)) for field in fields(self)}
        values: dict[str, float | bool | int] = {}
        for name, word in words.items():
            if name not in names:
                raise ValueError(f"no switch {name!r}: there are {', '.join(names)}, {EVENT}")
            values[name] = _value(name, names[name], word.strip().lower())
        return replace(self, **values)  # type: ignore[arg-type]

    def words(self) -> dict[str, float | bool | int]:
        """Return every switch by its name."""
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
