"""What is checked of the word that swaps the robot: what it changes, and when it is refused."""

import os
from functools import partial

from common.cell import Cell
from tools.compose_rig import Compose, Operator, PromiseError, told

OTHER = {"sim": "emulated", "emulated": "sim"}
HEALTHY_S = 60.0
WAITS_S = 30.0  # they say it after 8 s, on a machine that is busy


def another_profile(compose: Compose, _cell: Cell, operator: Operator) -> str:
    """Another profile on top makes no container anew; it says why it does not come, and waits."""
    other = Compose(OTHER[compose.profile], compose.command)
    more = sorted(set(other.names()) - set(compose.names()))
    before = lives(compose)
    try:
        other("up", "-d", "--no-build")
        _is_refused(other, compose, more)
        if lives(compose) != before:
            raise PromiseError(f"another profile has changed {before} to {lives(compose)}")
        operator.until(operator.all_well, 30.0, "all well beside a refused profile")
    finally:
        other("rm", "-s", "-f", *more)
    return f"{other.profile}: refused with one sentence, {len(before)} containers as before"


def lives(compose: Compose) -> dict[str, tuple[str, ...]]:
    """Return which container each service has, and since when it runs."""
    facts = {name: compose.facts(name) for name in compose.names()}
    return {name: (each["Id"], each["State"]["StartedAt"]) for name, each in facts.items()}


def _is_refused(other: Compose, compose: Compose, more: list[str]) -> None:
    other.says(f"{other.profile}-cell", f"first `docker compose --profile {compose.profile} down`")
    for name in set(more) - {f"{other.profile}-cell"}:
        other.says(name, f"waits: the profile {compose.profile} is in use", WAITS_S)


def both_at_once(command: tuple[str, ...]) -> str:
    """Two profiles at once are one whole cell and one refusal, never a mixture."""
    sim, emulated = (Compose(name, command) for name in OTHER)
    try:
        sim("--profile", "emulated", "up", "-d", "--no-build")
        first, second = (sim, emulated) if _came(sim) else (emulated, sim)
        first.wait_healthy(HEALTHY_S)
        _is_refused(second, first, sorted(set(second.names()) - set(first.names())))
    finally:
        sim("--profile", "emulated", "down", "-v", "-t", "2")
    return f"{first.profile} is whole, {second.profile} is refused"


def _came(compose: Compose) -> bool:
    name = f"{compose.profile}-cell"
    compose.says(name, "in use with /cells/")  # its own file, or why not
    return "first `docker" not in compose("logs", "--no-color", name)


def no_cell_file(command: tuple[str, ...]) -> str:
    """A real robot needs CELL: it says so, nobody runs, and with CELL the same containers go on."""
    real = Compose("real", command)
    try:
        real("up", "-d", "--no-build")
        real.says("real-cell", "CELL=my-cell.yaml docker compose --profile real up")
        if real("exec", "-T", "hub", "ls", "/in-use").split() != ["profile"]:
            raise PromiseError("there is a cell file in use without CELL")
        os.environ["CELL"] = "emulated.yaml"
        real("up", "-d", "--no-build")
        real.says("real-cell", "in use with /cells/emulated.yaml")
    finally:
        os.environ.pop("CELL", None)
        real("down", "-v", "-t", "2")
    return "says what it needs, and comes with it"


def check_profiles(command: tuple[str, ...]) -> int:
    """Check what is not about one profile alone; return 1 when a promise was not kept, else 0."""
    wrong = told("profiles", "both at once", partial(both_at_once, command))
    return max(wrong, told("profiles", "no cell file", partial(no_cell_file, command)))
