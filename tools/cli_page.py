"""Page of all commands, out/docs/cli.md, from the command line: `python -m tools.cli_page`."""

from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import typer.main

from cli.__main__ import app
from cli.context import EXITS

PAGE = Path(__file__).resolve().parent.parent / "out" / "docs" / "cli.md"
HEAD = """# Command line

This page lists all commands of `forcemesh`, as `forcemesh --help` and `forcemesh VERB --help` do;
it is made by `make docs`.

- `--cell FILE` selects the cell; without it `FORCEMESH_CELL` of the environment, otherwise the
  running cell, otherwise `cells/demo.yaml`. `FORCEMESH_ENDPOINT` sets the address of the hub.
- `--json` prints only JSON on standard output. Errors go to standard error, in one sentence, with
  the remedy after `->`.
- `NO_COLOR=1` disables colours. Progress is shown on a terminal only.
- `forcemesh --install-completion` enables completion of commands, options and topics in bash, zsh,
  fish and PowerShell.
- Ctrl-C during a command that moves the arm requests a hold first.
- None of this is a safety function.

## Exit codes

"""


def page() -> str:
    """Return the page."""
    codes = "".join(f"| {code} | {meaning} |\n" for code, meaning in EXITS.items())
    command = typer.main.get_command(app)
    verbs = "\n".join(_section(name, verb) for name, verb in walk(command))
    return f"{HEAD}| code | meaning |\n|---:|---|\n{codes}\n{verbs}"


def walk(command: Any, name: str = "forcemesh") -> Iterator[tuple[str, Any]]:
    """Yield every command with its full name."""
    below = getattr(command, "commands", None)
    if below is None:
        yield name, command
        return
    for word in sorted(below):
        yield from walk(below[word], f"{name} {word}")


def _section(name: str, verb: Any) -> str:
    arguments = [each for each in verb.params if each.param_type_name == "argument"]
    options = [each for each in verb.params if each.param_type_name == "option"]
    words = " ".join(_argument(each) for each in arguments)
    usage = " ".join(part for part in (name, "[OPTIONS]" if options else "", words) if part)
    lines = [f"## {name.removeprefix('forcemesh ')}", "", f"`{usage}`", ""]
    lines += [" ".join(part.split()) + "\n" for part in (verb.help or "").split("\n\n")]
    rows = [_row(each) for each in (*arguments, *options) if each.name != "help"]
    if rows:
        lines += ["| | | |", "|---|---|---|", *rows, ""]
    return "\n".join(lines)


def _argument(parameter: Any) -> str:
    return parameter.metavar or (parameter.name or "").upper()


def _row(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        name = f"`{_argument(parameter)}`"
    else:
        name = ", ".join(f"`{word}`" for word in (*parameter.opts, *parameter.secondary_opts))
    notes = [" ".join((getattr(parameter, "help", None) or "").split())]
    default = parameter.default
    if isinstance(default, str | float | int) and not isinstance(default, bool) and default != "":
        notes.append(f"Default: `{getattr(default, 'value', default)}`.")
    if variable := getattr(parameter, "envvar", None):
        notes.append(f"Environment: `{variable}`.")
    text = " ".join(note for note in notes if note).replace("|", "\\|")
    return f"| {name} | {_kind(parameter)} | {text} |"


def _kind(parameter: Any) -> str:
    value_type = parameter.type_descriptor.annotation
    if get_origin(value_type) is Literal:
        return ", ".join(map(str, get_args(value_type)))
    if isinstance(value_type, type) and issubclass(value_type, Enum):
        return ", ".join(str(each.value) for each in value_type)
    if getattr(parameter, "is_flag", False):
        return ""
    if parameter.min is not None and parameter.max is not None:
        return f"{parameter.min:g} to {parameter.max:g}"
    if parameter.min is not None:
        return f"from {parameter.min:g}"
    names = {float: "number", int: "whole number", str: "text", Path: "path"}
    if get_origin(value_type) is list:
        return f"{names.get(get_args(value_type)[0], 'text')}, several times"
    return names.get(value_type, str(value_type))


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
