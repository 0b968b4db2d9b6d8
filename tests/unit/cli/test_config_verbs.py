"""Verbs for cell files: a new file loads, and every value is shown with its source."""

import json
from functools import partial
from pathlib import Path

import pytest

from cli.config_verbs import TEMPLATES
from cli.context import OK, USAGE
from common.config.load import load_cell
from tests.fakes import verb_calls
from tests.fakes.bench import DEMO

run = partial(verb_calls.run, "config")


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_new_cell_file_loads_and_keeps_its_comments(kind: str, tmp_path: Path) -> None:
    """It is named after its file, and is never written over another one."""
    path = tmp_path / "left-arm.yaml"
    assert run("init", path, "--kind", kind).exit_code == OK
    assert load_cell(path).cell == "left-arm"
    assert "# This is not a safety function" in path.read_text() or kind != "real"
    before = path.read_text()
    again = run("init", path)
    assert (again.exit_code, path.read_text()) == (USAGE, before)
    assert "exists already" in again.stderr


def test_show_does_not_print_a_token(tmp_path: Path) -> None:
    """A printed token is no longer secret."""
    path = tmp_path / "cell.yaml"
    path.write_text(DEMO.read_text() + "\npanel: {token: do-not-tell-this}\n")
    shown = run("show", "--cell", path, "--json").stdout
    assert "do-not-tell-this" not in shown
    assert json.loads(shown)["values"]["panel.token"] == {"value": "(not shown)", "from": "file"}
