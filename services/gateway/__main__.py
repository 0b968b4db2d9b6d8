"""Gateway: implementation of the role `robot` for a Kawasaki controller."""

import sys

from common.config.cell import CellConfig
from common.runtime.service import main
from controller.plain import NOT_PROTECTED
from forcemesh.bus import Bus
from services.gateway.service import Gateway


def start(bus: Bus, cell: CellConfig) -> Gateway:
    """Return the gateway; write what protocol plain gives up, where the cell file selects it."""
    if cell.gateway is not None and cell.gateway.protocol == "plain":
        lines = "\n  ".join(("gateway.protocol is plain, without:", *map(str, NOT_PROTECTED)))
        sys.stderr.write(f"{lines}\n")
    return Gateway(bus, cell)


if __name__ == "__main__":
    main("robot", start, implementation="gateway")
