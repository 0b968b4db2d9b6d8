"""Verb `report`: a recording as one self-contained HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from cli.context import one_line_errors, waiting
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
        from cli.pages import write_page
        from cli.report.data import report_content
        from cli.report.page import page_of, scene_of
        from services.panel.markup import html
        from services.recorder.reading import RecordedFile

        read = RecordedFile(file)
        cell = recorded_cell(read)
        path = out or file.with_suffix(".html")
        with waiting(f"reading {file}"):
            content = report_content(read, cell)
        with waiting("drawing"):
            scene = html("") if no_3d else scene_of(read, cell, content)
            write_page(page_of(read, content, scene), path)
    typer.echo(f"{path}: {content.duration_s:.1f} s, {len(content.stops)} stops")
