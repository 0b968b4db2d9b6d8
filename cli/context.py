"""What every verb needs: its cell, the way onto the bus, one line and an exit code for trouble."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn, TypeVar

import typer

from cli.exits import (
    EXITS,
    INTERRUPTED,
    NO_ANSWER,
    NOT_WELL,
    OK,
    REFUSED,
    USAGE,
    exit_code_of,
)

if TYPE_CHECKING:
    from rich.status import Status

    from common.bus.configured_cell import ConfiguredCell
    from common.config.cell import Cell as CellFile
    from forcemesh.bus import Bus
    from forcemesh.errors import ForcemeshError
    from forcemesh.messages import Record
    from forcemesh.requests import Reply
    from forcemesh.topics import Request

Q = TypeVar("Q", bound="Record")

__all__ = (
    "EXITS",
    "INTERRUPTED",
    "NOT_WELL",
    "NO_ANSWER",
    "OK",
    "REFUSED",
    "USAGE",
    "exit_code_of",
)

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
    from launch.run_file import read_runs

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

    from common.config.cell import Cell
    from common.config.load import load_cell
    from forcemesh.errors import ConfigError
    from launch.run_file import read_runs

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

    from forcemesh.errors import ForcemeshError, first_mistake

    try:
        yield
    except ValidationError as error:  # of a request, before it was sent
        fail(first_mistake(error).text, USAGE)
    except ForcemeshError as error:
        fail(sentence_of(error), exit_code_of(error))


def sentence_of(error: "ForcemeshError") -> str:
    """Return what a person is told of an error, with the next step where it is always the same."""
    from forcemesh.errors import BusError, LostError, RefusedError

    if isinstance(error, RefusedError):
        return f"refused ({error.code}): {error}"
    if isinstance(error, LostError):
        step = NEXT_STEP if error.is_all else PART_STEP if error.roles else UNHEARD_STEP
        return f"{error}: {step}"
    if isinstance(error, BusError) and str(error).endswith("is the cell up?"):
        return f"{error} {NEXT_STEP}"
    return str(error)


def answers_yes(question: str) -> bool:
    """Ask a person yes or no on the terminal; the end of input is no answer, and so a no."""
    try:
        return typer.confirm(question, err=True)
    except typer.Abort as error:
        if isinstance(error.__context__, KeyboardInterrupt):
            fail("\ninterrupted: nothing was moved", INTERRUPTED)
        typer.echo("\nno answer on standard input; --yes answers beforehand", err=True)
        return False


def fail(text: str, code: int) -> NoReturn:
    """Say what is wrong on standard error and end with an exit code."""
    typer.echo(text, err=True)
    raise typer.Exit(code)


@contextmanager
def cell_of(named: Path | None) -> "Iterator[ConfiguredCell]":
    """Connect a person to the cell that a verb is about; an error becomes one line and a code."""
    from common.bus.configured_cell import ConfiguredCell

    with (
        one_line_errors(),
        ConfiguredCell(live_cell(named), commander="operator", patience_s=PATIENCE_S) as cell,
    ):
        yield cell


def confirmed(question: str, *, yes: bool) -> None:
    """Ask a person whether something may be done; end the verb when it may not.

    Args:
        question: What will happen.
        yes: Whether the answer was given with the verb.
    """
    if not yes and not answers_yes(question):
        fail("not done: it was not confirmed (--yes confirms it without a question)", REFUSED)


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
    from forcemesh.client.ask import ask as ask_once

    reply = ask_once(bus, request, message)
    tell(reply)
    return reply
