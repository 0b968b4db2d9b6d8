# ruff: noqa: E501 - a table, read row by row
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
from cli.context import CELL_VARIABLE, EXITS, NO_ANSWER, NOT_WELL, TABLE, USAGE, exit_code_of
from forcemesh.errors import (
    ConfigError,
    NoHubError,
    SetupError,
)
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.run_file import FOLDER_VARIABLE
from tests.fakes.bench import DEMO
from tools.cli_page import page, walk
from tools.tree import ROOT

# Wrong input, and a sentence of the message. BAD stands for a file with wrong content, HERE for a file
# that exists, NOWHERE for none.
HEADER = "column t is missing; the header must be t,x,y,z,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz"
# fmt: off
ROWS: tuple[tuple[str, str], ...] = (
    ("retract far", "must be a number"),
    ("retract 201", "must be at most 200"),
    ("retract --speed 51", "must be at most 50"),
    ("speed --accel 0", "must be at least 0.1"),
    ("move to 1,2,3", "6 numbers are needed, X,Y,Z,O,A,T (mm and degrees), without spaces; found 3"),
    ("move by a,0,0,0,0,0", "J1 is not a number: 'a'"),
    ("move by 1,0,0,0,0,0 --as regulator", "'regulator' is not one of 'operator', 'program'"),
    ("move by 1000000,0,0,0,0,0", "J1 must be within 5000 degrees, found 1e+06"),
    ("move to 1e9,0,0,0,0,0", "pose.position_m.0: must be at most 100 m"),
    ("jog j1 1e9", "BY must be within 5000 degrees, found 1e+09"),
    ("jog rx 1e9", "BY must be within 5000 degrees, found 1e+09"),
    ("jog w 10", "unknown axis 'w': choose from x, y, z, rx, ry, rz, j1, j2, j3, j4, j5, j6"),
    ("force start --setpoint -5", "must be at least 0"),
    ("force start --axes q", "--axes: unknown axis q: choose from x, y, z, rx, ry, rz"),
    ("force start --axes z=push", "control 'push' must be one of held, force, torque"),
    ("force start --axes z=force:5 --setpoint 5", "holds the set points: omit --setpoint and --mode"),
    ("force start --frame sensor", '--frame sensor: needs --axes "NAME=CONTROL ..."'),
    ("force start --law iron", "must be plain or adaptive, found 'iron'"),
    ("forecast 2", "no forecast: set point is 2 N, measured were"),
    ("force gains --force-p 1,2", "3 numbers are needed, x,y,z (m/N), without spaces; found 2"),
    ("force gains --torque-i -1", "a gain is zero or positive"),
    ("signals set a_name_that_is_far_longer_than_any_signal_has on", "signal"),
    ("status --service robots", "unknown role 'robots': choose from hub, robot, sensor"),
    ("watch wrenches", "unknown topic 'wrenches': did you mean wrench?"),
    ("config check NOWHERE", "no such file"),
    ("config check BAD", "the file must hold a map of sections"),
    ("config init HERE", "exists already: choose another name"),
    ("demo --force -5", "--force -5: must be within 5 .. 40 N"),
    ("calibrate --manual --verify-only", "--manual and --verify-only cannot be combined: choose one"),
    ("calibrate --verify-poses 0", "--verify-poses 0 requires --manual"),
    ("calibrate --poses 2", "must be at least 6"),
    ("calibrate --auto-capture", "--auto-capture requires --manual"),
    ("calibrate --speed 900", "--speed 900: limits.speed_m_s allows 250 mm/s"),
    ("calibrate --from NOWHERE", "cannot be read: No such file or directory"),
    ("calibrate --from BAD", HEADER),
    ("payload check BAD", "Missing option '--payload'"),
    ("pki issue other", "unknown name 'other': choose from hub, robot, sensor"),
    ("guide --record HERE", "file exists: choose another name, or --overwrite"),
    ("touch --force 0", "must be at least 0.5"),
    ("align --force 1", "must be at least 5"),
    ("touch --repeat 2 --back 0", "--back 0: repeated touches need a distance to retract"),
    ("guide --record a --playback b", "cannot be combined"),
    ("report NOWHERE", "cannot be read: No such file or directory"),
    ("report BAD", "no column is certainly the time: name it with --time; the columns are: not, a, recording"),
    ("report BAD -o BAD", "is the file that is read: choose another name"),
    ("report BAD --topic ft", "--topic ft: a text file has no topics"),
    ("report HERE", "a log of another robot is .csv, .tsv, .txt, .dat, .log or .mcap"),
    ("export BAD", "not a forcemesh recording, or truncated"),
    ("replay BAD", "not a forcemesh recording"),
    ("bringup --again fly", "--again fly: no such step; there are network"),
    ("bringup", "has no section `gateway`"),
    ("probe", "gateway: the section is missing"),
    ("probe --out .", "--out .: is a folder; name a file"),
    ("move sideways", "No such command 'sideways'"),
)
# fmt: on
PASSES_ON = ("bench force",)  # passes all arguments to a program with a parser of its own
VERBS: dict[str, Any] = {
    name.removeprefix("forcemesh "): verb
    for name, verb in walk(typer.main.get_command(app))
    if name.removeprefix("forcemesh ") not in PASSES_ON
}
HAVE_A_CELL = [v for v, c in VERBS.items() if "cell" in {each.name for each in c.params}]
# Arguments with which each verb gets as far as the cell.
WORDS = {
    "move to": "0,0,0,0,0,0",
    "move joints": "0,0,0,0,0,0",
    "move by": "0,0,0,0,0,0",
    "jog": "x 1",
    "press": "15",
    "forecast": "15",
    "signals set": "lamp on",
    "signals wait": "lamp",
    "follow": "HERE",
    "pki issue": "operator",
}
NEEDS_NO_HUB = (
    *("topics", "config show", "forecast", "pki init", "pki check", "pki issue"),
    *("status", "demo", "up", "probe", "bringup"),  # tested elsewhere
)


