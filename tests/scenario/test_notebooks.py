"""The notebooks run from top to bottom, and are stored without outputs."""

from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from typer.testing import CliRunner

from cli.__main__ import app
from forcemesh.client import Cell

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
PATIENCE_S = 300


def run_notebook(name: str) -> str:
    """Run a notebook as Jupyter does; return its printed text and its number of pictures."""
    book = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    NotebookClient(
        book, timeout=PATIENCE_S, kernel_name="python3", resources={"metadata": {"path": FOLDER}}
    ).execute()
    outputs: list[Any] = [out for cell in book.cells for out in cell.get("outputs", ())]
    pictures = sum("image/png" in out.get("data", {}) for out in outputs)
    return "".join(out.get("text", "") for out in outputs) + f"pictures: {pictures}"


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_stored_without_outputs(name: str) -> None:
    """Small, and without outputs that differ from run to run."""
    book = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    nbformat.validate(book)
    for cell in book.cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
    assert (FOLDER / f"{name}.ipynb").stat().st_size < 10_000
    assert f"({name}.ipynb)" in (FOLDER / "README.md").read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.timeout(PATIENCE_S)
def test_presets_are_compared_in_the_simulation() -> None:
    """Stiffer gains settle sooner."""
    printed = run_notebook("tune")
    after_ms = [float(line.split(" ms, ")[0].split()[-1]) for line in printed.splitlines()[1:4]]
    assert after_ms == sorted(after_ms, reverse=True)
    assert printed.endswith("pictures: 1")


@pytest.mark.long
@pytest.mark.processes
@pytest.mark.timeout(2 * PATIENCE_S)
def test_a_running_cell_is_plotted_and_its_recording_analysed(
    cell_file, start, tmp_path, monkeypatch
) -> None:
    """From the bus, and from the file of the recorder."""
    monkeypatch.setenv("FORCEMESH_CELL", str(cell_file))
    monkeypatch.setenv("FORCEMESH_RECORDINGS", str(tmp_path / "recordings"))
    monkeypatch.setenv("FORCEMESH_NO_PANEL", "1")
    monkeypatch.delenv("FORCEMESH_NO_RECORDER", raising=False)
    up = start("-m", "cli", "up", "--cell", cell_file)
    assert "is up" in next(line for line in up.stderr if "is up" in line)
    assert "pictures: 1" in run_notebook("subscribe")

    recorded = record_a_press(cell_file, tmp_path)
    monkeypatch.setenv("FORCEMESH_RECORDING", str(recorded))
    printed = run_notebook("recording")
    assert recorded.name in printed
    assert "pictures: 1" in printed
    most_N = float(printed.split("maximum ")[1].split()[0])
    assert most_N == pytest.approx(12.0, abs=3.0)


def record_a_press(cell_file: Path, folder: Path) -> Path:
    """Press with 12 N while the recorder writes; return its file."""
    with Cell(cell_file) as cell:
        cell.wait_ready()
        cell.tare()
        assert CliRunner().invoke(app, ["record", "start", "notebook"]).exit_code == 0
        cell.arm()
        cell.force.press(12.0)
        cell.force.stop()
        assert CliRunner().invoke(app, ["record", "stop"]).exit_code == 0
    (path,) = (folder / "recordings").glob("*.mcap")
    return path
