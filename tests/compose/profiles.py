"""Container tests of the profile that selects the robot: its changes, replacements, requirements.

Also the containers of `docker compose up` without profile and settings.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from common.config.cell import CellConfig
from tests.compose.rig import Compose, Operator, RequirementError, in_namespace, run, run_check

HEALTHY_S = 60.0
DEFAULT_HEALTHY_S = 30.0
WAITS_S = 30.0  # the message comes after 8 s, on a busy machine
SETTINGS = "FORCEMESH_"
OPENS = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:8080/', timeout=5).status)"


def another_profile(compose: Compose, _cell: CellConfig, operator: Operator) -> str:
    """A second profile on a running one creates none of its containers again."""
    before = containers_of(compose)
    sim = Compose("sim", compose.command)
    sim("up", "-d", "--no-build")
    if compose.profile == "sim":
        if containers_of(compose) != before:
            raise RequirementError("a second `docker compose up` has made containers anew")
        return f"{len(before)} containers as before"
    sim.wait_log("sim-cell", f"on standby: the profile {compose.profile} replaces the simulation")
    if containers_of(compose) != before:
        raise RequirementError(
            f"`docker compose up` has changed {before} to {containers_of(compose)}"
        )
    _is_still("robot-sim", compose)
    operator.until(operator.all_well, "all well beside a simulation that stands back")
    return f"the simulation stands back, {len(before)} containers as before"


def containers_of(compose: Compose) -> dict[str, tuple[str, ...]]:
    """Return the container of each service, and its start time."""
    facts = {name: compose.facts(name) for name in compose.names()}
    return {name: (each["Id"], each["State"]["StartedAt"]) for name, each in facts.items()}


def runs(name: str, compose: Compose) -> bool:
    """Return whether a container's own process runs, not only the wait before its start."""
    top = run("docker", "top", compose.id(name))
    module = {"robot-sim": "sim.robot"}.get(name, f"services.{name}")
    return any(f"python -m {module}" in line and " run " not in line for line in top.splitlines())


def _is_still(name: str, compose: Compose) -> None:
    if runs(name, compose):
        raise RequirementError(f"{name} runs beside the profile {compose.profile}")


@contextmanager
def without_settings() -> Iterator[None]:
    """Run compose as on a fresh checkout: without settings in the environment."""
    kept = {name: value for name, value in os.environ.items() if name.startswith(SETTINGS)}
    for name in kept:
        del os.environ[name]
    try:
        yield
    finally:
        os.environ.update(kept)


def default_profile(compose: Compose, namespace: str) -> str:
    """`docker compose up` alone: in time, the panel opens, status from outside."""
    began_s = time.monotonic()
    compose("up", "-d", "--no-build")
    compose.wait_healthy(DEFAULT_HEALTHY_S)
    took_s = time.monotonic() - began_s
    status = _outside(namespace, "-m", "cli", "status")
    page = _outside(namespace, "-c", OPENS)
    return f"well after {took_s:.0f} s; panel {page}; {status.splitlines()[0]}"


def _outside(namespace: str, *words: str) -> str:
    return run(*in_namespace(namespace, sys.executable, *words))


def open_to_others(compose: Compose) -> str:
    """Published on all interfaces without certificates or token, it does not start; one message."""
    refused = {
        "HUB": ("sim-cell", "FORCEMESH_PUBLISH_HUB=0.0.0.0 is reachable", ("hub", "robot-sim")),
        "PANEL": ("panel", "refused: on 0.0.0.0 any client on the network could", ("panel",)),
    }
    for port, (name, text, stopped) in refused.items():
        os.environ[f"FORCEMESH_PUBLISH_{port}"] = "0.0.0.0"
        try:
            compose("up", "-d", "--no-build")
            compose.wait_log(name, text)
            if any(runs(each, compose) for each in stopped):
                raise RequirementError(f"something runs with port {port} on 0.0.0.0")
        finally:
            del os.environ[f"FORCEMESH_PUBLISH_{port}"]
            compose("down", "-v", "-t", "2")
    return f"refused: {', '.join(refused)}"


def real_replaces_the_simulation(compose: Compose, settings: dict[str, str]) -> str:
    """On a running simulation, and the simulation on top of it: never both."""
    real = Compose("real", compose.command)
    with without_settings():
        compose("up", "-d", "--no-build")
        compose.wait_healthy(HEALTHY_S)
    os.environ.update(settings)
    try:
        real("up", "-d", "--no-build")
        real.wait_log("real-cell", "real-cell: in use with /cells/emulated.yaml", WAITS_S)
        _becomes("gateway", real, running=True)
        _is_still("robot-sim", real)
        gateway = real.facts("gateway")["State"]["StartedAt"]
        compose("up", "-d", "--no-build")
        _becomes("hub", real, running=True)
        _is_still("robot-sim", real)
        if real.facts("gateway")["State"]["StartedAt"] != gateway:
            raise RequirementError("`docker compose up` has started the gateway anew")
    finally:
        real("down", "-v", "-t", "2")
    return "in both orders the gateway runs and the simulation does not"


def _becomes(name: str, compose: Compose, *, running: bool) -> None:
    give_up_s = time.monotonic() + WAITS_S
    while runs(name, compose) != running:
        if time.monotonic() > give_up_s:
            log = compose("logs", "--no-color", name)
            raise RequirementError(f"{name} {'does not run' if running else 'runs'}: {log}")
        time.sleep(0.5)


def no_cell_file(command: tuple[str, ...]) -> str:
    """A real robot needs CELL: an error without it, and with it the same containers continue."""
    real = Compose("real", command)
    try:
        real("up", "-d", "--no-build")
        real.wait_log("real-cell", "CELL=my-cell.yaml docker compose --profile real up")
        # Where the simulation's container came first its file was in use for a moment.
        for name in ("hub", "robot-sim", "gateway"):
            _becomes(name, real, running=False)
        os.environ["CELL"] = "emulated.yaml"
        real("up", "-d", "--no-build")
        real.wait_log("real-cell", "in use with /cells/emulated.yaml")
    finally:
        os.environ.pop("CELL", None)
        real("down", "-v", "-t", "2")
    return "refused without CELL, started with it"


def check_profiles(command: tuple[str, ...], namespace: str) -> int:
    """Check all that concerns several profiles; return 1 if a requirement was not met, else 0."""
    sim = Compose("sim", command)
    secure = {name: value for name, value in os.environ.items() if name.startswith(SETTINGS)}
    with without_settings():
        try:
            wrong = run_check(
                "default", "docker compose up", partial(default_profile, sim, namespace)
            )
        finally:
            sim("down", "-v", "-t", "2")
        wrong += run_check("default", "open to others", partial(open_to_others, sim))
    secure["CELL"] = "emulated.yaml"
    replaces = partial(real_replaces_the_simulation, sim, secure)
    wrong += run_check("profiles", "real and simulation", replaces)
    os.environ.pop("CELL", None)
    wrong += run_check("profiles", "no cell file", partial(no_cell_file, command))
    return min(wrong, 1)
