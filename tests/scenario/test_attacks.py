"""A whole cell with certificates, in processes, and nine attacks of unauthorised clients."""

from pathlib import Path

import pytest

from common.config.load import load_cell
from forcemesh.identity import folder_of
from tests.chaos.common_net import running_cell
from tests.hostile.attacks import ATTACKS, MOVED_RAD, attack_all

pytestmark = [pytest.mark.judged_once, pytest.mark.realtime, pytest.mark.processes]


def test_no_client_but_the_arbiter_moves_the_arm(tls_cell_file: Path, tmp_path: Path) -> None:
    """None of nine attacks moves it or is passed on, and the hub reports each refusal."""
    cell = load_cell(tls_cell_file)
    with running_cell(cell, tls_cell_file):
        outcomes = list(attack_all(cell, folder_of(cell)))
    assert [each.attack for each in outcomes] == [attack.name for attack in ATTACKS]
    assert len(outcomes) == 9
    for outcome in outcomes:
        assert outcome.moved_rad < MOVED_RAD, outcome
        assert outcome.forwarded == 0, outcome
    report = (tmp_path / "processes.log").read_text(encoding="utf-8")
    for code in {attack.code for attack in ATTACKS} - {""}:
        assert f"refused {code}" in report
