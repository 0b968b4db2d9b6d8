"""Program of a cell's controller: forcemesh.as as it ships, or plain.as with the cell's numbers.

`python -m launch.controller_program cells/demo-plain.yaml > plain.as` writes the program to load
into a controller: no hello compares scales, so they are written by the cell file that needs them.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from common.config.cell import CellConfig
from common.config.load import load_cell
from controller import plain
from forcemesh.errors import ConfigError, ForcemeshError
from launch.run_file import writable_folder, write_atomically

SHIPPED = "controller/forcemesh.as"  # in the project's folder
_SAFE = Path(__file__).resolve().parent.parent / SHIPPED


class ControllerProgram(NamedTuple):
    """Text of a program, and the name to EXECUTE."""

    text: str
    start: str


def is_plain(cell: CellConfig) -> bool:
    """Return whether the cell's controller runs plain.as."""
    return cell.gateway is not None and cell.gateway.protocol == "plain"


def program_of(cell: CellConfig) -> ControllerProgram:
    """Return the program of a cell's controller."""
    if cell.gateway is None or not is_plain(cell):
        return ControllerProgram(_SAFE.read_text(encoding="ascii"), "fm.main")
    section = cell.gateway
    controller = plain.Controller(
        section.port,
        tuple(1e3 * each for each in cell.tool.T_flange_tcp.position_m),
        section.least_segment_s,
        1e3 * section.least_speed_m_s,
        tuple(cell.robot.joint_speed_max_deg_s),
    )
    text = plain.program(section.plain, controller)
    return ControllerProgram(text, plain.START)


def program_file(cell: CellConfig) -> str:
    """Return the file that the emulated controller of a cell executes; `write_program` makes it."""
    return str(writable_folder() / f"{cell.cell}-plain.as") if is_plain(cell) else SHIPPED


def write_program(cell: CellConfig) -> None:
    """Write the program of a cell's own numbers, if it has one."""
    if is_plain(cell):
        write_atomically(Path(program_file(cell)), program_of(cell).text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the program of a cell file; return the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        if len(given) != 1:
            raise ConfigError("launch.controller_program", ["one argument is needed: a cell file"])
        cell = load_cell(given[0])
        if cell.gateway is None:
            raise ConfigError(given[0], ["gateway: the section is missing"])
        sys.stdout.write(program_of(cell).text)
    except ForcemeshError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
