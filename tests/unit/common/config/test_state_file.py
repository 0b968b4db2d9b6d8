"""Files that are state: whole after a kill at every step, and on the disk before they are named."""

import datetime as dt
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cli.probe.verb import save_probe
from cli.tune.output import save_sections
from common.config import payload
from common.config.calibration import CalibrationSection, Residuals
from common.config.cell_terms import FrameSection
from common.config.evidence import BringupEvidence, StepEvidence, save_evidence
from common.config.payload import Payload
from common.config.probe import ProbeFile
from common.config.state_file import replace_file
from forcemesh.errors import DataError

# Forks a writer again and again; each is killed one executed line later than the one before.
KILLS = """
import os, sys
from pathlib import Path
from common.config.state_file import replace_file

path = Path(sys.argv[1])

def exit_at_line(last):
    count = 0
    def trace(frame, event, _):
        nonlocal count
        if frame.f_code.co_filename.rpartition("/")[2] not in ("state_file.py", "pathlib.py"):
            return None
        if event == "line":
            count += 1
            if count > last:
                os._exit(9)
        return trace
    sys.settrace(trace)

last, code = 0, 9
while code == 9:
    replace_file(path, "old" * 10_000)
    child = os.fork()
    if child == 0:
        exit_at_line(last)
        replace_file(path, "new" * 10_000)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    text, last = path.read_text(), last + 1
    print({"old" * 10_000: "old", "new" * 10_000: "new"}.get(text, "neither"))
"""
FIT = Residuals(poses=9, force_mean_N=0.0, force_max_N=0.0, torque_mean_Nm=0.0, torque_max_Nm=0.0)


def _save_calibration(path: Path, number: int) -> None:
    CalibrationSection(
        cell="demo",
        made_at=dt.datetime(2026, 11, 22, tzinfo=dt.UTC),
        method="arm",
        T_flange_tcp=FrameSection(position_m=(0.0, 0.0, 0.1)),
        T_flange_sensor=FrameSection(position_m=(0.0, 0.0, 0.1)),
        fit=FIT,
        payload=Payload(mass_kg=number, com_m=(0.0, 0.0, 0.0)),
    ).save(path)


def _save_evidence(path: Path, number: int) -> None:
    steps = {"tune": StepEvidence(numbers={"delay_s": number})}
    save_evidence(path.with_name("file.yaml"), BringupEvidence(steps=steps))


WRITERS: dict[str, Callable[[Path, int], None]] = {
    "calibration": _save_calibration,
    "evidence": _save_evidence,
    "payload": lambda path, number: payload.save(Payload(mass_kg=number, com_m=(0, 0, 0)), path),
    "probe": lambda path, number: save_probe(path, ProbeFile(controller=f"F{number}")),
    "tuning": lambda path, number: save_sections(path, {"robot": {"delay_s": float(number)}}),
}


def test_a_kill_at_any_step_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    """The writer is killed at each line that it executes."""
    command = [sys.executable, "-c", KILLS, str(tmp_path / "file.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    states = done.stdout.split()
    assert len(states) > 10
    assert states == ["old"] * states.count("old") + ["new"] * states.count("new")
    assert {"old", "new"} == set(states[:-1])  # of kills; nothing ends the last one


def test_data_are_on_the_disk_before_the_name_and_the_name_before_the_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut loses what is not synchronised: fsync of file, rename, fsync of folder."""
    path, steps = tmp_path / "new" / "file.yaml", []
    fsync, replace = os.fsync, Path.replace

    def note_fsync(handle: int) -> None:
        real = Path(f"/proc/self/fd/{handle}").readlink()
        steps.append(("fsync", "folder" if real.is_dir() else real.read_text()))
        fsync(handle)

    def note_replace(draft: Path, target: Path) -> Path:
        steps.append(("rename", draft.read_text()))
        return replace(draft, target)

    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(Path, "replace", note_replace)
    replace_file(path, "whole")
    assert steps == [("fsync", "whole"), ("rename", "whole"), ("fsync", "folder")]


@pytest.mark.parametrize("name", WRITERS)
def test_state_stays_as_it_was_when_the_disk_is_full(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the file, and no draft is left; a link still leads to the file."""
    file = f"file.{'bringup.' if name == 'evidence' else ''}yaml"
    path, link = tmp_path / "real.yaml", tmp_path / file
    link.symlink_to(path)
    WRITERS[name](link, 1)
    old = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DataError, match=r"real\.yaml: cannot be written: No space left"):
        WRITERS[name](link, 2)
    assert path.read_bytes() == old
    assert link.is_symlink()
    assert not list(tmp_path.glob(".*"))
    monkeypatch.undo()
    WRITERS[name](link, 2)
    assert path.read_bytes() != old
