"""Root of the command line: a verb that fails ends with one sentence and an exit code.

Typer prints usage errors in a box with its validator's text; here they read like cell file errors.
"""

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from cli.exits import INTERRUPTED, OK, exit_code_of
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
