"""Wrong installations in a whole virtual cell: what arming says, what the check says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.installations import ALL, FORCES, TORQUES, others, play, wirings
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
from identification.installation.check import judge_installation, rejection_reason
from identification.installation.terms import ExpectedInstallation

PAGE = Path(__file__).resolve().parents[3] / "docs" / "installations.md"


def test_every_mistake_of_the_issue_is_played() -> None:
    """47 wirings of all channels, of forces, of torques; units; payload by 20 % and 20 mm."""
    for group in (ALL, FORCES, TORQUES):
        assert len({mistake.name for mistake in wirings(group)}) == 47
    names = [mistake.name for mistake in others()]
    for words in ("kgf", "pounds", "N mm", "radians", "degrees", "in mm", "1.2 of", "20 mm off"):
        assert any(words in name for name in names), words


def test_what_is_wrong_sideways_only_passes_the_tare_and_is_not_armed_in_another_attitude() -> None:
    """Tool down its weight reads right; with the wrist turned it does not, and arming says so."""
    sideways = np.diag([-1.0, -1.0, 1.0])
    stage = Stage(InstallationError("sideways", ALL, sideways, sideways))
    assert stage.world.client.ask(topics.TARE, Empty()).accepted
    stage.turn_wrist()
    reply = stage.world.client.ask(topics.ARM, ArmRequest())
    assert (reply.accepted, reply.code) == (False, "payload")
    assert "are left where nothing should be touched" in reply.text


def test_who_is_rightly_installed_is_armed_in_another_attitude() -> None:
    """The same without a mistake."""
    stage = Stage(InstallationError("none", ALL))
    assert stage.world.client.ask(topics.TARE, Empty()).accepted
    stage.turn_wrist()
    assert stage.world.client.ask(topics.ARM, ArmRequest()).accepted


@pytest.mark.long
def test_the_arm_itself_gathers_what_tells_a_wrong_wiring() -> None:
    """Played anew with a wrong wiring: the same finding as from the rows that are rewired."""
    wiring = SIGNED[18]
    mistake = InstallationError("turned", ALL, wiring, wiring)
    belief = ExpectedInstallation.of(true_cell())
    played = judge_installation(gather(mistake), belief)
    assert [str(f) for f in played.findings] == [
        str(f) for f in judge_installation(readings_with(mistake), belief).findings
    ]
    assert played.findings[0].code == "mounting"
    assert rejection_reason(readings_with(InstallationError("none", ALL)), belief) is None


def test_what_the_cell_file_refuses_starts_nothing() -> None:
    """A length in millimetres is told before anything is measured."""
    (mistake,) = (each for each in others() if each.name.startswith("tool.T_flange_tcp"))
    seen = play(mistake)
    assert seen.is_told
    assert seen.is_refused
    assert "160 m; is that in millimetres?" in seen.sentences


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_tenth_of_the_table_is_as_the_page_says() -> None:
    """Told by the check, and then not armed or harmless; each has its sentence on the page."""
    text = PAGE.read_text(encoding="utf-8")
    for mistake in [*others(), *wirings(ALL), *wirings(TORQUES)][1::10]:
        seen = play(mistake)
        assert seen.is_told, seen
        assert seen.is_refused or seen.is_harmless, seen
        assert f"| {mistake.name} |" in text


# --- the page -------------------------------------------------------------------------------------


def outcome(**changes) -> Outcome:
    """Return what came of one mistake."""
    fields: dict[str, Any] = {
        "mistake": "x",
        "group": "g",
        "verdict": "wrong",
        "findings": ("it is turned; write it",),
        "tare": "",
        "arming": "payload: 9 N are left: tare in free space",
        "press": "sensor_sign after 3 ms",
        "peak_N": 5.0,
        "way_m": 1e-3,
    }
    return Outcome(**(fields | changes))


def test_the_page_counts_what_passes_every_line() -> None:
    """What is told, refused or harmless is safe; what is neither stands in the last column."""
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


def test_the_page_in_the_documentation_leaves_nothing_through() -> None:
    """47 of 47 told in each group, and no mistake that nothing stops."""
    text = PAGE.read_text(encoding="utf-8")
    for group in (ALL, FORCES, TORQUES):
        (line,) = [line for line in text.splitlines() if line.startswith(f"| {group} | ")]
        assert "| 47 of 47 |" in line
        assert line.endswith("| 0 |")
