"""The table of the bring-up against its page and the command line."""

import re
import shlex
from string import Formatter
from typing import Any

import pytest
import typer.main

from cli.__main__ import app
from cli.bringup.steps import BY_NAME, PAGE, STEPS, BringupStep
from common.config.cell import CellConfig
from common.config.evidence import PROGRAMS
from tools.tree import ROOT

TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
COMMANDS = sorted(set(re.findall(r"(?:`|^)forcemesh ([^`\n#]+)", TEXT, re.MULTILINE)))
FILES = ("probe", "calibration", "tuning")


def test_the_page_has_a_section_for_each_step_in_its_order() -> None:
    """With what to do, when it passes, and what to do if not."""
    parts = re.split(r"\n## (\d+)\. (\w+)\n", TEXT)
    numbers, names, sections = parts[1::3], parts[2::3], parts[3::3]
    assert list(names) == [step.name for step in STEPS]
    assert [int(number) for number in numbers] == list(range(1, len(STEPS) + 1))
    for section in sections:
        assert all(f"- **{word}**:" in section for word in ("Do", "Pass", "If not"))


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_every_command_of_a_step_is_on_the_page_and_on_the_command_line(step: BringupStep) -> None:
    """As it is run, without the options for programs."""
    root = typer.main.get_command(app)
    section = TEXT.split(f". {step.name}\n")[1].split("\n## ")[0]
    for command in step.commands:
        plain = command.replace("{yes}", "").replace(" --json", "")
        plain = plain.format(probe="cells/probe.yaml", tuning="cells/tuning.yaml")
        assert f"forcemesh {plain}" in section
        verb = root
        for word in shlex.split(plain):
            verb = getattr(verb, "commands", {}).get(word, verb)
        assert not hasattr(verb, "commands")
    assert ("The arm moves" in section or "the arm moves" in section) == step.moves


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_has_its_options(command: str) -> None:
    """A verb of the command line, and options that it has."""
    verb: Any = typer.main.get_command(app)
    words = shlex.split(command)
    while words and words[0] in getattr(verb, "commands", {}):
        verb = verb.commands[words.pop(0)]
    assert not hasattr(verb, "commands")
    options = {option for each in verb.params for option in each.opts}
    assert {word for word in words if word.startswith("--")} <= options


@pytest.mark.parametrize("name", ["network", "load", "probe", "start", "jog", "tune", "press"])
def test_another_controller_makes_a_step_due(name: str) -> None:
    """What was loaded into the one before or measured with it holds for that one alone."""
    assert {"gateway", "gateway.host"} & set(BY_NAME[name].inputs)


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_every_input_exists(step: BringupStep) -> None:
    """A file, or a section or field of the cell file; every step has a question or a command."""
    for name in step.inputs:
        section = name.split(".")[0]
        is_file = name in FILES or (PROGRAMS / name).is_file()
        assert is_file or section in CellConfig.model_fields, name
    assert step.commands or step.question
    assert step.remedy
    used = {name for text in (*step.commands, step.question)
            for _, name, _, _ in Formatter().parse(text) if name}  # fmt: skip
    assert used <= {"probe", "tuning", "yes", "host", "port", "arm"}
