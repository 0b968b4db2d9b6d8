"""Command line `forcemesh`: thin verbs that import their dependencies at run time.

A verb that fails ends with one sentence and an exit code. Typer prints usage errors in a box with
its validator's text; here they read like cell file errors.
"""

import os
import sys
from collections.abc import Callable
from types import TracebackType
from typing import Annotated, Any

from typer import Abort, Exit, Option, Typer, echo
from typer.core import TyperGroup
from typer.exceptions import TyperException
from typer.main import get_command

from cli import (
    config_verbs,
    payload,
    pki,
    verbs_arm,
    verbs_force,
    verbs_move,
    verbs_read,
    verbs_run,
    verbs_signals,
    verbs_watch,
)
from cli.bringup.verb import bringup
from cli.calibration.verb import calibrate
from cli.check_axes.verb import check
from cli.context import EXIT_CODES, INTERRUPTED, OK, exit_code_of, print_note
from cli.demo.verb import demo
from cli.doctor.verb import doctor
from cli.export import export
from cli.forecast import forecast
from cli.numbers import NEGATIVE_NUMBERS
from cli.panel import panel
from cli.probe.verb import probe
from cli.record import record
from cli.replay import replay
from cli.report.verb import report
from cli.skills import verbs as skills
from cli.tune.verb import tune
from forcemesh.errors import ForcemeshError, first_mistake


class OneSentence(TyperGroup):
    """Root of the command line; prints at most one sentence for an error."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run a verb; end the process with its exit code, after at most one sentence."""
        is_standalone = options.get("standalone_mode", True)
        options["standalone_mode"] = False
        if not is_standalone:
            return super().main(*args, **options)
        try:
            code = super().main(*args, **options)
        except TyperException as error:
            print_note(_usage(error))
            sys.exit(error.exit_code)
        except Abort:
            print_note("interrupted: nothing was executed")
            sys.exit(INTERRUPTED)
        except ForcemeshError as error:
            print_note(str(error))
            sys.exit(exit_code_of(error))
        except OSError as error:
            if error.filename is None:
                raise
            print_note(f"{error.filename}: cannot be used: {error.strerror}")
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


app = Typer(
    cls=OneSentence,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # units in square brackets are text
    epilog=EXIT_CODES,
    help="Open force control for Kawasaki arms. This is not a safety function.",
)

VERBS: dict[str, tuple[Callable[..., Any], ...]] = {  # by panel of the help
    "Cell": (demo, verbs_run.up, bringup),
    "Status": (panel, verbs_read.status, doctor, probe, verbs_read.topics, verbs_watch.watch),
    "Recordings": (replay, export, report),
    "Motion": (
        verbs_arm.arm,
        verbs_arm.back_off,
        verbs_arm.hold,
        verbs_arm.clear,
        verbs_move.jog,
        verbs_move.retract,
        verbs_arm.speed,
    ),
    "Skills": (skills.touch, skills.press, skills.follow, skills.align, skills.guide),
    "Force": (verbs_force.tare, calibrate, tune, forecast),
}
GROUPS = {
    "record": (record, "Recordings"),
    "config": (config_verbs.config, "Cell"),
    "pki": (pki.app, "Cell"),
    "move": (verbs_move.move, "Motion"),
    "force": (verbs_force.force, "Force"),
    "signals": (verbs_signals.signals, "Motion"),
    "check": (check, "Force"),
    "payload": (payload.app, "Force"),
    "bench": (verbs_run.bench, "Cell"),
}
WITH_NUMBERS = (verbs_move.jog, skills.press)  # their arguments may be negative

for panel_name, verbs in VERBS.items():
    for verb in verbs:
        settings = NEGATIVE_NUMBERS if verb in WITH_NUMBERS else None
        app.command(rich_help_panel=panel_name, context_settings=settings)(verb)
for group_name, (group, panel_name) in GROUPS.items():
    app.add_typer(group, name=group_name, rich_help_panel=panel_name)


def _print_version(requested: bool) -> None:
    if requested:
        from forcemesh.version import __version__

        echo(f"forcemesh {__version__}")
        raise Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        Option("--version", callback=_print_version, is_eager=True, help="Print it and exit."),
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
    get_command(app)(prog_name="forcemesh")  # `app(...)` would set typer's own hook


if __name__ == "__main__":
    main()
