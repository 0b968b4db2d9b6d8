"""Verbs while no cell is up: usage, imports, tables."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from common.config.load import load_cell
from forcemesh import topics
from tests.fakes.verb_calls import run
from tools.tree import ROOT

pytestmark = pytest.mark.usefixtures("cell_file")


READ_VERBS = [
    ["status"],
    ["topics", "--schema"],
    ["watch", "wrench", "--count", "1"],
    ["config", "show"],
    ["hold"],
    ["payload", "fit", "--help"],
    ["--help"],
]


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


def output_of(variables: dict[str, str], *words: str) -> str:
    """Return the output of the program in an environment with these variables."""
    program = "import sys\nfrom cli.__main__ import main\nmain()"
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=ROOT,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout


def test_the_shell_completes_verbs_and_topics() -> None:
    """The environment is the one of `--install-completion`."""
    completion = {"_FORCEMESH_COMPLETE": "complete_bash", "COMP_CWORD": "2"}
    assert output_of({**completion, "COMP_WORDS": "forcemesh watch robot/st"}).split() == [
        "robot/state"
    ]
    assert output_of({**completion, "COMP_WORDS": "forcemesh force sto"}).split() == ["stop"]


def test_no_color_disables_colours() -> None:
    """It has precedence over a variable that requests colours."""
    colour = "\x1b[3"
    assert colour in output_of({"FORCE_COLOR": "1"}, "status")
    assert colour not in output_of({"FORCE_COLOR": "1", "NO_COLOR": "1"}, "status")
