"""Quality of a stream of records: loss rates, and the cause of an interruption. Pure."""

from dataclasses import dataclass

from services.sensor.driver import NO_FAULT, SensorFault
from services.sensor.rdt import JUMP, RdtRecord, Tally, signed

QUALITY_WINDOW = 250  # places of the stream; the last one to two windows are evaluated
BAD_SHARE = 0.1  # of the records: above it, the network path is unreliable
LEAST_RECORDS = 100  # fewer give no reliable rate

MOST_FT_HZ = 10_000  # no sensor samples faster
FT_MARGIN = 5_000
AWAY_RECORDS = 3  # fewest records that another client must have received
NOTHING_YET = Tally()


@dataclass(frozen=True, slots=True)
class Quality:
    """Tallies of one to two windows ago, and of at most one window ago."""

    older: Tally = NOTHING_YET
    older_place: int = 0
    newer: Tally = NOTHING_YET
    newer_place: int = 0

    def moved_on(self, tally: Tally, place: int) -> "Quality":
        """Return the window after the records up to a place of the stream."""
        if place - self.newer_place < QUALITY_WINDOW:
            return self
        return Quality(self.newer, self.newer_place, tally, place)

    def rate_fault(self, tally: Tally, place: int) -> SensorFault:
        """Return the fault of the records in the window."""
        places = place - self.older_place
        if places < LEAST_RECORDS:
            return NO_FAULT
        shares = (
            ("sensor_lossy", "were lost", tally.lost - self.older.lost),
            ("sensor_disorder", "arrived out of order", tally.reordered - self.older.reordered),
            ("sensor_copies", "arrived twice", tally.duplicates - self.older.duplicates),
        )
        for code, what, count in shares:
            if count > BAD_SHARE * places:
                return SensorFault(code, f"{count} of the last {places} records {what}")
        return NO_FAULT


def continues(last: RdtRecord, record: RdtRecord, ft_step: int) -> bool:
    """Return whether a record is of the same stream: both sequences changed together."""
    places = signed(record.rdt_sequence - last.rdt_sequence)
    samples = signed(record.ft_sequence - last.ft_sequence)
    off = abs(samples - places * ft_step)
    return abs(places) < JUMP and off <= ft_step + abs(places) * ft_step // 2


def meaning_of_break(
    last: RdtRecord, first: RdtRecord, *, silent_s: float, ft_step: int, at_once: bool
) -> SensorFault:
    """Return the cause of the interruption between two streams.

    Args:
        last: Newest record before the interruption.
        first: First record after it.
        silent_s: Time between the two.
        ft_step: Increment of ft_sequence per record before.
        at_once: Whether the stream was requested, and the first request was answered.
    """
    gap = signed(first.ft_sequence - last.ft_sequence)
    if gap < 0 or gap > silent_s * MOST_FT_HZ + FT_MARGIN:
        return SensorFault(
            "sensor_restarted",
            f"the sensor restarted: ft_sequence went from {last.ft_sequence} "
            f"to {first.ft_sequence}",
        )
    if at_once and gap > AWAY_RECORDS * max(ft_step, 1):
        # It kept measuring and can be reached, but it had stopped sending here.
        return SensorFault(
            "sensor_stolen",
            f"the sensor sent nothing for {silent_s * 1e3:.0f} ms, kept measuring and answered "
            "the next request at once: another client took its stream",
        )
    return NO_FAULT
