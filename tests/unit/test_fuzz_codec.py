"""A hundred thousand bad packets: none is believed. `make fuzz-codec` tries ten million."""

import random

import pytest

from common.packet import PACKET_CHARS
from fuzz import codec


def test_no_bad_packet_is_believed() -> None:
    """Half, merged, truncated, shifted, an odd character: by neither end; all kinds were tried."""
    tally = codec.run(100_000, seed=1)
    assert tally.misread == []
    assert min(tally.kinds[name] for name in codec.SPOILS) > 10_000
    assert tally.legal_frames > 1000  # shifts by whole frames went past the characters
    assert tally.seen_late > 1000  # and what no checksum could see ended with the next packet


@pytest.mark.parametrize("shift", [7, 14, 21])
def test_the_judge_sees_a_misread(shift: int) -> None:
    """A stream that was never sent and is well formed counts, or the test above proves nothing."""
    rng, tally = random.Random(2), codec.Tally()
    trio = next(trio for trio in codec.trios(rng) if not trio.to_gateway)
    other = trio.chars[0][:-shift] + b"000042 " * (shift // 7)
    assert len(other) == PACKET_CHARS
    assert "never sent" in codec.judge(trio, other, 0, tally)
