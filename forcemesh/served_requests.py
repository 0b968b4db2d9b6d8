"""Publisher of the requests that a role has served, each with its reply: an audit on the bus.

The recorder records them as any other topic; `forcemesh replay --to-service` plays them again.
A message is published only when a request was served, and the reply is sent first. Its size and
rate are bounded, so that neither a long request nor a flood of them burdens a control loop: what is
left out is counted in the next message.
"""

import os
import socket
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec

from forcemesh.clock import NS_PER_S, Clock
from forcemesh.codec import Envelope, pack
from forcemesh.errors import DataError
from forcemesh.faults import clipped
from forcemesh.recorded_messages import upgraded_request
from forcemesh.records import Record
from forcemesh.requests import Reply, ServedRequest

MOST_PER_S = 100  # published by one role, as many as the hub accepts of one client
# Shares of the 4096 bytes of a message [B]; the header and the numbers of a reply take the rest.
MOST_PAYLOAD_B = 2400
MOST_TEXT_B = 600  # of the text of a reply, which repeats that of a hold
MOST_NAME_B = 120  # of each of the other texts


class ServedRequests:
    """Publisher of the requests of one role, and their number."""

    def __init__(self, put: Callable[[ServedRequest], object], clock: Clock) -> None:
        """Publish with a function, by the time of a clock."""
        self.count = 0  # since the start, those not published too
        self._put, self._clock = put, clock
        self._second_ns, self._published, self._skipped = 0, 0, 0

    def taken(
        self,
        key: str,
        data: bytes,
        request: Record | None,
        *,
        fault: str,
        envelope: Envelope,
        age_s: float | None,
    ) -> Callable[[Reply], None]:
        """Return the function that publishes a request, taken now, with its reply.

        Args:
            key: Key of the request, without the cell.
            data: Its bytes.
            request: Its fields, None if they cannot be decoded.
            fault: Why they cannot be decoded.
            envelope: Its first fields.
            age_s: Its age [s], None if it is unknown.
        """
        payload = data.hex() if request is None else request.as_json()
        size = len(payload.encode())
        served = ServedRequest(
            request=key,
            sender=clipped(envelope.sender, MOST_NAME_B),
            client=clipped(envelope.client, MOST_NAME_B),
            payload=payload if size <= MOST_PAYLOAD_B else "",
            payload_bytes=size,
            fault=clipped(fault, MOST_NAME_B),
            received_ns=self._clock.now_ns(),
            age_s=age_s,
            wait_s=envelope.wait_s,
        )
        return partial(self._publish, served)

    def _publish(self, served: ServedRequest, reply: Reply) -> None:
        self.count += 1
        now_ns = self._clock.now_ns()
        if now_ns - self._second_ns >= NS_PER_S:
            self._second_ns, self._published = now_ns, 0
        if self._published >= MOST_PER_S:
            self._skipped += 1
            return
        self._published += 1
        short = reply.replaced(text=clipped(reply.text, MOST_TEXT_B))
        self._put(served.replaced(reply=short, skipped=self._skipped))
        self._skipped = 0


def request_data(served: ServedRequest, address: str, clock: Clock) -> bytes:
    """Return the bytes of a request as its client may have sent them, as old as it was.

    Args:
        served: The request.
        address: Its address.
        clock: Of the server that now receives it.

    Raises:
        DataError: They are not in the message: too long for it, or altered.
    """
    if served.payload_bytes and not served.payload:
        size = served.payload_bytes
        raise DataError(f"{served.request} of {size} bytes is longer than a recording holds")
    try:
        if served.fault:
            return bytes.fromhex(served.payload)
        fields = msgspec.json.decode(served.payload, type=dict[str, Any])
    except ValueError as error:  # msgspec's too
        raise DataError(f"{served.request}: its payload cannot be read: {error}") from error
    envelope = Envelope(
        topic=address, sender=served.sender, client=served.client, wait_s=served.wait_s
    )
    if served.age_s is not None:
        stamp_ns = clock.now_ns() - round(served.age_s * NS_PER_S)
        envelope = envelope.replaced(boot=clock.boot, stamp_ns=stamp_ns)
    return pack(upgraded_request(served.request, fields) | envelope.as_dict())


@cache
def name_of_this_process() -> str:
    """Return program, process and host of this process, as a request names its sender."""
    program = Path(sys.argv[0] or "python").name
    return clipped(f"{program} {os.getpid()} at {socket.gethostname()}", MOST_NAME_B)
