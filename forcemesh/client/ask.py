"""Requests of a client: each returns a reply or raises an exception with a remedy."""

from typing import TypeVar

from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ArmStoppedError, DataError, MessageError, RefusedError
from forcemesh.faults import FAULTS
from forcemesh.messages import ArbiterStatus
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.topics import Request

Q = TypeVar("Q", bound=Record)

ANSWER_S = 2.0
ASK_AGAIN_S = 0.1
TRANSIENT = ("not_ready", "moving", "wait")  # refusals that clear by waiting


def ask(
    bus: Bus,
    request: Request[Q],
    message: Q,
    *,
    within_s: float = 0.0,
    answer_s: float = ANSWER_S,
) -> Reply:
    """Send a request and return the reply; repeat it while the refusal is transient.

    Args:
        bus: A client's access to the bus.
        request: The row of forcemesh/topics.py.
        message: The request.
        within_s: Longest time of repetition [s].
        answer_s: Longest wait for a reply [s].

    Raises:
        DataError: The request is out of its bounds; names argument and value.
        RefusedError: The service refuses: code, text, remedy.
        BusError: No reply within `answer_s`.
    """
    request_in_bounds(message)
    give_up_ns = bus.clock.now_ns() + round(within_s * NS_PER_S)
    while not (reply := bus.ask(request, message, answer_s)).accepted:
        if reply.code not in TRANSIENT or bus.clock.now_ns() >= give_up_ns:
            code, text, remedy = reply.code, reply.text, remedy_of(reply.code)
            raise RefusedError(code, text, remedy=remedy, value=reply.value, limit=reply.limit)
        bus.clock.sleep_s(ASK_AGAIN_S)
    return reply


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
