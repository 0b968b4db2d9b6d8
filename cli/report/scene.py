"""3D replay of a recording: the panel's view, played by the page itself, without a server."""

from contextlib import redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cli.report.data import ReportContent
    from common.config.cell import CellConfig
    from services.recorder.reading import RecordedFile

FASTEST_HZ = 20.0
MOST_FRAMES = 4000


def scene_html(read: "RecordedFile", cell: "CellConfig", content: "ReportContent") -> str:
    """Return a page that plays the arm's motion; it needs no network."""
    import socket

    import viser

    from cli.report.data import sampled_snapshots
    from services.panel.scene import Scene

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    with redirect_stdout(StringIO()):  # it prints a greeting in any case
        server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    try:
        scene = Scene(server, cell)
        serializer = server.get_scene_serializer()
        rate_hz = min(FASTEST_HZ, MOST_FRAMES / max(content.duration_s, 1.0))
        last_s = 0.0
        for at_s, snapshot in sampled_snapshots(read, content.begin_ns, rate_hz):
            serializer.insert_sleep(max(at_s - last_s, 0.0))
            last_s = at_s
            scene.draw(snapshot)
        serializer.insert_sleep(max(content.duration_s - last_s, 0.0))
        page: str = serializer.as_html()
    finally:
        with redirect_stdout(StringIO()):
            server.stop()
    return page
