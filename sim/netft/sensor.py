"""Simulated Net F/T without sockets: requests in, records out. Deterministic by seed."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from forcemesh.errors import first_mistake
from sim.netft.protocol import BIAS, START, STOP, About, command_of, record

Address = Any  # of a client, in the type of the transport
STEAL_AFTER = 300  # records sent to a client before the second one takes the stream again
EVENT = "restart"  # an event, not a state
Share = Annotated[float, Field(ge=0.0, le=1.0)]  # of the records
Word = Annotated[int, BeforeValidator(lambda word: int(str(word), 0)), Field(ge=0, lt=2**32)]
NOT_A_RECORD = b"HTTP/1.0 400 Bad Request\r\n\r\n"


class FaultSwitches(BaseModel):
    """Fault switches, all off by default; set at run time by HTTP."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    loss: Share = 0.0
    duplicate: Share = 0.0
    reorder: Share = 0.0
    stall: bool = False  # sample and sequence number stay constant
    freeze: bool = False  # the reading stays constant, the sequence number increases
    saturate: bool = False
    mute: bool = False  # nothing is sent
    garbage: bool = False  # malformed records are sent
    steal: bool = False  # a second client requests the stream repeatedly
    status: Word = 0

    def changed(self, words: Mapping[str, str]) -> "FaultSwitches":
        """Return a copy with some switches set by name.

        Raises:
            ValueError: A name or a value is invalid; the text lists the valid names.
        """
        if unknown := [name for name in words if name not in FaultSwitches.model_fields]:
            names = ", ".join((*FaultSwitches.model_fields, EVENT))
            raise ValueError(f"no switch {unknown[0]!r}: use one of {names}")
        try:
            changes = {name: word.strip() for name, word in words.items()}
            return FaultSwitches.model_validate(self.model_dump() | changes)
        except ValidationError as error:
            raise ValueError(first_mistake(error).text) from None


class NetftSensor:
    """Net F/T state machine; the last client to request the stream receives it, as on real ones."""

    def __init__(self, about: About | None = None, *, ft_step: int = 7, seed: int = 0) -> None:
        """Power on. `ft_step`: internal samples between two records."""
        self.about = about or About()
        self.switches = FaultSwitches()
        self.client: Address | None = None
        self.ft_sequence = 0
        self._ft_step = ft_step
        self._rng = np.random.default_rng(seed)
        self._rdt_sequence = 0
        self._remaining: int | None = None  # records still to be sent; None: unlimited
        self._counts: tuple[int, ...] = (0,) * 6
        self._bias: tuple[int, ...] = (0,) * 6
        self._held: list[bytes] = []

    def receive(self, data: bytes, client: Address) -> None:
        """Process a request; an invalid one is ignored, as by a real sensor."""
        command, count = command_of(data) or (None, 0)
        if command == START:
            self.client, self._rdt_sequence, self._held = client, 0, []
            self._remaining = count or None
        elif command == STOP and client == self.client:
            self.client = None
        elif command == BIAS:
            bias = zip(self._bias, self._counts, strict=True)
            self._bias = tuple(before + count for before, count in bias)

    def restart(self) -> None:
        """Simulate a power cycle: drop the client and reset all counters and the bias."""
        self.client, self.ft_sequence, self._rdt_sequence = None, 0, 0
        self._bias, self._held = (0,) * 6, []

    def measure(self, wrench: Sequence[float]) -> list[tuple[bytes, Address]]:
        """Take a sample of a wrench [N, N m]; return the datagrams with their receivers."""
        switches = self.switches
        if not switches.stall:
            self.ft_sequence += self._ft_step
            if not switches.freeze:
                self._counts = self._counts_of(wrench)
        if switches.steal and self._rdt_sequence >= STEAL_AFTER and self.client is not None:
            self.client = None
        if self.client is None:
            return []
        self._rdt_sequence += 1
        data = record(self._rdt_sequence, self.ft_sequence, switches.status, self._shown())
        client = self.client
        if self._remaining is not None:
            self._remaining -= 1
            self.client = client if self._remaining else None
        return [(sent, client) for sent in self._disturbed(data)]

    def _counts_of(self, wrench: Sequence[float]) -> tuple[int, ...]:
        scales = [self.about.counts_per_N] * 3 + [self.about.counts_per_Nm] * 3
        ideal = (round(value * scale) for value, scale in zip(wrench, scales, strict=True))
        return tuple(count - bias for count, bias in zip(ideal, self._bias, strict=True))

    def _shown(self) -> tuple[int, ...]:
        if not self.switches.saturate:
            return self._counts
        full = round(self.about.force_range_N * self.about.counts_per_N)
        return (*self._counts[:2], full, *self._counts[3:])

    def _disturbed(self, data: bytes) -> list[bytes]:
        """Return the datagrams of this period after fault injection."""
        switches = self.switches
        if switches.mute:
            return []
        if switches.garbage:
            return [NOT_A_RECORD]
        late, self._held = self._held, []
        if switches.loss and self._rng.random() < switches.loss:
            return late
        if switches.reorder and not late and self._rng.random() < switches.reorder:
            self._held = [data]
            return []
        copies = 2 if switches.duplicate and self._rng.random() < switches.duplicate else 1
        return [data] * copies + late
