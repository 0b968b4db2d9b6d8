"""Exception tree of forcemesh.

ForcemeshError
├── ConfigError            a cell file is wrong; lists every mistake at once
├── DataError              input is wrong: a file, with line and column, or a number
├── BusError               the hub cannot be reached, or a topic is used against the topic table
│   ├── SetupError             the set-up of this PC is wrong: a certificate, an address
│   └── LostError              no messages from a service or the whole cell; names them
├── MessageError           bytes from the bus are not a message of the topic's type
│   └── MisroutedError         they are addressed to another topic or request
├── RefusedError           a request was refused; carries code, remedy, number and limit
├── ArmStoppedError        the arm was stopped during a wait; carries code and remedy
├── NotReachedError        the awaited condition was not reached in time
├── NotValidError          a service publishes `valid=False`; carries code and remedy
├── SimulationError        the physics diverged or cannot execute a command
└── ProtocolError          the controller protocol is violated
    ├── LocalProtocolError     by this side; nothing has been sent
    └── RemoteProtocolError    by the controller; the link must be closed

In the control loop bad data is not an exception: it is a message with valid=False and a reason.
"""

import re
from collections.abc import Mapping
from math import pi
from typing import TYPE_CHECKING, Any, NamedTuple

from forcemesh.validation_texts import what_is_wrong

if TYPE_CHECKING:
    from pydantic import ValidationError


# Units used in error texts; `value` and `limit` are in SI.
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
SAME_NUMBER = 0.6  # tolerance: the text is rounded


class ForcemeshError(Exception):
    """Base of all forcemesh exceptions; its text is one sentence for the user."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Support pickling from a worker process, whatever the constructor takes."""
        return _again, (type(self), self.args, self.__dict__)


def _again(kind: type[ForcemeshError], args: tuple[Any, ...], held: Any) -> ForcemeshError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(held)
    return error


class ConfigError(ForcemeshError):
    """A cell file is wrong. `mistakes` holds one line for each mistake."""

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
    """Input cannot be used: a recording, a calibration file, a number."""


class BusError(ForcemeshError):
    """The bus cannot be used, or is used against the topic table."""


class NoHubError(BusError):
    """No hub answers: the cell is not up."""


class SetupError(BusError):
    """The set-up of this PC is wrong: a certificate is missing, or the bus is open to others."""


class LostError(BusError):
    """No messages from a required service or from the whole cell. `roles` names them."""

    def __init__(self, text: str, roles: tuple[str, ...] = (), *, is_all: bool = False) -> None:
        """Keep the silent roles, and whether all are silent, for programs, the text for people."""
        self.roles, self.is_all = roles, is_all
        super().__init__(text)


class MessageError(ForcemeshError):
    """Bytes from the bus do not decode into the message of their topic.

    `code` is the row of forcemesh/faults.py: undecodable or not_finite.
    """

    def __init__(self, text: str, code: str = "undecodable") -> None:
        """Keep the code for programs, the text for people."""
        self.code = code
        super().__init__(text)


class MisroutedError(MessageError):
    """Bytes from the bus carry the address of another topic or request."""


def _with_remedy(text: str, remedy: str) -> str:
    """Return a text with its remedy appended, unless the text already ends with it."""
    return text if text.endswith(remedy) else f"{text} -> {remedy}"


def _numbers(text: str, value: float | None, limit: float | None) -> str:
    """Return the numbers that complete a text, in the unit that the text uses."""
    for value_text, unit in IN_A_UNIT.findall(text):
        scale = PER_SI[unit]
        if value is not None and abs(float(value_text) - scale * value) <= SAME_NUMBER * max(
            1.0, abs(value)
        ):
            shown = "" if limit is None else f"{scale * limit:.6g}"
            is_shown = not shown or re.search(rf"\b{re.escape(shown)}\b", text) is not None
            return "" if is_shown else f" [limit {shown} {unit}]"
    rows = (("value", value), ("limit", limit))
    numbers = [f"{name} {number:.6g}" for name, number in rows if number is not None]
    return f" [{', '.join(numbers)}]" if numbers else ""


class RefusedError(ForcemeshError):
    """The service refused a request."""

    def __init__(
        self,
        code: str,
        text: str,
        *,
        remedy: str = "",
        value: float | None = None,
        limit: float | None = None,
    ) -> None:
        """Keep the code for programs, text and remedy for people, and the offending value."""
        self.code, self.text, self.remedy = code, text, remedy
        self.value, self.limit = value, limit
        found = f"{text}{_numbers(text, value, limit)}"
        super().__init__(_with_remedy(found, remedy))


class _CodedError(ForcemeshError):
    def __init__(self, code: str, text: str, remedy: str = "") -> None:
        """Keep the code for programs, text and remedy for people."""
        self.code, self.remedy = code, remedy
        super().__init__(_with_remedy(text, remedy))


class ArmStoppedError(_CodedError):
    """The arm was stopped while a client waited for its motion."""


class NotReachedError(ForcemeshError):
    """The awaited condition was not reached in time, or the motion ended before."""


class NotValidError(_CodedError):
    """A service is alive, but publishes `valid=False`."""


class SimulationError(ForcemeshError):
    """The simulation cannot continue."""


class ProtocolError(ForcemeshError):
    """The controller protocol is violated."""


class LocalProtocolError(ProtocolError):
    """This side tried to send something that the protocol cannot carry. Nothing was sent."""


class RemoteProtocolError(ProtocolError):
    """The controller violated the protocol. Close the link."""


class FieldError(NamedTuple):
    """One invalid field of a model."""

    where: str  # the field, dotted; "" for the whole
    what: str  # the finding
    kind: str  # pydantic's name for it
    found: object

    @property
    def text(self) -> str:
        """The mistake as one clause."""
        return f"{self.where}: {self.what}" if self.where else self.what


def first_mistake(error: "ValidationError") -> FieldError:
    """Return the first mistake that pydantic found."""
    return mistake_of(error.errors(include_url=False)[0])


def mistake_of(item: Mapping[str, Any]) -> FieldError:
    """Return the mistake of one error of pydantic's list."""
    where = ".".join(str(part) for part in item["loc"])
    return FieldError(where, what_is_wrong(item), item["type"], item["input"])
