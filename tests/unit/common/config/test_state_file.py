"""Files that are state: on the disk before they are named, and whole when the disk is full."""

import os
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
