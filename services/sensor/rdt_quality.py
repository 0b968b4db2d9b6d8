"""How good a stream of records is, and what a break in it means. Pure: numbers in, words out."""

from dataclasses import dataclass

from services.sensor.driver import FINE, Complaint
from services.sensor.rdt import JUMP, Record, Tally, signed

WINDOW = 250  # places of the stream; the last one to two windows are looked at
BAD_SHARE = 0.1  # of the records: above, the way from the sensor is not one to rely on
LEAST_PLACES = 100  # a short burst is no share

MOST_FT_HZ = 10_000  # no sensor samples faster
FT_MARGIN = 5_000
AWAY_RECORDS = 3  # so many were sent to somebody else, at least
NOTHING_YET = Tally()


@dataclass(frozen=True, slots=True)
class Quality:
    """The tally as it stood one to two windows ago, and one window ago at most."""

    older: Tally = NOTHING_YET
    older_place: int = 0
    newer: Tally = NOTHING_YET
    newer_place: int = 0

    def moved_on(self, tally: Tally, place: int) -> "Quality":
        """Return the window after records up to a place of the stream have come."""
        if place - self.newer_place < WINDOW:
            return self
        return Quality(self.newer, self.newer_place, tally, place)

    def complaint(self, tally: Tally, place: int) -> Complaint:
        """Return what is wrong with the records of the window."""
        places = place - self.older_place
        if places < LEAST_PLACES:
            return FINE
        shares = (
            ("sensor_lossy", "were lost", tally.lost - self.older.lost),
            ("sensor_disorder", "came out of order", tally.reordered - self.older.reordered),
            ("sensor_copies", "came twice", tally.duplicates - self.older.duplicates),
        )
        for code, what, count in shares:
            if count > BAD_SHARE * places:
                return Complaint(code, f"{count} of the last {places} records {what}")
        return FINE


def continues(last: Record, record: Record, ft_step: int) -> bool:
    """Tell whether a record is of the same stream: its two numbers moved on, or back, together."""
    places = signed(record.rdt_sequence - last.rdt_sequence)
    samples = signed(record.ft_sequence - last.ft_sequence)
    off = abs(samples - places * ft_step)
    return abs(places) < JUMP and off <= ft_step + abs(places) * ft_step // 2


def meaning_of_break(
    last: Record, first: Record, *, silent_s: float, ft_step: int, at_once: bool
) -> Complaint:
    """Return what happened between the last record of one stream and the first of the next.

    Args:
        last: The newest one before the break.
        first: The first one after it.
        silent_s: Time between the two.
        ft_step: By how much ft_sequence grew from record to record before.
        at_once: Whether the stream was asked for, and the first request was answered.
    """
    gap = signed(first.ft_sequence - last.ft_sequence)
    if gap < 0 or gap > silent_s * MOST_FT_HZ + FT_MARGIN:
        return Complaint(
            "sensor_restarted",
            f"the sensor began anew: ft_sequence went from {last.ft_sequence} "
            f"to {first.ft_sequence}",
        )
    if at_once and gap > AWAY_RECORDS * max(ft_step, 1):
        # It measured on, it can be reached, and it had stopped sending to us all the same.
        return Complaint(
            "sensor_stolen",
            f"the sensor had sent nothing for {silent_s * 1e3:.0f} ms, measured on and answered "
            "the next request at once: another client took its stream",
        )
    return FINE