@pytest.fixture(autouse=True)
def no_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with some files, without a running cell."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setenv(CELL_VARIABLE, str(DEMO))
    monkeypatch.setenv(ENDPOINT_VARIABLE, "tcp/127.0.0.1:9")  # no process listens there
    monkeypatch.setattr("cli.context.CONNECT_PATIENCE_S", 0.0)
    (tmp_path / "here.yaml").write_text("")
    (tmp_path / "bad.csv").write_text("not,a,recording\n")


def output_of(line: str) -> tuple[int, str]:
    """Run a command line; return exit code and output, without frames and line breaks."""
    for word, name in (("NOWHERE", "nowhere.csv"), ("BAD", "bad.csv"), ("HERE", "here.yaml")):
        line = line.replace(word, name)
    done = CliRunner().invoke(app, shlex.split(line))
    text = re.sub(r"[│╭╮╰╯─]", " ", done.output)
    assert done.exception is None or isinstance(done.exception, SystemExit), repr(done.exception)
    assert "Traceback" not in text
    return done.exit_code, " ".join(text.split())


@pytest.mark.parametrize(("line", "sentence"), ROWS, ids=[row[0] for row in ROWS])
def test_wrong_input_is_reported_in_a_sentence(line: str, sentence: str) -> None:
    """The error and the remedy, before any request: no box, no validator's text, no usage line."""
    found, text = output_of(line)
    assert sentence in text
    assert found == USAGE
    for phrase in ("Input should", "Value error", "mistake(s)", "Aborted", "valid tuple", "Usage:"):
        assert phrase not in text


ERRORS: tuple[Exception, ...] = (
    ConfigError("cell.yaml", ["wrong"]),
    SetupError("no certificate for operator"),
    NoHubError("no hub at tcp/127.0.0.1:9: is the cell up?"),
    PermissionError(errno.EACCES, "Permission denied", "/closed/cell.yaml"),
)


