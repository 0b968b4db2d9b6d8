"""Every exception that forcemesh raises on purpose.

ForcemeshError
├── ConfigError            a cell file is wrong; lists every mistake at once
├── DataError              what was given is wrong: a file, with line and column, or a number
├── BusError               the hub cannot be reached, or a topic is used against the table
│   ├── SetupError             it cannot be used as this PC is set up: a certificate, an address
│   └── LostError              a service or the whole cell is not heard; says which
├── MessageError           bytes from the bus are not the message that the table promises
│   └── MisroutedError         they were written for another topic or request
├── RefusedError           a request was refused; carries code, remedy, number and limit
├── ArmStoppedError        the arm was stopped while somebody waited; carries code and remedy
├── NotReachedError        what was waited for did not come about in time
├── NotValidError          a service says that it cannot answer; carries code and remedy
├── SimulationError        the physics diverged or was asked the impossible
└── ProtocolError          the dialogue with the controller is broken
    ├── LocalProtocolError     we were about to break it; nothing has been sent
    └── RemoteProtocolError    the controller broke it; the link must be closed

In the control loop bad data is not an exception: it is a message with valid=False and a reason.
"""

import re
from math import pi
from typing import TYPE_CHECKING, Any, NamedTuple

from forcemesh.validation_texts import what_is_wrong

if TYPE_CHECKING:
    from pydantic import ValidationError


# Units that sentences for people use; the numbers beside a sentence are in SI.
PER_SI = {
    "degrees/s": 180.0 / pi,
    "degrees": 180.0 / pi,
    "mm/s": 1e3,
    "mm": 1e3,
    "ms": 1e3,
    "%": 1e2,
}
PER_SI |= dict.fromkeys(("m/s", "m", "s", "N m", "N", "kg", "Hz", "rad"), 1.0)
IN_A_UNIT = re.compile(rf"(-?\d+(?:\.\d+)?) ({'|'.join(PER_SI)})(?![\w/])")
SAME = 0.6  # a sentence rounds


class ForcemeshError(Exception):
    """Base of all of them; its text is one clear sentence for the user."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel from a worker process to whoever waits for it, whatever the constructor takes."""
        return _again, (type(self), self.args, self.__dict__)


def _again(kind: type[ForcemeshError], args: tuple[Any, ...], held: Any) -> ForcemeshError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(held)
    return error


class ConfigError(ForcemeshError):
    """A cell file is wrong. `mistakes` holds one line for each."""

    def __init__(self, source: str, mistakes: list[str]) -> None:
        """Name the file and list every mistake in it."""
        self.source = source
        self.mistakes = mistakes
        if len(mistakes) == 1:
            super().__init__(f"{source}: {mistakes[0]}")
            return
        lines = "\n".join(f"  - {mistake}" for mistake in mistakes)
        super().__init__(f"{source}: {len(mistakes)} mistakes\n{lines}")


class DataError(ForcemeshError):
    """What was given cannot be used: a recording, a calibration file, a number."""


class BusError(ForcemeshError):
    """The bus cannot be used, or is used against the table of topics."""


class SetupError(BusError):
    """The bus cannot be used as this PC is set up: a certificate is missing, or all may listen."""


class LostError(BusError):
    """A service that is needed, or the whole cell, is not heard any more. `roles` says which."""

    def __init__(self, text: str, roles: tuple[str, ...] = (), *, is_all: bool = False) -> None:
        """Keep the silent roles, and whether they are all, for programs, the text for people."""
        self.roles, self.is_all = roles, is_all
        super().__init__(text)


class MessageError(ForcemeshError):
    """Bytes from the bus do not decode into the message of their topic.

    `code` is the row of forcemesh/faults.py that says why: undecodable or not_finite.
    """

    def __init__(self, text: str, code: str = "undecodable") -> None:
        """Keep the code for programs, the text for people."""
        self.code = code
        super().__init__(text)


class MisroutedError(MessageError):
    """Bytes from the bus were written for another topic or request than they came to."""


def _with_remedy(text: str, remedy: str) -> str:
    """Return a sentence and what to do, where it does not end with that already."""
    return text if text.endswith(remedy) else f"{text} -> {remedy}"


def _numbers(text: str, value: float | None, limit: float | None) -> str:
    """Return the numbers that belong to a sentence, in the unit that the sentence itself uses."""
    for said, unit in IN_A_UNIT.findall(text):
        scale = PER_SI[unit]
        if value is not None and abs(float(said) - scale * value) <= SAME * max(1.0, abs(value)):
            shown = "" if limit is None else f"{scale * limit:.6g}"
            is_said = not shown or re.search(rf"\b{re.escape(shown)}\b", text) is not None
            return "" if is_said else f" [limit {shown} {unit}]"
    rows = (("value", value), ("limit", limit))
    numbers = [f"{name} {number:.6g}" for name, number in rows if number is not None]
    return f" [{', '.join(numbers)}]" if numbers else ""


class RefusedError(ForcemeshError):
    """A request was refused by the service that serves it."""

    def __init__(
        self,
        code: str,
        text: str,
        *,
        remedy: str = "",
        value: float | None = None,
        limit: float | None = None,
    ) -> None:
        """Keep the code for programs, text and remedy for people, the number that was too much."""
        self.code, self.text, self.remedy = code, text, remedy
        self.value, self.limit = value, limit
        found = f"{text}{_numbers(text, value, limit)}"
        super().__init__(_with_remedy(found, remedy))


class ArmStoppedError(ForcemeshError):
    """The arm was stopped while somebody waited for what it was doing."""

    def __init__(self, code: str, text: str, remedy: str = "") -> None:
        """Keep the code for programs, text and remedy for people."""
        self.code, self.remedy = code, remedy
        super().__init__(_with_remedy(text, remedy))


class NotReachedError(ForcemeshError):
    """What was waited for did not come about in time, or ended before."""


class NotValidError(ForcemeshError):
    """A service is heard, and says that it cannot answer."""

    def __init__(self, code: str, text: str, remedy: str = "") -> None:
        """Keep the code for programs, text and remedy for people."""
        self.code, self.remedy = code, remedy
        super().__init__(_with_remedy(text, remedy))


class SimulationError(ForcemeshError):
    """The simulated robot cannot go on."""


class ProtocolError(ForcemeshError):
    """The dialogue with the controller is broken."""


class LocalProtocolError(ProtocolError):
    """We were about to send something that the protocol cannot carry. Nothing was sent."""


class RemoteProtocolError(ProtocolError):
    """The controller sent something that the protocol does not allow. Close the link."""


class Mistake(NamedTuple):
    """One field of a model that is wrong."""

    where: str  # the field, dotted; "" for the whole
    what: str  # and what was found
    kind: str  # pydantic's name for it
    found: object

    @property
    def text(self) -> str:
        """One clause for whoever gave it."""
        return f"{self.where}: {self.what}" if self.where else self.what


def first_mistake(error: "ValidationError") -> Mistake:
    """Return the first mistake that pydantic found."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return Mistake(where, what_is_wrong(first), first["type"], first["input"])
