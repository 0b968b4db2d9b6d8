"""The simulated sensor without its sockets: requests in, records out. Deterministic by seed."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.netft.protocol import BIAS, START, STOP, About, command_of, record
from sim.netft.switches import Switches

Address = Any  # of a client, whatever the transport calls one
STEAL_AFTER = 300  # records a client gets until the second one asks again
NOT_A_RECORD = b"HTTP/1.0 400 Bad Request\r\n\r\n"


class NetftSensor:
    """Gives its stream to the one who asked last, like the real one."""

    def __init__(self, about: About | None = None, *, ft_step: int = 7, seed: int = 0) -> None:
        """Be powered on. `ft_step`: samples of its own from one record to the next."""
        self.about = about or About()
        self.switches = Switches()
        self.client: Address | None = None
        self.thefts = 0
        self.ft_sequence = 0
        self._ft_step = ft_step
        self._rng = np.random.default_rng(seed)
        self._rdt_sequence = 0
        self._left: int | None = None  # records still to be sent, None: endless
        self._counts: tuple[int, ...] = (0,) * 6
        self._bias: tuple[int, ...] = (0,) * 6
        self._held: list[bytes] = []

    def hear(self, data: bytes, client: Address) -> None:
        """Take a request; what is none is ignored, as the real one does."""
        asked = command_of(data)
        if asked is None:
            return
        command, count = asked
        if command == START:
            self.client, self._rdt_sequence, self._held = client, 0, []
            self._left = count or None
        elif command == STOP and client == self.client:
            self.client = None
        elif command == BIAS:
            bias = zip(self._bias, self._counts, strict=True)
            self._bias = tuple(before + count for before, count in bias)

    def restart(self) -> None:
        """Lose power for a moment: nobody is streamed to, every number begins anew."""
        self.client, self.ft_sequence, self._rdt_sequence = None, 0, 0
        self._bias, self._held = (0,) * 6, []

    def measure(self, wrench: Sequence[float]) -> list[tuple[bytes, Address]]:
        """Take a sample of a wrench [N, N m]; return the datagrams and to whom they go."""
        switches = self.switches
        if not switches.stall:
            self.ft_sequence += self._ft_step
            if not switches.freeze:
                self._counts = self._counts_of(wrench)
        if switches.steal and self._rdt_sequence >= STEAL_AFTER and self.client is not None:
            self.client = None
            self.thefts += 1
        if self.client is None:
            return []
        self._rdt_sequence += 1
        data = record(self._rdt_sequence, self.ft_sequence, switches.status, self._shown())
        client = self.client
        if self._left is not None:
            self._left -= 1
            self.client = client if self._left else None
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
        """Return what leaves the sensor, or arrives of it, in this period."""
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
