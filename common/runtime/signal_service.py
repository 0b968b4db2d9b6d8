"""Digital signals on the bus, for the role `robot`: requests to set an output, state of all.

The gateway and the simulated robot use it alike. It judges a request by the cell file, by the hold
of its own process and by what the robot reports; the arbiter has no part in it, because an output
needs no permission to move (docs/decisions.md).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from common.config.cell import CellConfig
from common.config.signals import judge, resolve
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.faults import clipped, refusal, refused
from forcemesh.messages import RobotSignals, Trip
from forcemesh.requests import Reply, SignalRequest


@dataclass(frozen=True, slots=True)
class SignalReading:
    """State of the robot's signals by number, or why it is unknown."""

    on: Mapping[int, bool] = field(default_factory=dict)
    code: str = ""  # of forcemesh/faults.py; empty: the state is known
    reason: str = ""


Switch = Callable[[int, bool], Trip | None]


class SignalService:
    """Server of `request/signal` and publisher of `robot/signals`."""

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Open request and topic; a cell whose file names no signal publishes none."""
        self._signals = cell.signals
        self._inbox = bus.inbox(topics.SIGNAL)
        self._topic = bus.publisher(topics.ROBOT_SIGNALS) if cell.signals else None
        self._period_ns = round(NS_PER_S / cell.rate_hz(topics.ROBOT_SIGNALS))
        self._next_ns = 0
        self._read: SignalReading | None = None  # the last one: the same object is the same state
        self._published: RobotSignals | None = None

    def step(
        self, now_ns: int, reading: SignalReading, *, hold: Trip | None, switch: Switch
    ) -> None:
        """Serve requests; publish the state at its rate, and at once when it changes.

        Args:
            now_ns: Time of this step.
            reading: What the robot reports.
            hold: Why the robot holds, None while it may move.
            switch: Switches an output, by number, on or off; returns why it cannot now.
        """
        for incoming in self._inbox.take_all():
            incoming.reply(self._answer(incoming.request, reading, hold=hold, switch=switch))
        if self._topic is None or (reading is self._read and now_ns < self._next_ns):
            return
        self._read, state = reading, self._state(reading)
        if now_ns >= self._next_ns or state != self._published:
            self._next_ns, self._published = now_ns + self._period_ns, state
            self._topic.put(state)

    def _state(self, reading: SignalReading) -> RobotSignals:
        """Return the message: every named signal, or none and why."""
        if reading.code:
            return RobotSignals(valid=False, code=reading.code, reason=clipped(reading.reason))
        return RobotSignals(
            on={name: reading.on[signal.number] for name, signal in self._signals.items()}
        )

    def _answer(
        self, request: SignalRequest, reading: SignalReading, *, hold: Trip | None, switch: Switch
    ) -> Reply:
        """Switch an output, or refuse with the reason."""
        trip = judge(self._signals, request.signal, request.commander, hold=hold)
        if trip is not None:
            return refused(trip)
        if reading.code:
            return refusal(reading.code, f"the state of the signals is unknown: {reading.reason}")
        name = resolve(self._signals, request.signal) or ""
        signal = self._signals[name]
        if (trip := switch(signal.number, request.on)) is not None:
            return refused(trip)
        word = "on" if request.on else "off"
        return Reply(accepted=True, text=f"{name} ({signal.label}) is switched {word}")
