"""One word swaps the robot: changes by a profile, and the one container that reads them."""

import os
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml

from common.bus.profile_fit import IMPLEMENTATIONS, Choice, problem_with, unsafe
from common.config.load import load_cell
from forcemesh.topics import HELPERS, ROLES
from tests.compose.rig import compose_command
from tests.fakes.compose_file import (
    CELL_OF,
    COMPOSE,
    COMPOSE_FILE,
    PROFILES,
    ROOT,
    RUN,
    SERVICES,
    STANDS_BACK,
    STATE_CELL,
    profile,
    variables,
)

SAFE = {
    "FORCEMESH_BUS": "tls", "FORCEMESH_CERTIFICATES": "pki", "FORCEMESH_PANEL_TOKEN": "0" * 32,
    "FORCEMESH_CALIBRATION": "./calibration",
}  # fmt: skip
WAIT = ["python", "-m", "common.bus.profile_lock", "run"]


def test_one_word_swaps_the_implementations_of_robot_and_sensor() -> None:
    """The profiles differ in implementation of robot and sensor, and in emulated hardware."""
    same = set(ROLES) - {"robot", "sensor"}
    same |= {"panel", *HELPERS}
    assert profile("sim") == same | {"sim-cell", "robot-sim"}
    assert profile("real") == same | {"real-cell", "gateway", "sensor"}
    assert profile("emulated") == same | {"emulated-cell", "gateway", "sensor", "controller-sim"}
    for name in same:
        assert "profiles" not in SERVICES[name]
        assert variables(SERVICES[name]) <= {
            "FORCEMESH_BUS", "FORCEMESH_CALIBRATION", "FORCEMESH_PANEL_TOKEN",
            "FORCEMESH_PUBLISH_HUB", "FORCEMESH_PUBLISH_PANEL", "FORCEMESH_RECORDINGS",
            "FORCEMESH_USER",
        }, name  # fmt: skip


def test_no_word_at_all_is_the_simulated_cell() -> None:
    """`docker compose up` starts a whole cell, and asks for nothing that a checkout does not have.

    No variable is required, and each file that is named is in the repository.
    """
    started = {name for name, entry in SERVICES.items() if "profiles" not in entry}
    assert started == profile("sim")
    assert ":?" not in COMPOSE_FILE.read_text("utf-8")
    for entry in COMPOSE["secrets"].values():
        file = entry["file"].replace("${FORCEMESH_PKI:-./", "").replace("}", "")
        assert "make pki" in (ROOT / file).read_text("utf-8")


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
        for name in profile(word) - set(STATE_CELL):
            everywhere = [other[name] for other in read.values() if name in other]
            assert all(entry == containers[name] for entry in everywhere), (name, file)
    assert read["sim", ""]["sim-cell"] != read["sim", "mine.yaml"]["sim-cell"]


def understood(word: str, pki: Path, **environment: str) -> dict[str, Any]:
    """Return the containers as compose resolves them."""
    around = {"PATH": os.environ["PATH"], "FORCEMESH_PKI": str(pki), **environment}
    command = [*compose_command(), "-f", str(COMPOSE_FILE), "--profile", word, "config"]
    done = subprocess.run(command, env=around, capture_output=True, text=True, check=True, cwd=pki)
    containers: dict[str, Any] = yaml.safe_load(done.stdout)["services"]
    return containers


@pytest.mark.parametrize("word", PROFILES)
def test_a_profile_names_its_cell_file_in_one_place(word: str) -> None:
    """Its own container does, alone in its profile; CELL names another file."""
    entry = SERVICES[f"{word}-cell"]
    assert entry.get("profiles", ["sim"]) == [word]
    assert entry["command"] == ["python", "-m", "common.bus.profile_lock", "keep", word]
    assert entry["environment"]["FORCEMESH_CELL"] == f"/cells/${{CELL:-{CELL_OF[word]}}}"
    assert {name for name, each in SERVICES.items() if "CELL" in variables(each)} == set(STATE_CELL)
    assert "entrypoint" not in entry


@pytest.mark.parametrize("word", PROFILES)
def test_the_cell_file_of_a_profile_fits_its_implementations(word: str) -> None:
    """Its robot and sensor are containers of the profile; there is none for a real robot."""
    problem = problem_with(Choice(word, ROOT / "cells" / CELL_OF[word]), SAFE)
    assert problem == "" if CELL_OF[word] else "CELL=my-cell.yaml" in problem
    assert set(IMPLEMENTATIONS) == set(PROFILES)


