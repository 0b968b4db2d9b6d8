"""Verb `export`: a recording as tables."""

import json
from csv import DictWriter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option, echo

from cli.context import exit_with_error, one_line_errors, print_note, waiting
from cli.replay import OnlyOption, RecordingArgument, chosen_topics

if TYPE_CHECKING:
    from cli.recording_tables import Row
    from services.recorder.reading import RecordedFile

NO_PYARROW = (
    "Parquet needs the package pyarrow: install the extra `parquet` (pip install pyarrow), or "
    "export --csv"
)


def export(
    file: RecordingArgument,
    *,
    csv: Annotated[bool, Option("--csv", help="CSV; the default.")] = False,
    parquet: Annotated[
        bool, Option("--parquet", help="Parquet; needs the extra `parquet`.")
    ] = False,
    lerobot: Annotated[
        bool,
        Option(
            "--lerobot",
            help="One table with LeRobot's columns and the wrench instead of one per topic.",
        ),
    ] = False,
    only: OnlyOption = None,
    out: Annotated[
        Path | None,
        Option("--out", "-o", metavar="FOLDER", help="Output folder; default: next to FILE."),
    ] = None,
) -> None:
    """Export a recording as tables; the column names carry the units."""
    if csv and parquet:
        exit_with_error("choose one of --csv and --parquet")
    with one_line_errors():
        from services.recorder.reading import RecordedFile

        topics = chosen_topics(only)
        read = RecordedFile(file)
        folder = out or file.with_suffix("")
        suffix = "parquet" if parquet else "csv"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with waiting(f"exporting {file}"):
                if lerobot:
                    written = _learning(read, folder, suffix)
                else:
                    written = _topics(read, topics, folder, suffix)
        except OSError as error:
            exit_with_error(f"{folder}: cannot be written: {error.strerror}")
    for path, rows in written:
        echo(f"{path}: {rows} rows")
    if not read.is_whole:
        print_note("the recording is truncated: its recorder was killed")


def _topics(
    read: "RecordedFile", topics: frozenset[str], folder: Path, suffix: str
) -> list[tuple[Path, int]]:
    from cli.recording_tables import first_ns, rows_of

    begin_ns = first_ns(read)
    keys = dict.fromkeys(message.topic for message in read.messages())
    written = []
    for key in keys:
        if topics and key not in topics:
            continue
        rows = rows_of(read.messages(key), begin_ns)
        path = folder / f"{key.replace('/', '-')}.{suffix}"
        _write(path, rows)
        written.append((path, len(rows)))
    return written


def _learning(read: "RecordedFile", folder: Path, suffix: str) -> list[tuple[Path, int]]:
    """Write one episode in the layout of a LeRobot data set."""
    from cli.recording_tables import learning_rows

    rows = learning_rows(read)
    path = folder / "data" / "chunk-000" / f"episode_000000.{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    _write(path, rows)
    about = folder / "meta" / "info.json"
    about.parent.mkdir(parents=True, exist_ok=True)
    about.write_text(json.dumps(_info(rows, suffix), indent=1) + "\n", encoding="utf-8")
    return [(path, len(rows))]


def _info(rows: "list[Row]", suffix: str) -> dict[str, Any]:
    from cli import recording_tables as tables

    def vector(names: tuple[str, ...]) -> dict[str, Any]:
        return {"dtype": "float64", "shape": [len(names)], "names": list(names)}

    lasted_s = rows[-1]["timestamp"]
    return {
        "robot_type": "kawasaki",
        "total_episodes": 1,
        "total_frames": len(rows),
        "fps": round((len(rows) - 1) / lasted_s, 3) if lasted_s > 0 else 0,
        "data_path": f"data/chunk-{{episode_chunk:03d}}/episode_{{episode_index:06d}}.{suffix}",
        "features": {
            tables.STATE: vector(tables.STATE_NAMES),
            tables.WRENCH: vector(tables.WRENCH_NAMES),
            tables.ACTION: vector(tables.ACTION_NAMES),
        },
    }


def _write(path: Path, rows: "list[Row]") -> None:
    from cli.recording_tables import flat_fields

    is_csv = path.suffix == ".csv"
    if is_csv:
        rows = [dict(flat_fields(row)) for row in rows]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    if is_csv:
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = DictWriter(stream, columns, restval="")
            writer.writeheader()
            writer.writerows(rows)
        return
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        exit_with_error(NO_PYARROW)
    table = pa.table({name: [row.get(name) for row in rows] for name in columns})
    parquet.write_table(table, path, compression="zstd")
