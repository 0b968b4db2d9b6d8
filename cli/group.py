"""The command line's last resort: however a verb ends, one sentence and a code of the table.

Typer frames wrong usage in a box and quotes its validator; here it is the sentence of a cell file.
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
    """The root of the command line."""

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
            _say(_usage(error))
            sys.exit(error.exit_code)
        except typer.Abort:
            _say("interrupted: nothing was done")
            sys.exit(INTERRUPTED)
        except ForcemeshError as error:
            _say(str(error))
            sys.exit(exit_code_of(error))
        except OSError as error:
            if error.filename is None:
                raise
            _say(f"{error.filename}: cannot be used: {error.strerror}")
            sys.exit(exit_code_of(error))
        sys.exit(code if isinstance(code, int) else OK)


def _usage(error: TyperException) -> str:
    """Return what was typed wrongly, in the words of the other mistakes, and where help is."""
    from pydantic import ValidationError

    if isinstance(error.__cause__, ValidationError):
        error.message = first_mistake(error.__cause__).text
    context = getattr(error, "ctx", None)
    text = error.format_message().rstrip(".")
    if context is None or "Usage:" in text:
        return text
    end = "" if text.endswith("?") else ";"
    return f"{text}{end} `{context.command_path} --help` says more"


def _say(text: str) -> None:
    typer.echo(text, err=True)