@pytest.mark.parametrize("verb", [verb for verb in HAVE_A_CELL if verb not in ("demo", "up")])
@pytest.mark.parametrize("error", ERRORS, ids=[type(error).__name__ for error in ERRORS])
def test_each_error_has_one_exit_code_in_every_verb(
    verb: str, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exit code is that of the table, with one sentence, for each origin of the error."""

    def fails(*_args: Any, **_options: Any) -> Any:
        raise error

    for module in ("common.config.load", "forcemesh.client.cell"):
        monkeypatch.setattr(f"{module}.load_cell", fails, raising=False)
    code, text = output_of(f"{verb} {WORDS.get(verb, '')}")
    assert code == exit_code_of(error)
    sentence = "/closed/cell.yaml" if isinstance(error, OSError) else str(error)
    assert sentence in text


def test_the_table_has_only_documented_codes() -> None:
    """More specific errors precede more general ones."""
    assert {code for _, code in TABLE} <= set(EXITS)
    for place, (kind, _) in enumerate(TABLE):
        assert not any(issubclass(kind, earlier) for earlier, _ in TABLE[:place])
    assert exit_code_of(RuntimeError()) == NOT_WELL


@pytest.mark.parametrize("verb", VERBS)
def test_an_unknown_option_is_named(verb: str) -> None:
    """The error names the unknown option."""
    code, text = output_of(f"{verb} {WORDS.get(verb, '')} --no-such-thing")
    assert code == USAGE
    assert "--no-such-thing" in text


@pytest.mark.parametrize("verb", HAVE_A_CELL)
def test_a_missing_cell_file_is_named(verb: str) -> None:
    """Before anything is started."""
    code, text = output_of(f"{verb} {WORDS.get(verb, '')} --cell no-such-cell.yaml")
    assert code == USAGE
    assert "no-such-cell.yaml" in text
    assert "no such file" in text


@pytest.mark.realtime
@pytest.mark.parametrize("verb", [verb for verb in HAVE_A_CELL if verb not in NEEDS_NO_HUB])
def test_without_a_running_cell_the_next_step_is_printed(verb: str) -> None:
    """The message gives the endpoint and the command that starts the cell."""
    code, text = output_of(f"{verb} {WORDS.get(verb, '')}")
    assert code == NO_ANSWER
    assert "tcp/127.0.0.1:9" in text
    assert "forcemesh up" in text


def test_an_internal_error_is_one_line() -> None:
    """The traceback is printed only on request."""
    program = (
        "import sys, cli.__main__ as program, typer\n"
        "def broken(): raise KeyError('oops')\n"
        "program.app.command('broken')(broken)\n"
        "sys.argv = ['forcemesh', 'broken']\n"
        "program.main()\n"
    )
    command = [sys.executable, "-c", program]
    for traceback in ("", "1"):
        env = os.environ | {"FORCEMESH_TRACEBACK": traceback}
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, check=False, env=env
        )
        assert done.returncode == 1
        assert ("Traceback" in done.stderr) == bool(traceback)
        assert traceback or (done.stderr.count("\n"), "KeyError: 'oops'" in done.stderr) == (
            1,
            True,
        )


def test_the_page_of_the_command_line_has_every_verb_option_and_exit_code() -> None:
    """Each verb is a heading, each of its options a row below it."""
    text = page()
    for code, meaning in EXITS.items():
        assert f"| {code} | {meaning} |" in text
    for verb, command in walk(typer.main.get_command(app)):
        name = verb.removeprefix("forcemesh ")
        section = text.split(f"\n## {name}\n")[1].split("\n## ")[0]
        options = [opt for each in command.params for opt in each.opts if opt.startswith("--")]
        assert [opt for opt in options if opt != "--help" and f"`{opt}`" not in section] == []


@pytest.mark.parametrize("verb", ["status", "topics", "config show", "doctor"])
def test_output_for_programs_is_only_json(verb: str) -> None:
    """It is the standard output of a verb that only reads, with or without a cell."""
    done = CliRunner().invoke(app, [*verb.split(), "--json"])
    assert json.loads(done.stdout)
