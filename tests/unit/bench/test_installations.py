"""Wrong installations in a whole virtual cell: the answers of arming and of the check."""

import numpy as np
import pytest

from bench.installations import (
    ALL,
    FORCES,
    ROWS,
    TORQUES,
    InstallationError,
    MisinstalledCell,
    cell_with,
    channels,
    gather,
    others,
    readings_with,
    row,
    short,
    summary,
)
from bench.results import Row, read, table
from forcemesh import topics
from forcemesh.requests import ArmRequest, Empty
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation


@pytest.mark.parametrize("sideways", [np.diag([-1.0, -1.0, 1.0]), np.eye(3)])
def test_an_error_in_x_and_y_passes_the_tare_but_arming_refuses_it_in_another_attitude(
    sideways,
) -> None:
    """Tool down the weight reads right; with the wrist turned it does not: arming is refused."""
    world = MisinstalledCell(InstallationError("sideways", ALL, channels(sideways, sideways)))
    assert world.refusal(topics.TARE, Empty()) == ""
    world.turn_wrist()
    refused = world.refusal(topics.ARM, ArmRequest())
    assert refused.startswith("payload: ") == (sideways[0, 0] < 0.0)
    assert ("are left where nothing should be touched" in refused) == bool(refused)


@pytest.mark.long
def test_poses_gathered_by_the_arm_identify_a_wrong_wiring() -> None:
    """A run with a wrong wiring gives the same findings as rewired rows of a correct run."""
    wiring = SIGNED[18]
    mistake = InstallationError("turned", ALL, channels(wiring, wiring))
    expected = ExpectedInstallation.of(cell_with({}))
    played = judge_installation(gather(mistake), expected)
    assert [str(f) for f in played.findings] == [
        str(f) for f in judge_installation(readings_with(mistake), expected).findings
    ]
    assert played.findings[0].code == "mounting"
    right = judge_installation(readings_with(InstallationError("none", ALL)), expected)
    assert right.rejection_reason is None


def test_a_mistake_that_the_cell_file_refuses_starts_nothing() -> None:
    """A length in millimetres is reported before anything is measured."""
    (mistake,) = (each for each in others() if each.name.startswith("tool.T_flange_tcp"))
    found = row(mistake)
    assert found["detected"]
    assert found["tare"] == found["arming"] == "nothing starts"
    assert "160 m; is that in millimetres?" in found["result"]


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_tenth_of_the_rows_is_what_is_stored() -> None:
    """Text of the check, of arming, stop, peak and travel, measured again.

    The stored text of the tare's refusal is of an earlier commit: it names another reason now.
    """
    rows = read("installations").tables["rows"]
    columns, stored = rows.columns, rows.records
    for place in range(1, len(ROWS.cases), 10):
        (again,) = table(columns, [row(ROWS.cases[place])]).records
        before = {name: stored[place][name] for name in again}
        assert bool(again.pop("tare")) == bool(before.pop("tare"))
        assert again == before


def outcome(**changes: object) -> Row:
    """Return the row of one mistake."""
    safe = {"detected": True, "tare": "", "arming": "9 N are left", "harmless": True}
    return {"group": "g", "error": "x", **safe, **changes}


def test_the_summary_counts_the_mistakes_that_pass_every_check() -> None:
    """A reported, refused or harmless mistake is safe; one that is none of these is not."""
    rows = [
        outcome(),
        outcome(detected=False, arming="", harmless=False),
        outcome(error="none: all correct", detected=False, arming=""),
    ]
    (found,) = summary(rows)
    assert [*found.values()] == ["g", 2, 1, 1, 1, 1, False]


def test_a_reason_is_shortened_to_its_first_part() -> None:
    """Code and advice are left out; a short answer stays."""
    assert short("payload: 9 N are left: tare in free space") == "9 N are left"
    assert short("jog: the arbiter is BOOT") == "jog: the arbiter is BOOT"
    assert short("") == ""


def test_the_stored_result_has_no_undetected_mistake() -> None:
    """47 of 47 are reported in each group of wirings, and no mistake passes every check."""
    assert len(ROWS.cases) == 3 * 47 + 18
    result = read("installations")
    found = {each["group"]: each for each in result.tables["summary"].records}
    for group in (ALL, FORCES, TORQUES):
        assert (found[group]["errors"], found[group]["detected_by_the_check"]) == (47, 47)
    assert all(each["met"] and each["none_of_these"] == 0 for each in found.values())
    wrong = [r for r in result.tables["rows"].records if not r["error"].startswith("none")]
    assert all(each["detected"] for each in wrong)
    assert len(wrong) == sum(each["errors"] for each in found.values())
