"""Wrong installations in a whole virtual cell: the answers of arming and of the check."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.installations import ALL, FORCES, TORQUES, evaluate, others, wirings
from bench.installations_page import Outcome, page, short
from bench.installations_stage import (
    InstallationError,
    Stage,
    gather,
    readings_with,
    true_cell,
)
from forcemesh import topics
from forcemesh.requests import ArmRequest, Empty
from identification.installation.axis_fit import SIGNED
from identification.installation.check import judge_installation
from identification.installation.terms import ExpectedInstallation

PAGE = Path(__file__).resolve().parents[3] / "docs" / "installations.md"


def test_every_listed_mistake_is_played() -> None:
    """47 wirings of all channels, of forces, of torques; units; payload by 20 % and 20 mm."""
    for group in (ALL, FORCES, TORQUES):
        assert len({mistake.name for mistake in wirings(group)}) == 47
    names = [mistake.name for mistake in others()]
    for words in ("kgf", "pounds", "N mm", "radians", "degrees", "in mm", "1.2 of", "20 mm off"):
        assert any(words in name for name in names), words


def test_an_error_in_x_and_y_passes_the_tare_but_arming_refuses_it_in_another_attitude() -> None:
    """Tool down the weight reads right; with the wrist turned it does not: arming is refused."""
    sideways = np.diag([-1.0, -1.0, 1.0])
    stage = Stage(InstallationError("sideways", ALL, sideways, sideways))
    assert stage.world.client.ask(topics.TARE, Empty()).accepted
    stage.turn_wrist()
    reply = stage.world.client.ask(topics.ARM, ArmRequest())
    assert (reply.accepted, reply.code) == (False, "payload")
    assert "are left where nothing should be touched" in reply.text


def test_a_correct_installation_is_armed_in_another_attitude() -> None:
    """The same steps without a mistake."""
    stage = Stage(InstallationError("none", ALL))
    assert stage.world.client.ask(topics.TARE, Empty()).accepted
    stage.turn_wrist()
    assert stage.world.client.ask(topics.ARM, ArmRequest()).accepted


@pytest.mark.long
def test_poses_gathered_by_the_arm_identify_a_wrong_wiring() -> None:
    """A run with a wrong wiring gives the same findings as rewired rows of a correct run."""
    wiring = SIGNED[18]
    mistake = InstallationError("turned", ALL, wiring, wiring)
    expected = ExpectedInstallation.of(true_cell())
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
    outcome_of_run = evaluate(mistake)
    assert outcome_of_run.is_detected
    assert outcome_of_run.is_refused
    assert "160 m; is that in millimetres?" in outcome_of_run.sentences


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_tenth_of_the_table_agrees_with_the_page() -> None:
    """The check reports each mistake, and it is refused or harmless; the page lists it."""
    text = PAGE.read_text(encoding="utf-8")
    for mistake in [*others(), *wirings(ALL), *wirings(TORQUES)][1::10]:
        outcome_of_run = evaluate(mistake)
        assert outcome_of_run.is_detected, outcome_of_run
        assert outcome_of_run.is_refused or outcome_of_run.is_harmless, outcome_of_run
        assert f"| {mistake.name} |" in text


# --- the page -------------------------------------------------------------------------------------


def outcome(**changes) -> Outcome:
    """Return the outcome of one mistake."""
    fields: dict[str, Any] = {
        "mistake": "x",
        "group": "g",
        "verdict": "wrong",
        "findings": ("it is turned; write it",),
        "tare": "",
        "arming": "payload: 9 N are left: tare in free space",
        "press": "sensor_sign after 3 ms",
        "peak_N": 5.0,
        "travel_m": 1e-3,
    }
    return Outcome(**(fields | changes))


def test_the_page_counts_the_mistakes_that_pass_every_check() -> None:
    """A reported, refused or harmless mistake is safe; the last column counts the others."""
    rows = [
        outcome(),
        outcome(verdict="right", findings=(), arming="", press="", peak_N=30.0),
        outcome(mistake="none: all correct", verdict="right", findings=(), arming=""),
    ]
    text = page(rows)
    assert "| g | 1 of 2 | 1 of 2 | 1 of 2 | 1 |" in text
    assert "| x | it is turned; write it | - | 9 N are left | sensor_sign after 3 ms |" in text


def test_a_reason_is_shortened_to_its_first_part() -> None:
    """Code and advice are left out; a short answer stays."""
    assert short("payload: 9 N are left: tare in free space") == "9 N are left"
    assert short("jog: the arbiter is BOOT") == "jog: the arbiter is BOOT"
    assert short("") == ""


def test_the_documented_page_has_no_undetected_mistake() -> None:
    """47 of 47 are reported in each group, and no mistake passes every check."""
    text = PAGE.read_text(encoding="utf-8")
    for group in (ALL, FORCES, TORQUES):
        (line,) = [line for line in text.splitlines() if line.startswith(f"| {group} | ")]
        assert "| 47 of 47 |" in line
        assert line.endswith("| 0 |")
