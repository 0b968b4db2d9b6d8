"""File paths of a calibration, its readings and its report; previous files are kept."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from common.config.cell import CellConfig
from common.config.load import CALIBRATION, named_file
from forcemesh.errors import DataError


@dataclass(frozen=True, slots=True)
class OutputFiles:
    """Path of the calibration file; readings and report page are in the same folder."""

    calibration: Path
    advice: str = ""  # how to make the cell use the file, empty when it does already

    @property
    def unused(self) -> Path:
        """Path of a calibration that is not put into use: one that the cell does not read."""
        if self.advice:
            return self.calibration
        return self.calibration.with_suffix(f".unused{self.calibration.suffix}")

    @property
    def readings(self) -> Path:
        """Path of the CSV file with the readings."""
        return self.calibration.with_suffix(".csv")


def output_files(cell: CellConfig, cell_file: Path, out: Path | None) -> OutputFiles:
    """Return the paths of this cell's calibration.

    The path in the cell file; else `<cell>.yaml` in the folder `calibration` next to the folder of
    the cell file, which a container can write, or in that of the current folder.
    Raises ConfigError when the cell file cannot be read.
    """
    named = named_file(cell_file, CALIBRATION)
    named = None if named is None else Path(os.path.normpath(named))
    if named is not None and (out is None or named.resolve() == out.resolve()):
        return OutputFiles(named)
    if out is None:
        folder = cell_file.resolve().parent.parent / "calibration"
        out = (folder if folder.is_dir() else Path("calibration")) / f"{cell.cell}.yaml"
    shown = os.path.relpath(out.resolve(), cell_file.resolve().parent)
    return OutputFiles(out, f"set `calibration: {shown}` in {cell_file} to use it")


def back_up(path: Path) -> None:
    """Copy an existing file to `<name>.before<suffix>`. Raises DataError when it cannot."""
    if not path.exists():
        return
    backup = path.with_name(f"{path.stem}.before{path.suffix}")
    try:
        shutil.copyfile(path, backup)
    except OSError as error:
        raise DataError(f"{backup}: cannot be written: {error.strerror}") from error
