"""The library alone: its wheel in an empty environment, with a running cell."""

import json
import os
import subprocess
import sys
import venv
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import pytest

from common.config.load import load_cell

ROOT = Path(__file__).resolve().parents[2]
MOST_PACKAGES = 12
LIST = (
    "import json, importlib.metadata as m; print(json.dumps([d.name for d in m.distributions()]))"
)
PROGRAM = """
import sys

from forcemesh import Cell, RefusedError
from forcemesh.messages import WrenchAtTcp


def pushes(wrench: WrenchAtTcp) -> float:
    return wrench.force_N[2]


def main(endpoint: str, name: str) -> None:
    with Cell(endpoint, name, commander="operator", patience_s=30.0) as cell:
        cell.wait_ready(60.0)
        cell.tare()
        cell.arm()
        pressed = cell.force.press(10.0)
        forces_N = [pushes(each.message) for each in cell.wrench.stream(seconds=0.5)]
        cell.force.stop()
        cell.hold("the example is over")
        try:
            cell.move.by((0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
        except RefusedError as error:
            print(pressed.force_N, sum(forces_N) / len(forces_N), cell.status().state, error.code)


if __name__ == "__main__":
    main(*sys.argv[1:])
"""

pytestmark = [pytest.mark.processes, pytest.mark.long]


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the Python of an environment with the wheel and its dependencies only."""
    folder = tmp_path_factory.mktemp("library")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT / "forcemesh", check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    versions = folder / "versions.txt"  # the versions of the other tests
    versions.write_text(
        "".join(
            f"{each.name}=={each.version}\n"
            for each in distributions()
            if each.name != "forcemesh-cell"
        )
    )
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv" / "bin" / "python"
    words = ["-m", "pip", "install", "-q", "--no-input", "--disable-pip-version-check"]
    subprocess.run([python, *words, "-c", versions, wheel], check=True, cwd=folder)
    return python


def run(python: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run the bare Python outside of this checkout."""
    found: dict[str, Any] = {"cwd": python.parent, "env": {"PATH": os.environ["PATH"], "HOME": "/"}}
    return subprocess.run(
        [str(python), *map(str, words)], capture_output=True, text=True, check=False, **found
    )


def test_the_wheel_brings_few_packages_and_one_name(bare: Path) -> None:
    """At most twelve with it; nothing at the top level but `forcemesh`."""
    names = set(json.loads(run(bare, "-c", LIST).stdout)) - {"pip", "setuptools"}
    assert "forcemesh" in names
    assert len(names) <= MOST_PACKAGES, names
    files = "import importlib.metadata as m; print(*m.files('forcemesh'))"
    top = {file.partition("/")[0] for file in run(bare, "-c", files).stdout.split()}
    assert {name.partition("-")[0] for name in top} == {"forcemesh"}
    assert run(bare, "-c", "import common").returncode != 0


def test_a_program_presses_watches_and_holds_a_cell_that_runs(bare: Path, cell_file, start) -> None:
    """It gets an endpoint and a cell name, and no cell file."""
    up = start("-m", "cli", "up", "--cell", cell_file)
    assert "is up" in next(line for line in up.stderr if "is up" in line)
    cell = load_cell(cell_file)
    program = bare.parent / "program.py"
    program.write_text(PROGRAM, encoding="utf-8")
    done = run(bare, program, cell.bus.endpoint, cell.cell)
    assert done.returncode == 0, done.stderr
    pressed, watched, state, refused = done.stdout.split()
    assert float(pressed) == pytest.approx(10.0, abs=1.0)
    assert float(watched) == pytest.approx(10.0, abs=1.5)
    assert (state, refused) == ("HOLDING", "not_armed")


def test_the_types_of_the_library_hold_from_outside(bare: Path, tmp_path: Path) -> None:
    """`mypy --strict` passes the program, and finds a wrong argument in it."""
    program = tmp_path / "program.py"
    words = ["-m", "mypy", "--strict", "--python-executable", bare, "--cache-dir", tmp_path / "c"]
    for text, code in ((PROGRAM, 0), (PROGRAM.replace("press(10.0)", 'press("10")'), 1)):
        program.write_text(text, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, *map(str, words), str(program)],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout
