"""Panel: browser interface of a cell; it sends requests as a client and shows the replies."""

import argparse
import os
import sys
import webbrowser
from pathlib import Path

from common.config.load import load_cell
from common.runtime.service import exit_on_error
from common.runtime.stop import stop_on_signals
from services.panel.access import context_of, door_of

NICE = 10  # drawing may be late, control must not be


def main(words: list[str] | None = None) -> None:
    """Serve the page until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(prog="panel", description="Browser panel of a forcemesh cell.")
    parser.add_argument("--cell", required=True, metavar="FILE", type=Path, help="the cell file")
    parser.add_argument("--host", help="listen address; default: panel.host of the cell file")
    parser.add_argument("--port", type=int, help="listen port; default: panel.port of the file")
    parser.add_argument("--view-only", action="store_true", help="grant no operator rights")
    parser.add_argument("--open", action="store_true", help="open the page in a browser")
    asked = parser.parse_args(words)
    stop = stop_on_signals()
    with exit_on_error("panel"):
        cell = load_cell(asked.cell)
        door = door_of(
            cell.panel, os.environ, host=asked.host, port=asked.port, view_only=asked.view_only
        )
        context_of(cell, door)  # fails early when a certificate is missing
        os.nice(max(0, NICE - os.nice(0)))
        from services.panel.page import PanelPage  # noqa: PLC0415 - slow imports, after the checks

        page = PanelPage(cell, asked.cell, door)
    try:
        scheme = "https" if door.is_encrypted else "http"
        address = f"{scheme}://{'127.0.0.1' if door.host == '0.0.0.0' else door.host}:{door.port}"  # noqa: S104
        sys.stdout.write(f"panel: {address}\n")
        sys.stdout.flush()
        if asked.open:
            webbrowser.open(address + (f"/?token={door.token}" if door.token else ""))
        page.run(stop)
    finally:
        page.close()


if __name__ == "__main__":
    main()
