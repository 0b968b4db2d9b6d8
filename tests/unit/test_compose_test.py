"""`make compose-test` where no engine can be had: it says so, and its exit code says the same."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("words", "code"), [((), 77), (("--optional",), 0)])
def test_without_an_engine_it_says_so_loudly(
    tmp_path: Path, words: tuple[str, ...], code: int
) -> None:
    """Nothing is tried and nothing passes silently: a line for people, a code for programs."""
    environment = {**os.environ, "PATH": str(tmp_path), "DOCKER_HOST": f"unix://{tmp_path}/none"}
    done = subprocess.run(
        [sys.executable, "-m", "tools.compose_test", *words],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert "NOT TESTED: containers. No engine can be had here" in done.stdout
