"""The panel's tab of recordings, which shows the recorder's status."""

import pytest

from forcemesh.messages import RecorderStatus
from services.panel.tabs import all_tabs
from services.panel.tabs.record import words

FILE = "/somewhere/demo-20261122T080000Z-01.mcap"


@pytest.mark.parametrize(
    ("status", "shown"),
    [
        (None, "no data from the recorder"),
        (RecorderStatus(memory_s=61.0), "not recording"),
        (RecorderStatus(memory_s=61.0), "Ring buffer: 61 s"),
        (RecorderStatus(recording=True, cause="asked", recorded_s=7.0), "● recording</b> for 7 s"),
        (RecorderStatus(recording=True, cause="force"), "started by <code>force</code>"),
        (
            RecorderStatus(file=FILE, messages=5, lost=2),
            "<code>demo-20261122T080000Z-01.mcap</code>: 5 messages",
        ),
        (RecorderStatus(valid=False, reason="0.5 GB are free"), "⚠ 0.5 GB are free"),
    ],
)
def test_the_recorders_status_is_shown(status: RecorderStatus | None, shown: str) -> None:
    """Silence, rest, a recording of either cause, losses, and a fault."""
    assert shown in words(status)


def test_the_tab_is_one_of_the_panels() -> None:
    """It is there once, before the faults."""
    labels = [tab.label for tab in all_tabs()]
    assert labels.count("Record") == 1
    assert labels.index("Record") < labels.index("Faults")
