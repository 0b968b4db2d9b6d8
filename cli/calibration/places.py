"""Where a calibration and what belongs to it are kept; what was there before is kept beside it."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from common.config.cell import Cell
from common.config.load import calibration_file
from forcemesh.errors import DataError


@dataclass(frozen=True, slots=True)
class Places:
    """The file of the calibration; readings and report page lie beside it."""

    calibration: Path
    advice: str = ""  # what to do so that the cell uses it, empty when it does by itself

    @property
    def unused(self) -> Path:
        """Where a calibration goes that is not put into use: never where the cell would take it."""
        if self.advice:
            return self.calibration
        return self.calibration.with_suffix(f".unused{self.calibration.suffix}")

    @property
    def readings(self) -> Path:
        """Where the single readings go."""
        return self.calibration.with_suffix(".csv")

    @property
    def failed_page(self) -> Path:
        """Where the page of a failed run goes: it does not take the place of a good one."""
        return self.calibration.with_suffix(".failed.html")


def places_of(cell: Cell, cell_file: Path, out: Path | None) -> Places:
    """Return where this cell's calibration goes.

    The place that the cell file names; else `calibration/<cell>.yaml` in the present folder.
    Raises ConfigError when the cell file cannot be read.
    """
    named = calibration_file(cell_file)
    named = None if named is None else Path(os.path.normpath(named))
    if named is not None and (out is None or _are_same(named, out)):
        return Places(named)
    if out is None:
        out = Path("calibration") / f"{cell.cell}.yaml"
    shown = os.path.relpath(out, cell_file.parent)
    return Places(out, f"so that the cell uses it, let {cell_file} say `calibration: {shown}`")


def keep_before(path: Path) -> None:
    """Keep what stands there as `<name>.before<suffix>`. Raises DataError when it cannot."""
    if not path.exists():
        return
    kept = path.with_name(f"{path.stem}.before{path.suffix}")
    try:
        shutil.copyfile(path, kept)
    except OSError as error:
        raise DataError(f"{kept}: cannot be written: {error.strerror}") from error


def _are_same(path: Path, other: Path) -> bool:
    return path.resolve() == other.resolve()
