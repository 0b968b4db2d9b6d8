"""Command line while no cell is up: usage, imports, tables, errors, numbers."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from cli.context import (
    NEXT_STEP,
    NO_ANSWER,
    NO_REPLY_STEP,
    NOT_WELL,
    PART_STEP,
    REFUSED,
    USAGE,
    one_line_errors,
)
from cli.numbers import POSE, parse_gain, parse_vector
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.errors import (
    BusError,
    ConfigError,
    DataError,
    ForcemeshError,
    LostError,
    NoHubError,
    RefusedError,
)
from tests.fakes.verb_calls import run
from tools.tree import ROOT

READ_VERBS = [["status"], ["topics", "--schema"], ["payload", "fit", "--help"]]


@pytest.mark.usefixtures("cell_file")
@pytest.mark.parametrize("words", READ_VERBS, ids=lambda words: words[0])
def test_a_verb_that_only_reads_loads_no_heavy_library(words: list[str]) -> None:
    """Physics, plots and panels are not imported: they take seconds and need libraries."""
    program = (
        "import sys\n"
        "from cli.__main__ import app\n"
        "try: app(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "heavy = {'mujoco', 'matplotlib', 'viser', 'mjviser', 'pinocchio', 'numpy'}\n"
        "print('loaded:', *(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr.splitlines()[-1] == "loaded:"


def test_the_command_line_loads_no_models_of_messages() -> None:
    """Every verb would pay for what the module of one verb imports: pydantic doubles the start."""
    program = "import sys, cli.__main__; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False).returncode == 0


def test_topics_are_the_table_with_the_rates_of_the_cell(cell_file: Path) -> None:
    """The list has exactly the rows of the table."""
    cell, table = load_cell(cell_file), json.loads(run("topics", "--json").stdout)
    assert [row["topic"] for row in table["topics"]] == [topic.key for topic in topics.TOPICS]
    assert [row["request"] for row in table["requests"]] == [r.key for r in topics.REQUESTS]
    for row, topic in zip(table["topics"], topics.TOPICS, strict=True):
        assert row["rate_hz"] == cell.rate_hz(topic)
        assert row["key"] == f"verbs/{topic.key}"
    text = run("topics").stdout
    assert all(topic.key in text for topic in topics.TOPICS)


@pytest.mark.usefixtures("cell_file")
def test_the_shell_completes_verbs_and_topics() -> None:
    """The environment is the one of `--install-completion`."""
    completion = {"_FORCEMESH_COMPLETE": "complete_bash", "COMP_CWORD": "2"}
    program = "import sys\nfrom cli.__main__ import main\nmain()"
    for words, expected in (("watch robot/st", "robot/state"), ("force sto", "stop")):
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=ROOT,
            env=os.environ | completion | {"COMP_WORDS": f"forcemesh {words}"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout.split() == [expected]


ROWS: tuple[tuple[Exception, int, str], ...] = (
    (ConfigError("cell.yaml", ["wrong"]), USAGE, "cell.yaml: wrong"),
    (DataError("a.mcap: no recording"), USAGE, "a.mcap: no recording"),
    (RefusedError("not_armed", "arm first"), REFUSED, "refused (not_armed): arm first"),
    (NoHubError("no hub: is the cell up?"), NO_ANSWER, f"no hub: is the cell up? {NEXT_STEP}\n"),
    (BusError("cannot listen on tcp/a:1"), NO_ANSWER, "cannot listen on tcp/a:1\n"),
    (LostError("no answer", ("arbiter",)), NO_ANSWER, f"no answer: {PART_STEP}\n"),
    (LostError("no silent role"), NO_ANSWER, f"no silent role: {NO_REPLY_STEP}\n"),
    (LostError("no answer", is_all=True), NO_ANSWER, f"no answer: {NEXT_STEP}\n"),
    (ForcemeshError("off by 3 mm"), NOT_WELL, "off by 3 mm"),
)


@pytest.mark.parametrize(("error", "code", "output"), ROWS, ids=[row[2] for row in ROWS])
def test_an_error_gives_its_message_and_exit_code(
    error: Exception, code: int, output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message comes first; each kind of error has its exit code."""
    with pytest.raises(typer.Exit) as caught, one_line_errors():
        raise error
    assert caught.value.exit_code == code
    assert capsys.readouterr().err.startswith(output)


numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(numbers, min_size=6, max_size=6), st.sampled_from([",", ", ", " ,"]))
def test_six_numbers_are_read_exactly(values: list[float], comma: str) -> None:
    """No number is lost or reordered, for all signs and spaces."""
    assert parse_vector(comma.join(map(repr, values)), POSE) == tuple(values)


@given(st.floats(min_value=0.0, allow_infinity=False))
def test_one_gain_applies_to_all_axes(gain: float) -> None:
    """One number stands for three equal ones."""
    assert parse_gain(repr(gain), "m/N") == (gain, gain, gain)
