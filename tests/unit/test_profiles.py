"""One word swaps the robot: what a profile changes, and that it is one container that says so."""

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from common.in_use import PLAYERS, Choice, misfit
from common.topics import ROLES
from tests.fakes.compose_file import (
    CELL_OF,
    COMPOSE,
    COMPOSE_FILE,
    ON_THE_BUS,
    PROFILES,
    ROOT,
    RUN,
    SERVICES,
    profile,
    variables,
)
from tools.compose_rig import compose_command

WAIT = ["python", "-m", "common.in_use", "run"]

process = pytest.mark.parametrize("name", RUN)


def test_one_word_swaps_who_plays_robot_and_sensor() -> None:
    """The profiles differ in who plays robot and sensor, and in the hardware that is emulated."""
    same = set(ROLES) - {"robot", "sensor"}
    same |= {"panel", "recorder"}
    assert profile("sim") == same | {"sim-cell", "robot-sim"}
    assert profile("real") == same | {"real-cell", "gateway", "sensor"}
    assert profile("emulated") == same | {"emulated-cell", "gateway", "sensor", "controller-sim"}


@pytest.mark.parametrize("name", sorted({*ROLES, "panel", "recorder"} - {"robot", "sensor"}))
def test_the_word_changes_no_other_container(name: str) -> None:
    """What does not play robot or sensor belongs to no profile, and nothing in it reads one."""
    assert "profiles" not in SERVICES[name]
    assert variables(SERVICES[name]) <= {
        "FORCEMESH_FILES", "FORCEMESH_USER", "FORCEMESH_PUBLISH", "FORCEMESH_PANEL_TOKEN",
    }  # fmt: skip


@process
def test_the_cell_file_changes_no_container_but_the_one_that_says_it(name: str) -> None:
    """CELL is read in one place; what runs in two profiles runs there with the same settings."""
    assert "CELL" not in variables(SERVICES[name])


@pytest.mark.skipif(not compose_command(), reason="compose is not installed")
def test_compose_itself_reads_the_same_in_every_other_container(tmp_path: Path) -> None:
    """As it understands the file, neither the profile nor CELL changes any container but one."""
    read = {
        (word, file): understood(word, tmp_path, CELL=file)
        for word in PROFILES
        for file in ("", "mine.yaml")
    }
    for (word, file), containers in read.items():
        assert set(containers) >= profile(word)
        for name in profile(word) - {f"{word}-cell"}:
            everywhere = [other[name] for other in read.values() if name in other]
            assert all(entry == containers[name] for entry in everywhere), (name, file)
    assert read["sim", ""]["sim-cell"] != read["sim", "mine.yaml"]["sim-cell"]


def understood(word: str, pki: Path, **environment: str) -> dict[str, Any]:
    """Return the containers as compose says that it understands them."""
    around = {"PATH": os.environ["PATH"], "FORCEMESH_PKI": str(pki), **environment}
    command = [*compose_command(), "-f", str(COMPOSE_FILE), "--profile", word, "config"]
    done = subprocess.run(command, env=around, capture_output=True, text=True, check=True, cwd=pki)
    containers: dict[str, Any] = yaml.safe_load(done.stdout)["services"]
    return containers


@pytest.mark.parametrize("word", PROFILES)
def test_a_profile_says_its_cell_file_in_one_place(word: str) -> None:
    """Its own container does, alone in its profile; CELL names another file."""
    entry = SERVICES[f"{word}-cell"]
    assert entry["profiles"] == [word]
    assert entry["command"] == ["python", "-m", "common.in_use", "keep", word]
    assert entry["healthcheck"]["test"][1:] == ["python", "-m", "common.in_use", "check", word]
    assert entry["environment"] == {"FORCEMESH_CELL": f"/cells/${{CELL:-{CELL_OF[word]}}}"}
    assert "entrypoint" not in entry


@pytest.mark.parametrize("word", PROFILES)
def test_the_cell_file_of_a_profile_fits_its_players(word: str) -> None:
    """Its robot and sensor are containers of the profile; there is none for a real robot."""
    complaint = misfit(Choice(word, ROOT / "cells" / CELL_OF[word]))
    assert complaint == "" if CELL_OF[word] else "CELL=my-cell.yaml" in complaint
    assert set(PLAYERS) == set(PROFILES)


@process
def test_container_waits_for_the_cell_file_of_a_profile_in_which_it_is(name: str) -> None:
    """It starts when one is in use: any, or for who plays robot or sensor one of its own."""
    entry = SERVICES[name]
    assert entry["entrypoint"] == [*WAIT, *entry.get("profiles", []), "--"]
    test = entry["healthcheck"]["test"]
    if "profiles" in entry and name in ON_THE_BUS:
        # Another one may play its role: it is not well because that one is.
        assert test[1 : len(entry["entrypoint"]) + 1] == entry["entrypoint"]


def test_what_says_the_cell_file_is_in_memory_and_ends_with_the_containers() -> None:
    """Nothing of one run is left for the next one; it is small and holds no programs."""
    options = COMPOSE["volumes"]["in-use"]["driver_opts"]
    assert (options["type"], options["device"]) == ("tmpfs", "tmpfs")
    assert {"size=64k", "noexec", "nosuid", "nodev"} <= set(options["o"].split(","))


@pytest.mark.parametrize("word", PROFILES)
def test_make_up_is_compose_with_that_word_alone(word: str) -> None:
    """No second word; it ends with why the cell file is not in use, where it is not."""
    outside = {k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS"))}
    command = ["make", "-n", "up", f"PROFILE={word}", "COMPOSE=compose"]
    done = subprocess.run(
        command, cwd=ROOT, env=outside, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[1:] == [
        f"compose --profile {word} up -d --build ",
        f"compose --profile {word} exec -T {word}-cell python -m common.in_use check {word}",
    ]
