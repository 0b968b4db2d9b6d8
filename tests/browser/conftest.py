"""A simulated cell in real processes with its panel, and pages of a real browser on it.

One cell serves all tests; each begins with an arm at rest that is not armed. Every request of a
page is recorded, and must have stayed on this machine.
"""

import datetime as dt
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, sync_playwright

from common.bus.configured_cell import ConfiguredCell
from common.config.calibration import CalibrationSection, Residuals
from common.config.load import dump_cell, load_cell
from forcemesh.errors import ForcemeshError
from tests.browser.rig import SPARE, Cockpit, answers, running, wait_until
from tests.chaos.common_net import free_port
from tests.fakes.bench import DEMO

CHROMIUM = "/usr/bin/chromium"
HOME_RAD = (0.0, 0.0, -1.5707963, 0.0, -1.5707963, 0.0)
FLAGS = [
    "--no-sandbox",  # the browser's own sandbox needs rights that root in a container lacks
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # Only the scene is WebGL. On request the processor emulates a graphics card for the whole page:
    # 55 % of a core for one page, and two pages no longer answered. A browser without a card does
    # not, it paints the page itself: 1 %.
    "--disable-gpu-compositing",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
]


@pytest.fixture(scope="session")
def cell_file(tmp_path_factory) -> Path:
    """The demo's cell under a name and ports of its own, with time-outs of a slow machine."""
    folder = tmp_path_factory.mktemp("panel")
    port = free_port()
    overrides = {
        "cell": f"panel-{port}",
        "bus.endpoint": f"tcp/127.0.0.1:{port}",
        "panel.port": free_port(),
        "deadlines": {"command_s": 0.8, "sensor_s": 0.8, "status_s": 2.0, "health_s": 3.0},
        "limits.speed_m_s": 1.0,
        "rates": {"robot_hz": 60, "sensor_hz": 120, "control_hz": 60},
        "force.approach_m_s": 0.003,
    }
    path = folder / "cell.yaml"
    cell = load_cell(DEMO, overrides | {"calibration": None})
    text = dump_cell(cell)
    path.write_text(text + f"calibration: {folder / 'made.yaml'}\n", encoding="utf-8")
    left = Residuals(
        poses=1, force_mean_N=0.0, force_max_N=0.0, torque_mean_Nm=0.0, torque_max_Nm=0.0
    )
    CalibrationSection(
        cell=cell.cell,
        made_at=dt.datetime.now(dt.UTC),
        method="manual",
        T_flange_tcp=cell.tool.T_flange_tcp,
        T_flange_sensor=cell.sensor.T_flange_sensor,
        fit=left,
        verified=left,
        payload=cell.payload,
    ).save(folder / "made.yaml")
    return path


@pytest.fixture(scope="session")
def cell(cell_file) -> Iterator[ConfiguredCell]:
    """The running cell as a client of the bus; `up` has started its panel."""
    folder = {"FORCEMESH_RUN_FOLDER": str(cell_file.parent), "FORCEMESH_NO_PANEL": "0"}
    with running("-m", "cli", "up", "--cell", cell_file, **folder):
        port = load_cell(cell_file).panel.port
        wait_until(lambda: answers(port))
        with ConfiguredCell(cell_file, commander="operator", patience_s=10.0) as client:
            client.wait_ready(60.0)
            yield client


@pytest.fixture
def ready(cell) -> ConfiguredCell:
    """The cell with an arm at rest above its plate that is not armed, and tared."""
    wait_until(lambda: brought_home(cell))
    return cell


def brought_home(cell: ConfiguredCell) -> bool:
    """Move the arm home; return whether that succeeded: a machine that stalls makes it hold."""
    try:
        cell.hold("a test begins")
        cell.clear()
        cell.arm("jog")
        cell.move.joints(HOME_RAD, speed_m_s=0.1)
        cell.hold("a test begins")
        cell.clear()
        cell.tare(within_s=5.0)
    except ForcemeshError:
        return False
    return True


@pytest.fixture
def address(cell) -> str:
    """Address of the panel of the cell."""
    return f"http://127.0.0.1:{cell.config.panel.port}/"


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """The system's Chromium; it can reach no other machine."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def cockpit(browser):
    """Return a factory of pages of a new person; at the end none has contacted another host."""
    made: list[Cockpit] = []

    def make(width: int = 1280, height: int = 760, **more) -> Cockpit:
        context = browser.new_context(viewport={"width": width, "height": height}, **more)
        context.add_init_script(SPARE)
        made.append(Cockpit(context.new_page()))
        return made[-1]

    yield make
    hosts = {urlsplit(url).hostname for one in made for url in one.asked if "://" in url}
    for one in made:
        one.page.context.close()
    assert hosts <= {"127.0.0.1", None}, hosts
