"""Feed of a path of poses at a force error, and what it counts as missed."""

from services.regulator.pose_path import LEAST_FEED, feed_share, is_missed


def test_the_feed_falls_with_the_force_error_and_never_stops() -> None:
    """A tenth of the set point is at full feed; an error that only motion removes leaves a rest."""
    assert feed_share(0.9, 10.0) == 1.0
    assert LEAST_FEED < feed_share(-3.0, 10.0) < 1.0
    assert feed_share(50.0, 10.0) == LEAST_FEED


def test_what_another_force_worked_on_is_missed() -> None:
    """A fifth of the set point, and at least one newton."""
    assert (is_missed(1.9, 10.0), is_missed(-2.1, 10.0), is_missed(0.9, 0.0)) == (0, 1, 0)
