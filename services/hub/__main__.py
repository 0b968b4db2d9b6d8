"""Hub: the Zenoh router of a cell, to which every process connects. It publishes only health."""

import os
from contextlib import AbstractContextManager
from functools import partial

from common.bus.cell_bus import open_hub
from common.config.cell import CellConfig
from common.runtime.service import main
from common.security.access_control import names_of
from forcemesh.bus import Bus
from forcemesh.identity import is_encrypted
from forcemesh.zenoh_session import log_refusals
from forcemesh.zenoh_settings import endpoint_of
from services.hub.refusals import Refusals
from services.hub.service import Hub


def connect(cell: CellConfig, role: str, *, refusals: Refusals) -> AbstractContextManager[Bus]:
    """Open the hub; with access control, capture Zenoh's log of refusals first."""
    if is_encrypted(endpoint_of(cell)):
        os.environ["NO_COLOR"] = "1"
        refusals.capture(names_of(cell))
        log_refusals()
    return open_hub(cell, role)


if __name__ == "__main__":
    refusal_log = Refusals()
    main("hub", partial(Hub, refusals=refusal_log), connect=partial(connect, refusals=refusal_log))
