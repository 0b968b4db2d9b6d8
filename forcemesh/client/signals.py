"""Digital signals of the robot: read all, set an output, wait for an input or an output."""

from forcemesh import topics
from forcemesh.client.feed import Feed
from forcemesh.client.session import ClientSession
from forcemesh.clock import wait_until
from forcemesh.errors import DataError, LostError, NotReachedError
from forcemesh.messages import RobotSignals
from forcemesh.requests import Reply, SignalRequest

SIGNAL_POLL_S = 0.01
LONGEST_WAIT_S = 60.0
FIRST_SIGNALS_S = 2.0
SWITCHED_WITHIN_S = 1.0  # outputs are switched one at a time
NO_SIGNALS = "a cell publishes them if its cell file has a section signals"


class DigitalSignals:
    """`cell.signals`: digital inputs and outputs that the cell file names."""

    def __init__(self, session: ClientSession) -> None:
        """Use the session of a client."""
        self._session = session
        self.feed: Feed[RobotSignals] = session.feed(topics.ROBOT_SIGNALS)

    def read(self, within_s: float = FIRST_SIGNALS_S) -> dict[str, bool]:
        """Return the state of every signal by name: True is on.

        Raises:
            NotValidError: The robot does not report them, for instance over a lost link.
            LostError: No message: the cell file names no signals, or a service is silent.
        """
        try:
            return dict(self.feed(within_s).on)
        except LostError as error:
            text = f"{error}: {NO_SIGNALS}"
            raise LostError(text, error.roles, is_all=error.is_all) from None

    def set(self, signal: str | int, on: bool = True) -> Reply:  # noqa: FBT001, FBT002 - what it sets
        """Switch an output on or off; the state follows a moment later, see `wait`.

        Args:
            signal: Name in the cell file, or number in the controller.
            on: True: on, False: off.

        Raises:
            RefusedError: The cell file does not name it or does not permit it, or the robot holds.
        """
        request = SignalRequest(signal=str(signal), on=on, commander=self._session.commander)
        return self._session.ask(topics.SIGNAL, request, within_s=SWITCHED_WITHIN_S)

    def wait(
        self,
        name: str,
        on: bool = True,  # noqa: FBT001, FBT002 - what is waited for
        timeout_s: float = LONGEST_WAIT_S,
    ) -> None:
        """Wait until a signal is on, or off.

        A state that is unknown meanwhile, for instance over a lost link, counts as neither.

        Args:
            name: Name in the cell file.
            on: Awaited state.
            timeout_s: Longest wait [s].

        Raises:
            DataError: No signal has this name; lists those that exist.
            NotReachedError: Not within `timeout_s`; says what the signal was.
            NotValidError, LostError: As `read`.
        """
        known = self.read()
        if name not in known:
            raise DataError(f"no signal {name!r}: the cell file names {', '.join(known)}")

        def is_there() -> bool:
            fresh = self.feed.reading().fresh
            return fresh is not None and fresh.on.get(name) is on

        clock = self._session.clock
        if wait_until(clock, is_there, within_s=timeout_s, poll_s=SIGNAL_POLL_S):
            return
        reading = self.feed.reading()
        state = {True: "on", False: "off", None: "unknown"}[
            None if reading.fresh is None else reading.fresh.on.get(name)
        ]
        why = f" ({reading.fault})" if reading.fresh is None else ""
        asked = "on" if on else "off"
        raise NotReachedError(f"{name} is {state}{why} after {timeout_s:g} s, expected {asked}")
