"""Verb `report`: a recording as one self-contained HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from cli.context import USAGE, exit_with_error, one_line_errors, waiting
from cli.replay import RecordingArgument, recorded_cell


def report(
    file: RecordingArgument,
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="Default: next to FILE.", show_default=False
        ),
    ] = None,
    no_3d: Annotated[bool, typer.Option("--no-3d", help="Omit the 3D replay.")] = False,
) -> None:
    """Write a page with summary, plots, stops and their remedies, and the arm's motion in 3D."""
    with one_line_errors():
        from cli.report.data import report_content
        from cli.report.page import page_of
        from cli.report.plots import plots_of
        from services.recorder.reading import RecordedFile

        read = RecordedFile(file)
        cell = recorded_cell(read)
        path = out or file.with_suffix(".html")
        with waiting(f"reading {file}"):
            content = report_content(read, cell)
            plots = plots_of(content)
        scene = ""
        if not no_3d:
            from cli.report.scene import scene_html

            with waiting("drawing the arm's motion"):
                scene = scene_html(read, cell, content)
        try:
            path.write_text(page_of(read, content, plots, scene), encoding="utf-8")
        except OSError as error:
            exit_with_error(f"{path}: cannot be written: {error.strerror}", USAGE)
    typer.echo(f"{path}: {content.duration_s:.1f} s, {len(content.stops)} stops")
