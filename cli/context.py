"""Common parts of the verbs: cell file, bus connection, errors as one line and an exit code.

One table of exceptions gives the exit codes of all verbs.
"""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

from typer import Abort, Exit, Option, confirm, echo

from forcemesh.errors import (
    BusError,
    ConfigError,
    DataError,
    ForcemeshError,
    LostError,
    NoHubError,
    RefusedError,
    SetupError,
)
from forcemesh.requests import Reply

if TYPE_CHECKING:
    from rich.status import Status

    from common.bus.configured_cell import ConfiguredCell
    from common.config.cell import CellConfig as CellFile

OK, NOT_WELL, USAGE, REFUSED, NO_ANSWER, INTERRUPTED = 0, 1, 2, 3, 4, 130
EXITS = {
    OK: "success",
    NOT_WELL: "failure: a process died, a role is silent, a move did not reach its target",
    USAGE: "wrong usage, or an invalid file or certificate",
    REFUSED: "refused, with the reason",
    NO_ANSWER: "no reply: the cell is not up, or an expected message did not arrive",
    INTERRUPTED: "interrupted; a hold was requested for a moving arm",
}
TABLE: tuple[tuple[type[BaseException], int], ...] = (  # the first row that fits counts
    (ConfigError, USAGE),
    (DataError, USAGE),
    (SetupError, USAGE),
    (RefusedError, REFUSED),
    (BusError, NO_ANSWER),
    (ForcemeshError, NOT_WELL),
    (OSError, USAGE),
    (KeyboardInterrupt, INTERRUPTED),
)
EXIT_CODES = f"Exit codes: {'; '.join(f'{code} {meaning}' for code, meaning in EXITS.items())}."
CELL_VARIABLE = "FORCEMESH_CELL"
DEFAULT_CELL = Path("cells/demo.yaml")
NEXT_STEP = "`forcemesh up` starts it, `forcemesh status` shows what is missing."
PART_STEP = (
    "the cell is up, but a process of it is dead or does not respond. `forcemesh status` shows "
    "which; restart `forcemesh up`."
)
NO_REPLY_STEP = (
    "requests get no reply with a read-only certificate (monitor), or while a helper process is "
    "missing: `forcemesh status` shows every process."
)
CONNECT_PATIENCE_S = 1.0  # connection timeout; a running hub replies at once

CellOption = Annotated[
    Path | None,
    Option(
        "--cell",
        envvar=CELL_VARIABLE,
        metavar="FILE",
        help="Cell file; default: the running cell, else cells/demo.yaml.",
    ),
]
JsonOption = Annotated[bool, Option("--json", help="Print JSON on standard output.")]


def exit_code_of(error: BaseException) -> int:
    """Return the exit code of a verb that ends with an exception."""
    return next((code for kind, code in TABLE if isinstance(error, kind)), NOT_WELL)


def default_cell_file() -> Path:
    """Return cells/demo.yaml of the working directory, else of the project folder."""
    if DEFAULT_CELL.exists():
        return DEFAULT_CELL
    return Path(__file__).resolve().parent.parent / DEFAULT_CELL


def find_cell_file(named: Path | None, *, ended: bool = False) -> Path:
    """Return the cell file of a verb: the named one, else that of the running cell.

    Args:
        named: File named by the user, if any.
        ended: Whether a cell that has ended with the death of a process counts.
    """
    if named is not None:
        return named
    from launch.run_file import read_runs

    runs = read_runs()
    live = [run for run in runs if run.live]
    if len(live) > 1:
        names = ", ".join(f"{run.cell} ({run.cell_file})" for run in live)
        exit_with_error(f"several cells are up: {names}; choose one with --cell")
    found = live or [run for run in runs if ended and Path(run.cell_file).exists()]
    return Path(found[0].cell_file) if found else default_cell_file()


def live_cell(named: Path | None, *, ended: bool = False) -> "CellFile":
    """Return the cell of a verb, unaffected by edits of its file while it is up.

    A cell that is up on this PC is as `up` has read it: a hold must not fail because of an edit.
    A cell on another PC is loaded without its calibration if only that is invalid.

    Args:
        named: As `find_cell_file`.
        ended: As `find_cell_file`.

    Raises:
        ConfigError: The file is invalid, and the cell is not up on this PC.
    """
    from pydantic import ValidationError

    from common.config.cell import CellConfig
    from common.config.load import load_cell
    from launch.run_file import read_runs

    path = find_cell_file(named, ended=ended)
    for run in read_runs():
        if run.live and run.cell_file == str(path.resolve()):
            with suppress(ValidationError):  # written by another version in another format
                return CellConfig.model_validate_json(run.as_started)
    try:
        return load_cell(path)
    except ConfigError as error:
        with suppress(ConfigError):
            cell = load_cell(path, {"calibration": None})
            print_note(f"{error}\ncontinuing without the calibration")
            return cell
        raise


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Convert every error that forcemesh raises on purpose to one line and an exit code."""
    try:
        yield
    except ForcemeshError as error:
        exit_with_error(sentence_of(error), exit_code_of(error))


def sentence_of(error: ForcemeshError) -> str:
    """Return the text of an error, with the remedy where it is always the same."""
    if isinstance(error, RefusedError):
        return f"refused ({error.code}): {error}"
    if isinstance(error, LostError):
        step = NEXT_STEP if error.is_all else PART_STEP if error.roles else NO_REPLY_STEP
        return f"{error}: {step}"
    if isinstance(error, NoHubError):
        return f"{error} {NEXT_STEP}"
    return str(error)


def print_note(text: str) -> None:
    """Print a text on standard error: a note, a warning, an error."""
    echo(text, err=True)


def answers_yes(question: str, interruption: str = "interrupted: nothing was moved") -> bool:
    """Ask for confirmation on the terminal; end of input counts as no.

    Args:
        question: What is to be confirmed.
        interruption: Printed at Ctrl-C, which ends the verb.
    """
    try:
        return confirm(question, err=True)
    except Abort as error:
        if isinstance(error.__context__, KeyboardInterrupt):
            exit_with_error(f"\n{interruption}", INTERRUPTED)
        print_note("\nno reply on standard input; --yes confirms without a question")
        return False


def exit_with_error(text: str, code: int = USAGE) -> NoReturn:
    """Print an error on standard error and end with an exit code, by default of wrong usage."""
    print_note(text)
    raise Exit(code)


@contextmanager
def cell_of(named: Path | None) -> "Iterator[ConfiguredCell]":
    """Connect to the cell of a verb as operator; convert errors to one line and an exit code."""
    from common.bus.configured_cell import ConfiguredCell

    with (
        one_line_errors(),
        ConfiguredCell(
            live_cell(named),
            commander="operator",
            patience_s=CONNECT_PATIENCE_S,
            client=name_of_this_user(),
        ) as cell,
    ):
        yield cell


def name_of_this_user() -> str:
    """Return user and host: what one verb starts, the next one of the same person may change."""
    return f"user {os.getuid()} at {socket.gethostname()}"


def confirmed(question: str, *, yes: bool) -> None:
    """Ask for confirmation; end the verb without it.

    Args:
        question: What will happen.
        yes: Whether it was confirmed by an option.
    """
    if not yes and not answers_yes(question):
        exit_with_error("cancelled: not confirmed (--yes confirms without a question)", REFUSED)


def print_reply(reply: "Reply") -> None:
    """Print the reply of a service."""
    echo(reply.text or "accepted")


def waiting(text: str) -> "Status":
    """Return a status line on standard error, shown within its context if it is a terminal."""
    from rich.console import Console

    return Console(stderr=True).status(text)
