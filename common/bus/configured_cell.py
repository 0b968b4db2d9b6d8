"""Client of a cell whose whole cell file is here: command line, panel, tests."""

from pathlib import Path

from common.config.cell import CellConfig as CellFile
from common.config.info import cell_info
from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.client import Cell
from forcemesh.messages import Asker


class ConfiguredCell(Cell):
    """A `Cell` with its `config`: limits, rates and everything else of the cell file."""

    def __init__(
        self,
        cell: Path | str | CellFile,
        *,
        commander: Asker = "program",
        patience_s: float = 5.0,
        client: str = "",
        bus: Bus | None = None,
    ) -> None:
        """Connect, as `Cell`; the facts of the cell are those of the file.

        Raises:
            ConfigError: The cell file is wrong.
            BusError: No hub answers: the cell is not up.
        """
        self.config = cell if isinstance(cell, CellFile) else load_cell(cell)
        super().__init__(
            self.config,
            commander=commander,
            patience_s=patience_s,
            client=client,
            bus=bus,
            info=cell_info(self.config),
        )
