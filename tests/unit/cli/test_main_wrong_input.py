"""Every verb with wrong input: one exit code, a sentence that helps, never a traceback."""

import errno
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from cli.__main__ import app
from cli.context import CELL_VARIABLE, EXITS, NO_ANSWER, NOT_WELL, USAGE
from cli.exits import TABLE, exit_code_of
from common.config.load import load_cell
from forcemesh.errors import (
    BusError,
    ConfigError,
    DataError,
    ForcemeshError,
    RefusedError,
    SetupError,
)
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.run_file import FOLDER_VARIABLE
from tests.fakes.wrong_input import PASSES_ON, ROWS
from tools.cli_page import PAGE, page, walk

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "cells" / "demo.yaml"
VERBS: dict[str, Any] = {
    name.removeprefix("forcemesh "): verb
    for name, verb in walk(typer.main.get_command(app))
    if name.removeprefix("forcemesh ") not in PASSES_ON
}
HAVE_A_CELL = [v for v, c in VERBS.items() if "cell" in {each.name for each in c.params}]
# What each verb needs besides its options to get as far as the cell.
WORDS = {
    "move to": "0,0,0,0,0,0",
    "move joints": "0,0,0,0,0,0",
    "move by": "0,0,0,0,0,0",
    "jog": "x 1",
    "press": "15",
    "follow": "HERE",
    "pki issue": "operator",
}
NEEDS_NO_HUB = (
    *("topics", "config show", "pki init", "pki check", "pki issue"),
    *("status", "demo", "up"),  # told elsewhere
)


@pytest.fixture(autouse=True)
def nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place with some files, and no cell."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setenv(CELL_VARIABLE, str(DEMO))
    monkeypatch.setenv(ENDPOINT_VARIABLE, "tcp/127.0.0.1:9")  # nobody listens there
    monkeypatch.setattr("cli.context.CONNECT_PATIENCE_S", 0.0)
    (tmp_path / "here.yaml").write_text("")
    (tmp_path / "bad.csv").write_text("not,a,recording\n")


def said(line: str) -> tuple[int, str]:
    """Type a line; return the exit code and what was said, without frames and line breaks."""
    for word, name in (("NOWHERE", "nowhere.csv"), ("BAD", "bad.csv"), ("HERE", "here.yaml")):
        line = line.replace(word, name)
    done = CliRunner().invoke(app, shlex.split(line))
    text = re.sub(r"[│╭╮╰╯─]", " ", done.output)
    assert done.exception is None or isinstance(done.exception, SystemExit), repr(done.exception)
    assert "Traceback" not in text
    return done.exit_code, " ".join(text.split())


@pytest.mark.parametrize(("line", "code", "sentence"), ROWS, ids=[row[0] for row in ROWS])
def test_wrong_input_is_told_in_a_sentence(line: str, code: int, sentence: str) -> None:
    """What was wrong and what would be right, before anything is asked of a cell."""
    found = said(line)
    assert sentence in found[1]
    assert found[0] == code


@pytest.mark.parametrize(("line", "code", "sentence"), ROWS, ids=[row[0] for row in ROWS])
def test_wrong_input_is_said_in_our_words(line: str, code: int, sentence: str) -> None:
    """No box, no validator's English, no line for the programmer."""
    del sentence
    text = said(line)[1]
    for phrase in ("Input should", "Value error", "mistake(s)", "Aborted", "valid tuple", "Usage:"):
        assert phrase not in text
    assert code in EXITS


ERRORS: tuple[Exception, ...] = (
    ConfigError("cell.yaml", ["wrong"]),
    DataError("a.csv: wrong"),
    SetupError("no certificate for operator"),
    RefusedError("not_armed", "arm first"),
    BusError("no hub at tcp/127.0.0.1:9: is the cell up?"),
    ForcemeshError("off by 3 mm"),
    PermissionError(errno.EACCES, "Permission denied", "/closed/cell.yaml"),
)


