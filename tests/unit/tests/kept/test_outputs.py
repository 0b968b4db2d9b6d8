"""Outputs of wrench, regulator, arbiter, gateway and program in kept runs are the same today.

A change that is to change nothing is held to this; one that is meant to change something stores the
runs that it changes anew (`python -m tests.kept RUN ...`) and gives the reason in its commit.
"""

import dataclasses

import numpy as np
import pytest

from control import law
from tests.kept.outputs import FOLDER, MOST_APART, Kept, differences, kept_of, read, windows
from tests.kept.runs import RUNS


@pytest.mark.parametrize("name", RUNS)
def test_a_kept_run_is_as_it_was(name: str) -> None:
    """Every number to 1e-9, every state, code and packet at its millisecond."""
    assert differences(read(name), kept_of(RUNS[name].run_cell())) == []


def test_every_run_is_kept_and_nothing_else() -> None:
    """A file without its run would be checked by no test."""
    stored = {path.stem for path in FOLDER.glob("*.npz")}
    assert stored == {path.stem for path in FOLDER.glob("*.json")} == RUNS.keys()


def test_a_gain_that_is_a_millionth_part_off_is_found(monkeypatch) -> None:
    """Far below the resolution of any test of the law itself."""
    well = law.next_motion

    def nearly(sample, settings):
        more = tuple(gain * (1.0 + 1e-6) for gain in sample.gains.force_i_m_per_Ns)
        gains = sample.gains.replaced(force_i_m_per_Ns=more)
        return well(dataclasses.replace(sample, gains=gains), settings)

    monkeypatch.setattr("control.laws.next_motion", nearly)
    found = differences(read("plain-sim-both"), kept_of(RUNS["plain-sim-both"].run_cell()))
    assert any(line.startswith("regulator pose: from window") for line in found)


@pytest.mark.parametrize("place", [0, 17, 39, 40, 99])
def test_one_number_of_one_message_is_detected(place: int) -> None:
    """By its sum, wherever it stands; two that make up for one another by their places."""
    rows = [[float(k), 1.0] for k in range(100)]
    kept = Kept({"wrench": windows(rows)}, ["0 begins"])
    rows[place][1] += 3.0 * MOST_APART
    assert differences(kept, Kept({"wrench": windows(rows)}, ["0 begins"]))
    rows[place - 1][1] -= 3.0 * MOST_APART * 40
    assert differences(kept, Kept({"wrench": windows(rows)}, ["0 begins"]))


def test_a_missing_new_or_not_finite_number_is_a_difference() -> None:
    """Streams and events alike."""
    kept = Kept({"wrench": windows([[1.0]] * 3)}, ["0 begins", "4 ends"])
    assert differences(kept, kept) == []
    assert differences(kept, kept._replace(numbers={})) == [
        "wrench: 1 windows were kept, and are 0"
    ]
    assert differences(kept, kept._replace(events=["0 begins"])) == [
        "event 1: it was '4 ends', and is 'nothing'"
    ]
    lost = kept._replace(numbers={"wrench": windows([[1.0], [np.nan], [1.0]])})
    assert differences(kept, lost)
