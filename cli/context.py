"""What every verb needs: its cell, the way onto the bus, one line and an exit code for trouble."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn, TypeVar

import typer

if TYPE_CHECKING:
    from rich.status import Status

    from common.cell import Cell as CellFile
    from common.client import Cell
    from common.endpoints import Bus
    from common.messages import Record
    from common.requests import Reply
    from common.topics import Request

Q = TypeVar("Q", bound="Record")

OK, NOT_WELL, USAGE, REFUSED, NO_ANSWER, INTERRUPTED = 0, 1, 2, 3, 4, 130
EXITS = {
    OK: "done and well",
    NOT_WELL: "not well: a process died, a role is silent, a move did not get there",
    USAGE: "wrong usage, or a file that cannot be used",
    REFUSED: "refused, with the reason",
    NO_ANSWER: "no answer: the cell is not up, or does not say what was waited for",
    INTERRUPTED: "interrupted; what moved was asked to hold",
}
EXIT_CODES = f"Exit codes: {'; '.join(f'{code} {meaning}' for code, meaning in EXITS.items())}."
CELL_VARIABLE = "FORCEMESH_CELL"
DEFAULT_CELL = Path("cells/demo.yaml")
NEXT_STEP = "`forcemesh up` starts it, `forcemesh status` says what is missing."
PART_STEP = (
    "the cell is up, and a part of it is dead or stands still. `forcemesh status` says which; "
    "end `forcemesh up` and start it anew."
)
UNHEARD_STEP = (
    "a request goes unheard where this PC's certificate may only look (a monitor's), and where a "
    "helper is missing: `forcemesh status` shows every process."
)
PATIENCE_S = 1.0  # with the hub: a cell that is up answers at once

CellOption = Annotated[
    Path | None,
    typer.Option(
        "--cell",
        envvar=CELL_VARIABLE,
        metavar="FILE",
        help="Cell file; without it the cell that is up, else cells/demo.yaml.",
        show_default=False,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="For programs: JSON on standard output.")]


def default_cell_file() -> Path:
    """Return cells/demo.yaml, here or in the project's folder."""
    if DEFAULT_CELL.exists():
        return DEFAULT_CELL
    return Path(__file__).resolve().parent.parent / DEFAULT_CELL


def find_cell_file(named: Path | None, *, ended: bool = False) -> Path:
    """Return the cell file that a verb is about: the named one, else that of the cell that is up.

    Args:
        named: What the user named, if anything.
        ended: Whether a cell whose run has ended with a death may be meant, too.
    """
    if named is not None:
        return named
    from cli.runfile import read_runs

    runs = read_runs()
    live = [run for run in runs if run.live]
    if len(live) > 1:
        names = ", ".join(f"{run.cell} ({run.cell_file})" for run in live)
        fail(f"several cells are up: {names}; choose one with --cell", USAGE)
    found = live or [run for run in runs if ended and Path(run.cell_file).exists()]
    return Path(found[0].cell_file) if found else default_cell_file()


def live_cell(named: Path | None, *, ended: bool = False) -> "CellFile":
    """Return the cell that a verb is to talk to, whatever is being done to its file meanwhile.

    A cell that is up here is as `up` has read it: a hold must not wait for a text editor. One that
    is up elsewhere can be told to hold without its calibration, should only that be wrong.

    Args:
        named: As `find_cell_file`.
        ended: As `find_cell_file`.

    Raises:
        ConfigError: The file is wrong, and the cell is not up here.
    """
    from pydantic import ValidationError

    from cli.runfile import read_runs
    from common.cell import Cell
    from common.config import load_cell
    from common.errors import ConfigError

    path = find_cell_file(named, ended=ended)
    for run in read_runs():
        if run.live and run.cell_file == str(path.resolve()):
            with suppress(ValidationError):  # of another version, which keeps cells in another form
                return Cell.model_validate_json(run.as_started)
    try:
        return load_cell(path)
    except ConfigError as error:
        with suppress(ConfigError):
            cell = load_cell(path, {"calibration": None})
            typer.echo(f"{error}\nthe cell is taken without its calibration", err=True)
            return cell
        raise


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn every error that forcemesh raises on purpose into one line and an exit code."""
    from pydantic import ValidationError

    from common.errors import (
        BusError,
        ConfigError,
        DataError,
        ForcemeshError,
        LostError,
        RefusedError,
        first_mistake,
    )

    try:
        yield
    except (ConfigError, DataError) as error:
        fail(str(error), USAGE)
    except ValidationError as error:  # of a request, before it was sent
        fail(first_mistake(error).text, USAGE)
    except RefusedError as error:
        fail(f"refused ({error.code}): {error}", REFUSED)
    except LostError as error:
        step = NEXT_STEP if error.is_all else PART_STEP if error.roles else UNHEARD_STEP
        fail(f"{error}: {step}", NO_ANSWER)
    except BusError as error:
        is_away = str(error).endswith("is the cell up?")
        fail(f"{error} {NEXT_STEP}" if is_away else str(error), NO_ANSWER)
    except ForcemeshError as error:
        fail(str(error), NOT_WELL)


def fail(text: str, code: int) -> NoReturn:
    """Say what is wrong on standard error and end with an exit code."""
    typer.echo(text, err=True)
    raise typer.Exit(code)


@contextmanager
def cell_of(named: Path | None) -> "Iterator[Cell]":
    """Connect a person to the cell that a verb is about; an error becomes one line and a code."""
    from common.client import Cell

    with (
        one_line_errors(),
        Cell(live_cell(named), commander="operator", patience_s=PATIENCE_S) as cell,
    ):
        yield cell


def tell(reply: "Reply") -> None:
    """Print what a service answered."""
    typer.echo(reply.text or "accepted")


@contextmanager
def waiting(text: str) -> "Iterator[Status]":
    """Show on standard error, where it is a terminal, that something takes its time."""
    from rich.console import Console

    with Console(stderr=True).status(text) as live:
        yield live


@contextmanager
def client_of(named: Path | None) -> "Iterator[tuple[CellFile, Bus]]":
    """Connect as `cell_of` does; for verbs that speak to the bus itself."""
    with cell_of(named) as cell:
        yield cell.config, cell.session.bus


def ask(bus: "Bus", request: "Request[Q]", message: Q) -> "Reply":
    """Send a request and print the answer. Raise RefusedError when it is refused."""
    from common.client.asking import ask as ask_once

    reply = ask_once(bus, request, message)
    tell(reply)
    return reply
