"""Verbs for cell files: config check, config show, config init."""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument, Exit, Option, Typer, echo

from cli.context import (
    USAGE,
    CellOption,
    JsonOption,
    exit_with_error,
    find_cell_file,
    one_line_errors,
)
from forcemesh.errors import ConfigError
from forcemesh.patterns import CELL_NAME, WORDS

if TYPE_CHECKING:
    from common.config.cell import CellConfig

config = Typer(no_args_is_help=True, help="Cell files.")

FOLDER = Path(__file__).resolve().parent.parent / "cells"
TEMPLATES = {"sim": "demo.yaml", "tcp": "demo-tcp.yaml", "real": "rs007l-real.yaml"}


@config.command("check")
def check(
    file: Annotated[Path, Argument(metavar="FILE", help="The cell file.")],
    as_json: JsonOption = False,
) -> None:
    """Check a cell file: report all errors at once, each with its path."""
    with one_line_errors():
        from common.config.load import cell_hash, load_cell
        from control.laws import refuse_unknown_law
        from services.sensor.driver_registry import refuse_unknown_driver

        try:
            cell = load_cell(file)
            refuse_unknown_driver(cell, str(file))
            refuse_unknown_law(cell, str(file))
        except ConfigError as error:
            if as_json:
                print(json.dumps({"file": str(file), "cell": None, "mistakes": error.mistakes}))
                raise Exit(USAGE) from None
            raise
    if as_json:
        known = {"file": str(file), "cell": cell.cell, "configuration": cell_hash(cell)}
        print(json.dumps({**known, "mistakes": []}))
        return
    echo(
        f"{file}: cell {cell.cell}, robot {cell.roles.robot}, sensor {cell.roles.sensor}, "
        f"configuration {cell_hash(cell)}: no errors"
    )


@config.command("show")
def show(as_json: JsonOption = False, cell: CellOption = None) -> None:
    """Show every value of a cell file and whether it is a default."""
    with one_line_errors():
        from common.config.load import load_cell

        path = find_cell_file(cell)
        loaded = load_cell(path)
    rows = _rows(loaded)
    if as_json:
        print(json.dumps({"file": str(path), "values": rows}))
        return
    from rich.table import Table

    from cli.tables import print_table, table_console

    table = Table("key", "value", "source", title=f"cell {loaded.cell} ({path})")
    for name, row in rows.items():
        table.add_row(name, json.dumps(row["value"]), row["from"])
    print_table(table_console(), table)


@config.command("init")
def init(
    out: Annotated[Path, Argument(metavar="FILE", help="The cell file to write.")],
    kind: Annotated[
        Literal["sim", "tcp", "real"],
        Option(help="sim: simulated arm; tcp: with emulated controller; real: RS007L."),
    ] = "real",
) -> None:
    """Write a commented template of a cell file; an existing file is not overwritten."""
    name = out.stem.lower()
    if re.match(CELL_NAME, name) is None:
        exit_with_error(f"{name!r} from FILE is not a cell name: a cell's name {WORDS[CELL_NAME]}")
    if out.exists():
        exit_with_error(f"{out} exists already: choose another name")
    text = (FOLDER / TEMPLATES[kind]).read_text(encoding="utf-8")
    for key, value in (("cell", name), ("calibration", f"{name}-calibration.yaml")):
        text = re.sub(rf"^{key}: (?!none$).*$", f"{key}: {value}", text, flags=re.MULTILINE)
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        exit_with_error(f"{error.filename}: {error.strerror}")
    echo(f"{out} written: fill it in, then `forcemesh config check {out}`")


def _rows(cell: "CellConfig") -> dict[str, dict[str, Any]]:
    """Return every value by its dotted path, with its source."""
    rows: dict[str, dict[str, Any]] = {}

    def add_rows(section: Any, path: str, inherited: str) -> None:
        for name in type(section).model_fields:
            if type(section).model_fields[name].exclude:
                continue
            value, key = getattr(section, name), f"{path}{name}"
            source = inherited or ("file" if name in section.model_fields_set else "default")
            if hasattr(type(value), "model_fields"):
                passed_on = "default" if source == "default" else ""
                is_calibration = key == "calibration"
                add_rows(value, f"{key}.", "calibration file" if is_calibration else passed_on)
                continue
            plain = section.model_dump(mode="json", include={name})[name]
            is_secret = name.endswith("token") and plain
            rows[key] = {"value": "(not shown)" if is_secret else plain, "from": source}

    add_rows(cell, "", "")
    return rows
