"""Signals of the controller as its reports 104 give them: groups of 16, and since when. Pure.

A report counts only if its ID shows that the receiver had executed command 15 with the groups: an
earlier one describes the groups of an earlier connection.
"""

from collections.abc import Mapping

from common.config.signals import GROUP, SignalSection, groups
from common.runtime.signal_service import SignalReading
from controller.packet import ZERO_VEC
from controller.packet_table import Com, SignalParam
from forcemesh.clock import NS_PER_S
from services.gateway.packets import Command, SignalReport

STALE_AFTER_S = 2.0  # 104 is sent with every eighth sample: some times a second


def switch_output(number: int, *, on: bool) -> Command:
    """Return command 15 that switches one output: its number, negative for off."""
    return Command(Com.SIGNAL, int(SignalParam.SWITCH), (number if on else -number, 0, 0, 0, 0, 0))


class ControllerSignals:
    """Newest state of the signals that the cell file names."""

    def __init__(self, signals: Mapping[str, SignalSection]) -> None:
        """Start without a report."""
        self._firsts = groups(signals)
        self._newest: SignalReading | None = None
        self._at_ns = 0

    @property
    def selection(self) -> tuple[Command, ...]:
        """Command 15 with the groups to report; none when the cell file names no signal."""
        if not self._firsts:
            return ()
        vec = list(ZERO_VEC)
        vec[: len(self._firsts)] = self._firsts
        a, b, c, d, e, f = vec
        return (Command(Com.SIGNAL, int(SignalParam.GROUPS), (a, b, c, d, e, f)),)

    def disconnected(self) -> None:
        """Forget the state: that of a lost connection is not the present one."""
        self._newest = None

    def take(self, report: SignalReport, now_ns: int) -> None:
        """Take a report of the selected groups."""
        self._at_ns = now_ns
        self._newest = SignalReading(
            {
                first + k: bool(value >> k & 1)
                for first, value in zip(self._firsts, report.groups, strict=False)
                for k in range(GROUP)
            }
        )

    def reading(self, now_ns: int) -> SignalReading:
        """Return the state of every signal of the groups, or why it is unknown."""
        if self._newest is None:
            reason = "the controller has not reported its signals yet"
            return SignalReading(code="robot_link", reason=reason)
        age_s = (now_ns - self._at_ns) / NS_PER_S
        if age_s > STALE_AFTER_S:
            reason = f"the controller's report is {age_s:.1f} s old, limit {STALE_AFTER_S:g} s"
            return SignalReading(code="robot_link", reason=reason)
        return self._newest
