"""Files that are state: whole after a kill at every step, and on the disk before they are named."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from common.config.state_file import replace_file
from forcemesh.errors import DataError
from tools.tree import ROOT

SAVE_STATE = (
    "cli/probe/verb.py", "cli/tune/output.py", "common/config/calibration.py",
    "common/config/evidence.py", "common/config/payload.py",
)  # fmt: skip


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


def test_state_stays_as_it_was_when_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the file, and no draft is left; a link still leads to the file."""
    path, link = tmp_path / "real.yaml", tmp_path / "link.yaml"
    link.symlink_to(path)
    replace_file(link, "old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DataError, match=r"real\.yaml: cannot be written: No space left"):
        replace_file(link, "new")
    assert path.read_text() == "old"
    assert link.is_symlink()
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("module", SAVE_STATE)
def test_every_state_is_saved_like_this(module: str) -> None:
    """No writer of a calibration, an evidence, a payload, a probe or a tuning writes by itself."""
    text = (ROOT / module).read_text(encoding="utf-8")
    assert "replace_file(path, " in text
    assert ".write_text(" not in text


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


def test_a_kill_at_any_step_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    """The writer is killed at each line that it executes."""
    command = [sys.executable, "-c", KILLS, str(tmp_path / "file.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    states = done.stdout.split()
    assert len(states) > 10
    assert states == ["old"] * states.count("old") + ["new"] * states.count("new")
    assert {"old", "new"} == set(states[:-1])  # of kills; nothing ends the last one
