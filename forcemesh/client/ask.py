"""Bounds of a client's requests, and the remedies of refusals and stops."""

from typing import TypeVar

from forcemesh.errors import ArmStoppedError, DataError, MessageError
from forcemesh.faults import FAULTS
from forcemesh.messages import ArbiterStatus
from forcemesh.records import Record

Q = TypeVar("Q", bound=Record)


def request_in_bounds(message: Q) -> Q:
    """Return a request with its values checked. Raise DataError, which names argument and value."""
    try:
        return message.from_dict(message.as_dict())
    except MessageError as error:
        text = str(error)
        raise DataError(text.partition(".")[2] or text) from None


def stopped_error(status: ArbiterStatus, what: str) -> ArmStoppedError:
    """Return the exception of a stopped arm: what ended, and why."""
    why = "; ".join(trip.text for trip in status.trips) or "no reason given"
    code = status.trips[-1].code if status.trips else "hold"
    text = f"{what}: the arbiter is {status.state}: {why}"
    return ArmStoppedError(code, text, remedy_of(code))


def remedy_of(code: str) -> str:
    """Return the remedy of a code, empty when the code is not in the fault table."""
    row = FAULTS.get(code)
    return "" if row is None else row.remedy
