"""Verb `report`: a page about a recording of forcemesh, or about a force log of any robot."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option, echo

from cli.context import JsonOption, one_line_errors, waiting
from cli.replay import recorded_cell
from forcemesh.errors import DataError

if TYPE_CHECKING:
    from cli.report.log_columns import ColumnChoice
    from cli.report.log_summary import JudgedLog
    from cli.report.log_table import LogTable
    from services.recorder.reading import RecordedFile

DEFAULT_BAND, DEFAULT_MEAN_MS = "5%", 20.0


FileArgument = Annotated[
    Path,
    Argument(
        metavar="FILE",
        help="A recording of `forcemesh record`, or a log of any robot (.csv, .mcap).",
    ),
]
SetpointOption = Annotated[
    str,
    Option(
        metavar="COLUMN|NUMBER",
        help="Log: set point; default: a column of this name, else the final levels of the force.",
    ),
]
AxisOption = Annotated[
    str,
    Option(
        metavar="COLUMN",
        help="Log: force or torque of the set point, with - for the opposite sign; default: the "
        "force that changes most.",
    ),
]
MeanOption = Annotated[
    float,
    Option(min=0.0, max=10_000.0, help="Log: moving mean for settling [ms]; 0: single samples."),
]


def report(
    file: FileArgument,
    *,
    out: Annotated[
        Path | None,
        Option("--out", "-o", metavar="FILE", help="Default: next to FILE."),
    ] = None,
    no_3d: Annotated[bool, Option("--no-3d", help="Omit the 3D replay.")] = False,
    time: Annotated[
        str, Option(metavar="COLUMN", help="Log: column of the time; default: by its name.")
    ] = "",
    force: Annotated[
        str, Option(metavar="X,Y,Z", help="Log: one to three columns; default: by their names.")
    ] = "",
    torque: Annotated[str, Option(metavar="X,Y,Z", help="Log: the same for torques.")] = "",
    setpoint: SetpointOption = "",
    axis: AxisOption = "",
    units: Annotated[
        str, Option(metavar="N,Nm,s", help="Log: units; default: by the columns' names, else SI.")
    ] = "",
    band: Annotated[
        str, Option(help="Log: band of settling, in percent of the step or as a force: 1N.")
    ] = DEFAULT_BAND,
    mean_ms: MeanOption = DEFAULT_MEAN_MS,
    topic: Annotated[
        str, Option(help="Log: topic of an MCAP file; default: the only one that can be read.")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Write a page about a recording: summary, plots, stops and their remedies, the arm in 3D.

    A force log of any robot is judged instead, without a cell: settling, overshoot, ripple, drift,
    spectrum, clipping, and gaps of its times.
    """
    with one_line_errors():
        from cli.report.log_columns import ColumnChoice

        choice = ColumnChoice(
            time=time.strip(),
            force=_listed(force),
            torque=_listed(torque),
            setpoint=setpoint.strip(),
            axis=axis.strip(),
            units=units,
        )
        path = out or file.with_suffix(".html")
        if path.exists() and path.resolve() == file.resolve():
            raise DataError(f"--out {path}: is the file that is read: choose another name")
        recording = None if topic else _recording(file)
        if recording is None:
            judged = _judged(_table(file, topic), choice, band, mean_ms / 1e3)
            _write_log_page(judged, path, as_json=as_json)
        elif choice != ColumnChoice() or as_json:
            raise DataError(
                f"{file}: is a recording of forcemesh, whose report takes no columns and no "
                "--json; --topic judges one of its topics as a log"
            )
        else:
            _write_recording_page(recording, path, no_3d=no_3d)


def _listed(text: str) -> tuple[str, ...]:
    return tuple(word for part in text.split(",") if (word := part.strip()))


def _recording(file: Path) -> "RecordedFile | None":
    """Return a recording of forcemesh; None for a log."""
    from cli.report.log_mcap import is_mcap
    from cli.report.log_table import TEXT_SUFFIXES, refuse_other_kinds
    from services.recorder.reading import RecordedFile

    is_log = is_mcap(file) or file.suffix.lower() in TEXT_SUFFIXES
    try:
        return RecordedFile(file)
    except DataError as error:
        if is_log:
            return None
        refuse_other_kinds(file)
        suffixes = ", ".join(TEXT_SUFFIXES)
        raise DataError(f"{error}; a log of another robot is {suffixes} or .mcap") from None


def _table(file: Path, topic: str) -> "LogTable":
    from cli.report.log_mcap import McapTable, is_mcap
    from cli.report.log_table import CsvTable

    if is_mcap(file):
        return McapTable(file, topic or None)
    if topic:
        raise DataError(f"{file}: --topic {topic}: a text file has no topics")
    return CsvTable(file)


def _judged(table: "LogTable", choice: "ColumnChoice", band: str, mean_s: float) -> "JudgedLog":
    from cli.report.log_columns import band_of, read_force_log
    from cli.report.log_summary import JudgedLog
    from tuning.log_quality import quality_of

    with waiting(f"reading {table.path}"):
        log = read_force_log(table, choice)
        width = band_of(band, log)
        quality = quality_of(log.columns, log.judged, log.setpoint, band=width, mean_s=mean_s)
    return JudgedLog(table.path, log, quality, width, mean_s)


def _write_log_page(judged: "JudgedLog", path: Path, *, as_json: bool) -> None:
    from rich.table import Table

    from cli.pages import write_page
    from cli.report.log_page import log_page
    from cli.report.log_summary import (
        SEGMENT_HEAD,
        as_json_tree,
        headline,
        segment_rows,
        summary_lines,
    )
    from cli.tables import print_table, table_console

    with waiting("drawing"):
        write_page(log_page(judged), path)
    if as_json:
        print(json.dumps(as_json_tree(judged), indent=1))
        return
    echo(headline(judged))
    rows = Table(*SEGMENT_HEAD)
    for row in segment_rows(judged.quality):
        rows.add_row(*row)
    print_table(table_console(), rows)
    for line in summary_lines(judged):
        echo(line)
    echo(f"{path}: the page")


def _write_recording_page(read: "RecordedFile", path: Path, *, no_3d: bool) -> None:
    from cli.pages import write_page
    from cli.report.data import report_content
    from cli.report.forecasts import forecast_rows, lines_of, section_of
    from cli.report.page import page_of, scene_of
    from services.panel.markup import html

    cell = recorded_cell(read)
    with waiting(f"reading {read.path}"):
        content = report_content(read, cell)
        forecasts = forecast_rows(read, cell, content)
    with waiting("drawing"):
        scene = html("") if no_3d else scene_of(read, cell, content)
        write_page(page_of(read, content, scene, section_of(forecasts)), path)
    echo(f"{path}: {content.duration_s:.1f} s, {len(content.stops)} stops")
    for line in lines_of(forecasts):
        echo(line)
