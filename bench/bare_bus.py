"""Hub and sessions of Zenoh without services, and processes that end with a block."""

import json
import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zenoh

from common.bus.cell_bus import hub_settings
from common.config.cell import CellConfig
from common.runtime.realtime import prepare_realtime
from forcemesh.zenoh_settings import client_settings

CONNECT_S = 30.0


@contextmanager
def started(target: Callable[..., None], *arguments: object) -> Iterator[int]:
    """Run a function in a process of its own during the block; yield its pid."""
    process = multiprocessing.get_context("spawn").Process(
        target=target, args=arguments, daemon=True
    )
    process.start()
    try:
        yield process.pid or 0
    finally:
        process.terminate()
        process.join()


def be_the_hub(cell: CellConfig, realtime: bool = False) -> None:  # noqa: FBT001, FBT002 - positional in `started`
    """Be a router with the settings of a cell's hub, until the process is terminated."""
    with zenoh.open(zenoh.Config.from_json5(json.dumps(hub_settings(cell, cell.bus.endpoint)))):
        if realtime:
            prepare_realtime()
        time.sleep(3600.0)


def opened_session(cell: CellConfig) -> zenoh.Session:
    """Return a session on the hub of a cell; wait for the hub."""
    settings = client_settings(cell.bus.endpoint, "monitor", {})
    give_up_s = time.monotonic() + CONNECT_S
    while True:
        try:
            return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
        except zenoh.ZError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.1)
