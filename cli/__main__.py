"""Command line `forcemesh`: thin verbs that import their dependencies at run time.

A verb that fails ends with one sentence and an exit code. Typer prints usage errors in a box with
its validator's text; here they read like cell file errors.
"""

import os
import sys
from collections.abc import Sequence
from functools import partial
from types import TracebackType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from cli import (
    config_verbs,
    payload,
    pki,
    verbs_arm,
    verbs_force,
    verbs_move,
    verbs_read,
    verbs_run,
    verbs_watch,
)
from cli.calibration.verb import calibrate
from cli.check_axes.verb import check
from cli.context import EXIT_CODES, INTERRUPTED, OK, exit_code_of
from cli.demo.verb import demo
from cli.doctor.verb import doctor
from cli.export import export, report
from cli.numbers import NEGATIVE_NUMBERS
from cli.panel import panel
from cli.record import record
from cli.replay import replay
from cli.skills import verbs as skills
from cli.tune.verb import tune
from forcemesh.errors import ForcemeshError, first_mistake


class OneSentence(TyperGroup):
    """Root of the command line; prints at most one sentence for an error."""

    def main(  # noqa: PLR0917 -- the signature is the base class's
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a verb; end the process with its exit code, after at most one sentence."""
        run = partial(
            super().main, args, prog_name, complete_var, False, windows_expand_args, **extra
        )
        if not standalone_mode:
            return run()
        try:
            code = run()
        except TyperException as error:
            _print_error(_usage(error))
            sys.exit(error.exit_code)
        except typer.Abort:
            _print_error("interrupted: nothing was executed")
            sys.exit(INTERRUPTED)
        except ForcemeshError as error:
            _print_error(str(error))
            sys.exit(exit_code_of(error))
        except OSError as error:
            if error.filename is None:
                raise
            _print_error(f"{error.filename}: cannot be used: {error.strerror}")
            sys.exit(exit_code_of(error))
        sys.exit(code if isinstance(code, int) else OK)


def _usage(error: TyperException) -> str:
    """Return the text of a usage error, in the style of the other errors, with a help command."""
    from pydantic import ValidationError

    if isinstance(error.__cause__, ValidationError):
        error.message = first_mistake(error.__cause__).text
    context = getattr(error, "ctx", None)
    text = error.format_message().rstrip(".")
    if context is None or "Usage:" in text:
        return text
    end = "" if text.endswith("?") else ";"
    return f"{text}{end} see `{context.command_path} --help`"


def _print_error(text: str) -> None:
    typer.echo(text, err=True)


app = typer.Typer(
    cls=OneSentence,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # units in square brackets are text
    epilog=EXIT_CODES,
    help="Open force control for Kawasaki arms. This is not a safety function.",
)

RUN, STATUS, MOVE, FORCE = "Cell", "Status", "Motion", "Force"
RECORD = "Recordings"

app.command(rich_help_panel=RUN)(demo)
app.command(rich_help_panel=RUN)(verbs_run.up)
app.command(rich_help_panel=STATUS)(panel)
app.add_typer(record, name="record", rich_help_panel=RECORD)
app.command(rich_help_panel=RECORD)(replay)
app.command(rich_help_panel=RECORD)(export)
app.command(rich_help_panel=RECORD)(report)
app.add_typer(config_verbs.config, name="config", rich_help_panel=RUN)
app.add_typer(pki.app, name="pki", rich_help_panel=RUN)
app.command(rich_help_panel=STATUS)(verbs_read.status)
app.command(rich_help_panel=STATUS)(doctor)
app.command(rich_help_panel=STATUS)(verbs_read.topics)
app.command(rich_help_panel=STATUS)(verbs_watch.watch)
app.command(rich_help_panel=MOVE)(verbs_arm.arm)
app.command("back-off", rich_help_panel=MOVE)(verbs_arm.back_off)
app.command(rich_help_panel=MOVE)(verbs_arm.hold)
app.command(rich_help_panel=MOVE)(verbs_arm.clear)
app.add_typer(verbs_move.move, name="move", rich_help_panel=MOVE)
app.command(rich_help_panel=MOVE, context_settings=NEGATIVE_NUMBERS)(verbs_move.jog)
app.command(rich_help_panel=MOVE)(verbs_move.retract)
app.command(rich_help_panel=MOVE)(verbs_arm.speed)
app.add_typer(verbs_force.force, name="force", rich_help_panel=FORCE)
skills.add_to(app, "Skills")
app.command(rich_help_panel=FORCE)(verbs_force.tare)
app.command(rich_help_panel=FORCE)(calibrate)
app.command(rich_help_panel=FORCE)(tune)
app.add_typer(check, name="check", rich_help_panel=FORCE)
app.add_typer(payload.app, name="payload", rich_help_panel=FORCE)
app.add_typer(verbs_run.bench, name="bench", rich_help_panel=RUN)


def _print_version(requested: bool) -> None:
    if requested:
        from forcemesh.version import __version__

        typer.echo(f"forcemesh {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print it and exit."
        ),
    ] = False,
) -> None:
    del version


def _report_in_one_line(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Report an internal error in one line, with a traceback only if FORCEMESH_TRACEBACK is set."""
    if os.environ.get("FORCEMESH_TRACEBACK"):
        sys.__excepthook__(kind, error, trace)
        return
    sys.stderr.write(
        f"forcemesh: {kind.__name__}: {error}; internal error of forcemesh: please report it "
        "with the traceback that FORCEMESH_TRACEBACK=1 prints\n"
    )


def main() -> None:
    """Entry of the console script."""
    sys.excepthook = _report_in_one_line
    typer.main.get_command(app)(prog_name="forcemesh")  # `app(...)` would set typer's own hook


if __name__ == "__main__":
    main()
