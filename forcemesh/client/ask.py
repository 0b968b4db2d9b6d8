"""Requests of a client: each returns a reply or raises an exception with a remedy."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from pydantic import ValidationError

from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ArmStoppedError, DataError, RefusedError, first_mistake
from forcemesh.faults import FAULTS
from forcemesh.messages import ArbiterStatus, Record
from forcemesh.requests import Reply
from forcemesh.topics import Request

Q = TypeVar("Q", bound=Record)

ANSWER_S = 2.0
ASK_AGAIN_S = 0.1
TRANSIENT = ("not_ready", "moving", "wait")  # refusals that clear by waiting


@contextmanager
def raise_data_errors() -> Iterator[None]:
    """Raise DataError, which names argument and value, for arguments outside a request's bounds."""
    try:
        yield
    except ValidationError as error:
        raise DataError(first_mistake(error).text) from None


def ask(bus: Bus, request: Request[Q], message: Q, timeout_s: float = ANSWER_S) -> Reply:
    """Send a request once and return the reply.

    Raises:
        RefusedError: The service refuses: code, text, remedy.
        BusError: No reply within `timeout_s`.
    """
    reply = bus.ask(request, message, timeout_s)
    if reply.accepted:
        return reply
    remedy = remedy_of(reply.code)
    raise RefusedError(reply.code, reply.text, remedy=remedy, value=reply.value, limit=reply.limit)


def ask_until(bus: Bus, request: Request[Q], message: Q, within_s: float) -> Reply:
    """Send a request as `ask`; repeat it for at most `within_s` while the refusal is transient."""
    give_up_ns = bus.clock.now_ns() + round(within_s * NS_PER_S)
    while True:
        try:
            return ask(bus, request, message)
        except RefusedError as error:
            if error.code not in TRANSIENT or bus.clock.now_ns() >= give_up_ns:
                raise
        bus.clock.sleep_s(ASK_AGAIN_S)


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
