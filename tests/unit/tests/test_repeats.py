"""No verdict is tried again unless the machine stood still meanwhile: run on planted tests."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.chaos.common_net import child
from tests.chaos.witness import Witness

ROOT = Path(__file__).parents[3]
CONFTEST = """
import os, time
from pathlib import Path
import tests.repeats as repeats
from tests.chaos.witness import Witness

class Planted(repeats.Repeats):
    '''The witness reports the stall that the planted test sets.'''
    def pytest_collection_finish(self, session):
        Path("stalls").touch()
        self.witness = Witness([Path("stalls")])

def pytest_configure(config):
    for name in ("realtime", "processes", "judged_once", "browser"):
        config.addinivalue_line("markers", name)
    config.pluginmanager.register(Planted(Path()))
"""
TEST = """
import time
from pathlib import Path
import pytest
from tests.chaos.witness import ROW

def stall(seconds, ago_s=0.0):
    now = time.monotonic_ns() - round(ago_s * 1e9)
    with Path("stalls").open("ab") as file:
        file.write(ROW.pack(now, round(seconds * 1e9)))

{marks}
@pytest.mark.parametrize("number", range({number}))
def test_planted(number):
    tried = Path(f"tried-{{number}}")
    first = not tried.exists()
    tried.touch()
    if first:
        {stall}
        raise AssertionError("planted")
"""
REAL = "@pytest.mark.realtime"
FEW_PLUGINS = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # each plugin takes its time to start


def run(folder: Path, marks: str, stall: str, number: int = 1, *options: str) -> tuple[int, str]:
    """Run a test that fails the first time; return exit code and output."""
    (folder / "conftest.py").write_text(CONFTEST)
    text = TEST.format(marks=marks, stall=stall or "pass", number=number)
    (folder / "test_planted.py").write_text(text)
    (folder / "pytest.ini").write_text("[pytest]\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_planted.py"]
    command += ["-p", "pytest_rerunfailures", "-p", "xdist.plugin", *options]
    done = subprocess.run(
        command,
        cwd=folder,
        env={"PYTHONPATH": str(ROOT), **FEW_PLUGINS},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("marks", "stall"),
    [
        (REAL, ""),  # a planted race: the code's own doing
        (REAL, "stall(0.05)"),  # shorter than the deadline
        (REAL, "stall(0.5, ago_s=5.0)"),  # before the test
        (f"{REAL}(deadline_s=1.0)", "stall(0.5)"),
        (f"{REAL}\n@pytest.mark.judged_once", "stall(0.5)"),
        ("", "stall(0.5)"),  # nothing of it is in real time
    ],
)
def test_a_failure_stays_one_unless_the_machine_stood_still_meanwhile(tmp_path, marks, stall):
    """It is tried once, and the run is red."""
    code, output = run(tmp_path, marks, stall)
    assert code == 1, output
    assert "REPEATED" not in output
    assert "1 failed" in output


@pytest.mark.parametrize("marks", [REAL, "@pytest.mark.processes", f"{REAL}(deadline_s=0.2)"])
def test_a_stall_longer_than_the_deadline_is_reported_and_the_test_tried_once_more(tmp_path, marks):
    """Its name and why it failed are printed."""
    code, output = run(tmp_path, marks, "stall(0.3)")
    assert code == 0, output
    assert "REPEATED, the machine stood still: test_planted.py::test_planted[0]" in output
    assert "planted" in output


@pytest.mark.parametrize("options", [(), ("-n", "2")], ids=["alone", "side by side"])
@pytest.mark.parametrize(("number", "expected"), [(3, 0), (4, 1)])
def test_more_than_three_repeats_fail_the_run(tmp_path, number: int, expected: int, options):
    """A machine that stalls all the time is no place for a verdict, of all workers together."""
    code, output = run(tmp_path, REAL, "stall(0.3)", number, *options)
    assert code == expected, output
    assert ("4 repeats, 3 are allowed: failed" in output) == bool(expected)


@pytest.mark.processes
def test_a_witness_that_is_stopped_for_long_has_noted_a_stall(tmp_path):
    """The real witness of one processor: a frozen one was late, and reports when."""
    noted, processor = tmp_path / "noted", min(os.sched_getaffinity(0))
    noted.touch()
    watch, began_ns = Witness([noted]), time.monotonic_ns()
    with child("tests.chaos.witness", noted, processor) as late:
        wait_for(lambda: noted.stat().st_size > 0)
        assert os.sched_getaffinity(late.pid) == {processor}
        os.kill(late.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(late.pid, signal.SIGCONT)
        wait_for(lambda: watch.worst_s(began_ns, time.monotonic_ns()) >= 0.25)


def wait_for(condition: Callable[[], bool]) -> None:
    """Poll until it holds, for as long as a loaded machine may need."""
    give_up_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


@pytest.mark.parametrize(("ci", "code", "words"), [("1", 1, "1 failed"), ("", 0, "1 skipped")])
def test_a_skipped_test_is_a_failure_in_ci(tmp_path: Path, ci: str, code: int, words: str) -> None:
    """A machine that cannot try something reports that; CI may not take that for a pass."""
    (tmp_path / "conftest.py").write_text("from tests.conftest import pytest_runtest_makereport\n")
    (tmp_path / "test_planted.py").write_text(
        "import pytest\ndef test_planted():\n    pytest.skip('no such device')\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-qra", "-p", "no:cacheprovider", "test_planted.py"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "CI": ci, **FEW_PLUGINS},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout
    assert words in done.stdout
    assert "no such device" in done.stdout