@pytest.mark.parametrize("name", RUN)
def test_container_waits_for_the_cell_file_of_a_profile_in_which_it_is(name: str) -> None:
    """It starts when a cell file is in use: any, or for robot and sensor one of its own profile."""
    entry = SERVICES[name]
    words = ["sim"] if name in STANDS_BACK else entry.get("profiles", [])
    assert entry["entrypoint"] == [*WAIT, *words, "--"]


def test_the_published_cell_file_is_in_memory_and_ends_with_the_containers() -> None:
    """No file of one run is left for the next one; it is small and holds no programs."""
    options = COMPOSE["volumes"]["in-use"]["driver_opts"]
    assert (options["type"], options["device"]) == ("tmpfs", "tmpfs")
    assert {"size=64k", "noexec", "nosuid", "nodev"} <= set(options["o"].split(","))


@pytest.mark.parametrize("word", ["", "emulated", "real"])
def test_make_up_is_compose_with_that_word_alone(word: str) -> None:
    """No second word, none for the simulation; a cell file that is not in use is explained."""
    outside = {k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS", "ARGS"))}
    command = ["make", "-n", "up", f"PROFILE={word}", "COMPOSE=compose"]
    done = subprocess.run(
        command, cwd=ROOT, env=outside, capture_output=True, text=True, check=True
    )
    compose, keeper = f"compose --profile {word}" if word else "compose", word or "sim"
    assert done.stdout.splitlines() == [
        f"{compose} up -d --build ",
        f"{compose} exec -T {keeper}-cell python -m common.bus.profile_lock check {keeper}",
    ]


# --- which cell file and which settings fit -------------------------------------------------------


@pytest.mark.parametrize("profile", IMPLEMENTATIONS)
@pytest.mark.parametrize("file", ["demo.yaml", "emulated.yaml", "demo-netft.yaml", "demo-tcp.yaml"])
def test_a_profile_takes_only_a_cell_file_whose_implementations_it_starts(
    profile: str, file: str
) -> None:
    """Robot and sensor of the file are containers of the profile, or one sentence reports it."""
    roles = load_cell(ROOT / "cells" / file).roles
    own = {"sim": ("sim", "sim")}.get(profile, ("gateway", "driver"))
    problem = problem_with(Choice(profile, ROOT / "cells" / file), SAFE)
    assert (problem == "") == ((roles.robot, roles.sensor) == own)
    if problem:
        assert "use another profile" in problem
        assert "\n" not in problem


@pytest.mark.parametrize("profile", IMPLEMENTATIONS)
@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", "::", "labpc"])
def test_beyond_this_machine_certificates_and_token_are_needed(profile: str, address: str) -> None:
    """The hub without certificates, the panel without certificates or token: one sentence each."""
    for port in ("HUB", "PANEL"):
        wide = {f"FORCEMESH_{port}_PUBLISHED": address}
        assert f"FORCEMESH_PUBLISH_{port}={address} is reachable from outside" in unsafe(
            profile, wide
        )
        assert unsafe(profile, {**SAFE, **wide}) == ""
    tokenless = {**SAFE, "FORCEMESH_PANEL_TOKEN": "", "FORCEMESH_PANEL_PUBLISHED": address}
    assert "FORCEMESH_PANEL_TOKEN" in unsafe(profile, tokenless)


@pytest.mark.parametrize(
    ("profile", "missing", "text"),
    [
        ("sim", SAFE, ""),  # as `docker compose up` starts it
        ("real", (), ""),
        ("real", ("FORCEMESH_BUS", "FORCEMESH_CERTIFICATES"), "needs certificates: `make pki"),
        ("real", ("FORCEMESH_PANEL_TOKEN",), "needs a token"),
        ("real", ("FORCEMESH_CALIBRATION",), "FORCEMESH_CALIBRATION"),
        ("sim", ("FORCEMESH_BUS",), "belong together"),
        ("sim", ("FORCEMESH_CERTIFICATES",), "belong together"),
    ],
)
def test_a_real_cell_keeps_certificates_token_and_calibration(
    profile: str, missing: Iterable[str], text: str
) -> None:
    """Each that is missing is named, also when all is published on this machine alone."""
    settings = {name: value for name, value in SAFE.items() if name not in missing}
    # An emulated controller has the implementations of a real one.
    file = "demo.yaml" if profile == "sim" else "emulated.yaml"
    problem = problem_with(Choice(profile, ROOT / "cells" / file), settings)
    assert text in problem
    assert bool(text) == bool(problem)


def test_the_setting_of_before_is_refused() -> None:
    """It is two now."""
    assert "two settings now" in unsafe("sim", {**SAFE, "FORCEMESH_PUBLISH": "192.168.1.7"})
