"""A hundred thousand bad packets: none is accepted. The nightly run tries ten million."""

import random

import pytest

from controller.packet import PACKET_CHARS
from tests.fuzz import codec


def test_no_bad_packet_is_accepted() -> None:
    """Half, merged, cut, shifted, an odd character: by neither end; all kinds were tried.

    What is shifted or cut, by characters or by whole frames, is no packet already by its form.
    """
    tally = codec.run(100_000, seed=1)
    assert tally.misread == []
    assert min(tally.kinds[name] for name in codec.SPOILS) > 10_000
    assert set(tally.well_formed) == codec.LATE
    assert tally.detected_late > 1000  # errors that no checksum detects ended with the next packet


@pytest.mark.parametrize("shift", [7, 14, 21])
def test_the_judge_detects_a_misread(shift: int) -> None:
    """A stream that was never sent and is well formed counts, or the test above proves nothing."""
    rng, tally = random.Random(2), codec.MisreadCounts()
    moves = b"000001 000000 "
    trio = next(trio for trio in codec.trios(rng) if trio.chars[0][7:21] == moves)
    other = trio.chars[0][:-shift] + b"000042 " * (shift // 7)
    assert len(other) == PACKET_CHARS
    assert "never sent" in codec.judge(trio, (other, 0), tally, "hand-made")
