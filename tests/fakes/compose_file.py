"""docker-compose.yml as the tests read it, and the role of each of its containers."""

import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
COMPOSE_FILE = ROOT / "docker-compose.yml"
COMPOSE: dict[str, Any] = yaml.safe_load(COMPOSE_FILE.read_text(encoding="utf-8"))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
CELL = "/in-use/cell.yaml"

# Role of a profile's own container, where CELL does not name another.
CELL_OF = {"sim": "demo.yaml", "emulated": "emulated.yaml", "real": ""}

# Bus roles of a container whose name is another one.
ROLE_OF: dict[str, set[str]] = {
    "robot-sim": {"robot", "sensor"},
    "gateway": {"robot"},
    "controller-sim": set(),  # substitutes hardware
    "panel": set(),  # a client, like an operator
    "recorder": set(),  # a helper that no cell needs
    **{f"{word}-cell": set() for word in CELL_OF},  # they state which cell file is in use
}
STATE_CELL = [f"{word}-cell" for word in CELL_OF]
RUN = [name for name in SERVICES if name not in STATE_CELL]
ON_THE_BUS = [name for name in SERVICES if ROLE_OF.get(name, {name})]
PROFILES = tuple(CELL_OF)
# In no profile; it only waits while another container is used.
STANDS_BACK = {"sim-cell", "robot-sim"}


def roles_of(name: str) -> set[str]:
    """Return the bus roles of a container."""
    return ROLE_OF.get(name, {name})


def profile(word: str) -> set[str]:
    """Return the containers of a profile; `sim` is what `docker compose up` starts."""
    started = {name for name, entry in SERVICES.items() if word in entry.get("profiles", [word])}
    return started if word == "sim" else started - STANDS_BACK


def variables(tree: Any) -> set[str]:
    """Return the environment variables that a part of the file uses."""
    return set(re.findall(r"\$\{(\w+)", str(tree)))
