"""The examples are programs that run: each one on a whole cell in virtual time."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import DEMO, HALF_RATES
from tools.tree import PRODUCTION

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = sorted((ROOT / "examples").glob("*.py"))


def load(name: str):
    """Return an example as a module."""
    spec = importlib.util.spec_from_file_location(
        f"example_{name}", ROOT / "examples" / f"{name}.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def armed(**overrides) -> tuple[VirtualCell, ConfiguredCell]:
    """Return a cell in virtual time and a program's client of it."""
    changed = {f"sim.{k}": v for k, v in overrides.items()}
    config = load_cell(DEMO, {"rates": HALF_RATES, **changed})
    world = VirtualCell(config)
    cell = ConfiguredCell(config, bus=world.client)
    cell.wait_ready()
    cell.tare()
    cell.arm()
    return world, cell


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_an_example_is_short_and_uses_nothing_but_the_client(path: Path) -> None:
    """Under 80 lines; of the project it imports the client and the types of its requests."""
    text = path.read_text()
    assert len(text.splitlines()) < 80
    imports = {line.split()[1] for line in text.splitlines() if line.startswith(("import", "from"))}
    ours = {name for name in imports if name.split(".")[0] in set(PRODUCTION)}
    assert ours <= {
        "forcemesh",
        "forcemesh.client.rotations",
        "forcemesh.messages",
        "forcemesh.requests",
    }


def test_touch_and_press() -> None:
    """The plate is where the model has it; 10 N are held."""
    world, cell = armed()
    start = np.array(world.arm.T_base_flange.translation)
    place = load("touch").main(cell)
    assert cell.config.sim is not None
    assert start[2] - place[2] == pytest.approx(cell.config.sim.gap_m, abs=3e-4)
    assert load("press").main(cell, 0.2) == pytest.approx(10.0, abs=0.5)


def test_follow_goes_round_a_square_and_comes_back() -> None:
    """With the force held throughout."""
    world, cell = armed()
    start = np.array(world.arm.T_base_flange.translation)
    assert load("follow").main(cell, 0.01) < 2.0
    world.advance(0.2)
    assert world.arm.T_base_flange.translation[:2] == pytest.approx(start[:2], abs=3e-4)


def test_align_turns_by_the_tilt_of_the_plate() -> None:
    """Four degrees, less the tilt of the plate itself."""
    _, cell = armed(tilt_deg=4.0)
    assert load("align").main(cell) == pytest.approx(4.0, abs=1.0)


def test_guide_follows_a_push_and_goes_back() -> None:
    """Pushed with 8 N for the time: centimetres away, and back where it began."""
    world, cell = armed(gap_m=0.1)
    start = np.array(world.arm.T_base_flange.translation)
    tool = world.arm.model.body("tool").id
    guide = load("guide")
    world.arm.data.xfrc_applied[tool][:3] = (0.0, 8.0, 0.0)
    places = guide.record_guiding(cell, 1.0)
    world.arm.data.xfrc_applied[tool][:3] = 0.0
    world.advance(0.5)
    assert len(places) >= 3
    assert world.arm.T_base_flange.translation[1] - start[1] > 0.02
    for place in reversed(places):
        cell.move.to(place.position_m, place.orientation_xyzw, speed_m_s=0.05)
    assert world.arm.T_base_flange.translation == pytest.approx(start, abs=1e-3)
