"""The program of a cell's controller: as it ships, or with the numbers of the cell file."""

import re
from pathlib import Path

from common.config.load import load_cell
from controller.plain import PROGRAM, START
from launch.controller_program import (
    SHIPPED,
    is_plain,
    program_file,
    program_of,
    write_program,
)
from launch.processes import EMULATOR, processes_of
from launch.run_file import FOLDER_VARIABLE
from sim.as_language.parser import parse
from tools.tree import ROOT

CELLS = ROOT / "cells"
PLAIN, TCP, SIM = (load_cell(CELLS / f"{name}.yaml") for name in ("demo-plain", "demo-tcp", "demo"))


def test_protocol_plain_has_the_numbers_of_its_cell() -> None:
    """Scales, width, port and the tool centre point in the flange frame [mm]."""
    text, start = program_of(PLAIN)
    assert start == START
    assert start in parse(text).programs
    numbers = dict(re.findall(r"(?m)^  pl\.(\w+)=(\S+) ?", text))
    expected = {"sp": "98", "so": "500", "sj": "250", "si": "5000", "sg": "100000", "tz": "160"}
    assert expected.items() <= numbers.items()
    assert text != PROGRAM.read_text(encoding="ascii")


def test_the_emulated_controller_executes_the_program_of_its_cell(tmp_path, monkeypatch) -> None:
    """Written into the run file's folder when the cell starts; a cell of ours writes nothing."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    for cell in (PLAIN, TCP):
        (emulator,) = (each for each in processes_of(cell) if each.module == EMULATOR)
        assert emulator.arguments == (program_file(cell),)
        write_program(cell)
    assert Path(program_file(PLAIN)).read_text(encoding="ascii") == program_of(PLAIN).text
    assert [path.name for path in tmp_path.iterdir()] == ["demo-plain-plain.as"]
    assert program_of(TCP) == ((ROOT / SHIPPED).read_text(encoding="ascii"), "fm.main")
    assert (is_plain(PLAIN), is_plain(TCP), is_plain(SIM)) == (True, False, False)
