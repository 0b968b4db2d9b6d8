"""docker-compose.yml as the tests read it, and what each of its containers is there for."""

import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
COMPOSE_FILE = ROOT / "docker-compose.yml"
COMPOSE: dict[str, Any] = yaml.safe_load(COMPOSE_FILE.read_text(encoding="utf-8"))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
CELL = "/in-use/cell.yaml"

# What a profile's own container says to use, where CELL says nothing else.
CELL_OF = {"sim": "demo.yaml", "emulated": "emulated.yaml", "real": ""}

# Which roles of the bus a container plays, where that is not its own name.
PLAYS: dict[str, set[str]] = {
    "robot-sim": {"robot", "sensor"},
    "gateway": {"robot"},
    "controller-sim": set(),  # stands for hardware
    "panel": set(),  # a client, as an operator is
    "recorder": set(),  # a helper: no cell needs it to be whole
    **{f"{word}-cell": set() for word in CELL_OF},  # they say which cell file is in use
}
SAY = [f"{word}-cell" for word in CELL_OF]
RUN = [name for name in SERVICES if name not in SAY]
ON_THE_BUS = [name for name in SERVICES if PLAYS.get(name, {name})]
PROFILES = tuple(CELL_OF)
# In no profile, and there only to stand back while another one is used.
STANDS_BACK = {"sim-cell", "robot-sim"}


def roles_of(name: str) -> set[str]:
    """Return the roles that a container plays."""
    return PLAYS.get(name, {name})


def profile(word: str) -> set[str]:
    """Return the containers that run in a profile; `sim` is what `docker compose up` starts."""
    started = {name for name, entry in SERVICES.items() if word in entry.get("profiles", [word])}
    return started if word == "sim" else started - STANDS_BACK


def variables(tree: Any) -> set[str]:
    """Return what a part of the file takes from the environment."""
    return set(re.findall(r"\$\{(\w+)", str(tree)))
