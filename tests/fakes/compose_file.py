"""docker-compose.yml as the tests read it, and the role of each of its containers."""

import re
from pathlib import Path
from typing import Any

import yaml

from forcemesh.topics import HELPERS, ROLE_TABLE

ROOT = Path(__file__).resolve().parents[2]
COMPOSE_FILE = ROOT / "docker-compose.yml"
COMPOSE: dict[str, Any] = yaml.safe_load(COMPOSE_FILE.read_text(encoding="utf-8"))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
CELL = "/in-use/cell.yaml"

# Role of a profile's own container, where CELL does not name another.
CELL_OF = {"sim": "demo.yaml", "emulated": "emulated.yaml", "real": ""}

STATE_CELL = [f"{word}-cell" for word in CELL_OF]
RUN = [name for name in SERVICES if name not in STATE_CELL]
PROFILES = tuple(CELL_OF)
# In no profile; it only waits while another container is used.
STANDS_BACK = {"sim-cell", "robot-sim"}


def roles_of(name: str) -> set[str]:
    """Return the roles that a container plays by the table; the panel is a client."""
    module = SERVICES[name]["command"][2]
    return {row.name for row in ROLE_TABLE if module in row.modules.values()}


ON_THE_BUS = [name for name in SERVICES if roles_of(name) - set(HELPERS)]


def profile(word: str) -> set[str]:
    """Return the containers of a profile; `sim` is what `docker compose up` starts."""
    started = {name for name, entry in SERVICES.items() if word in entry.get("profiles", [word])}
    return started if word == "sim" else started - STANDS_BACK


def variables(tree: Any) -> set[str]:
    """Return the environment variables that a part of the file uses."""
    return set(re.findall(r"\$\{(\w+)", str(tree)))