@pytest.mark.parametrize("verb", [verb for verb in HAVE_A_CELL if verb not in ("demo", "up")])
@pytest.mark.parametrize("error", ERRORS, ids=[type(error).__name__ for error in ERRORS])
def test_each_error_has_one_exit_code_in_every_verb(
    verb: str, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table's, and one sentence, wherever it comes from."""

    def fails(*_args: Any, **_options: Any) -> Any:
        raise error

    for module in ("common.config.load", "forcemesh.client.cell"):
        monkeypatch.setattr(f"{module}.load_cell", fails, raising=False)
    code, text = said(f"{verb} {WORDS.get(verb, '')}")
    assert code == exit_code_of(error)
    what = "/closed/cell.yaml" if isinstance(error, OSError) else str(error)
    assert what in text


def test_a_mistake_in_the_demos_plan_names_the_demo_once() -> None:
    """The verb's word and the error's are the same."""
    assert said("demo --force 1e9")[1].startswith("demo: --force 1e+09: must be within")


def test_the_table_names_no_code_that_is_not_documented() -> None:
    """And what is more special stands before what is more general."""
    assert {code for _, code in TABLE} <= set(EXITS)
    for place, (kind, _) in enumerate(TABLE):
        assert not any(issubclass(kind, earlier) for earlier, _ in TABLE[:place])
    assert exit_code_of(RuntimeError()) == NOT_WELL


def test_every_verb_has_its_rows() -> None:
    """A verb that nobody has tried with wrong input is not finished."""
    without = [v for v in VERBS if not any(row[0].split("--")[0].startswith(v) for row in ROWS)]
    assert without == []
    assert {row[1] for row in ROWS} <= set(EXITS)


@pytest.mark.parametrize("verb", VERBS)
def test_an_option_that_is_none_is_named(verb: str) -> None:
    """With the nearest ones that there are."""
    code, text = said(f"{verb} {WORDS.get(verb, '')} --no-such-thing")
    assert code == USAGE
    assert "--no-such-thing" in text


@pytest.mark.parametrize("verb", HAVE_A_CELL)
def test_a_cell_file_that_is_not_there_is_named(verb: str) -> None:
    """Before anything is started."""
    code, text = said(f"{verb} {WORDS.get(verb, '')} --cell no-such-cell.yaml")
    assert code == USAGE
    assert "no-such-cell.yaml" in text
    assert "no such file" in text


@pytest.mark.realtime
@pytest.mark.parametrize("verb", [verb for verb in HAVE_A_CELL if verb not in NEEDS_NO_HUB])
def test_without_a_cell_that_is_up_the_next_step_is_told(verb: str) -> None:
    """Where it was looked for, and how to start it."""
    code, text = said(f"{verb} {WORDS.get(verb, '')}")
    assert code == NO_ANSWER
    assert "forcemesh up" in text


def test_a_mistake_of_forcemesh_itself_is_told_in_one_line(tmp_path: Path) -> None:
    """The page of code is for who asks for it."""
    program = (
        "import sys, cli.__main__ as program, typer\n"
        "def broken(): raise KeyError('oops')\n"
        "program.app.command('broken')(broken)\n"
        "sys.argv = ['forcemesh', 'broken']\n"
        "program.main()\n"
    )
    told = [
        subprocess.run(
            [sys.executable, "-c", program],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | variables,
        )
        for variables in ({}, {"FORCEMESH_TRACEBACK": "1"})
    ]
    assert [done.returncode for done in told] == [1, 1]
    assert told[0].stderr.count("\n") == 1
    assert "KeyError: 'oops'" in told[0].stderr
    assert "Traceback" in told[1].stderr


def test_the_page_about_the_command_line_is_that_of_the_program() -> None:
    """Every verb, option and exit code; made by `make readme`, never by hand."""
    assert PAGE.read_text(encoding="utf-8") == page(), "make readme"


@pytest.mark.parametrize("verb", ["status", "topics", "config show", "doctor"])
def test_what_is_for_programs_is_json_and_nothing_else(verb: str) -> None:
    """Standard output of a verb that only looks, cell or no cell."""
    done = CliRunner().invoke(app, [*verb.split(), "--json"])
    assert json.loads(done.stdout)


def test_the_demo_cell_is_what_these_tests_take_it_for() -> None:
    """A simulated arm, so that nothing here ever reaches for a real one."""
    assert load_cell(DEMO).roles.robot == "sim"
