"""The container files, checked without an engine: schema, names, commands, permissions."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from forcemesh.topics import HELPERS, ROLES
from tests.fakes.compose_file import (
    CELL,
    COMPOSE,
    COMPOSE_FILE,
    ON_THE_BUS,
    PROFILES,
    ROOT,
    RUN,
    SERVICES,
    STATE_CELL,
    profile,
    roles_of,
)

SCHEME = "${FORCEMESH_BUS:-tcp}"
PUBLISHED = {port: f"${{FORCEMESH_PUBLISH_{port}:-127.0.0.1}}" for port in ("HUB", "PANEL")}
WATCHED_S = 60
service = pytest.mark.parametrize("name", SERVICES)
process = pytest.mark.parametrize("name", RUN)
on_the_bus = pytest.mark.parametrize("name", ON_THE_BUS)
with_a_role = pytest.mark.parametrize("name", [name for name in SERVICES if roles_of(name)])


def keys(tree: Any) -> set[str]:
    """Return every key of a tree of maps and lists."""
    if isinstance(tree, dict):
        return set(tree).union(*(keys(value) for value in tree.values()))
    if isinstance(tree, list):
        return set().union(*(keys(item) for item in tree))
    return set()


def schema_check(path: Path) -> int:
    """Return the exit code of the compose specification's own schema on a file."""
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    return subprocess.run([*command, str(path)], capture_output=True, check=False).returncode


def test_compose_file_follows_the_compose_specification() -> None:
    """The file is valid against the schema that compose itself uses."""
    assert schema_check(COMPOSE_FILE) == 0


def test_a_misspelt_setting_is_not_valid(tmp_path: Path) -> None:
    """The schema check refuses an unknown setting, so that a typo cannot switch hardening off."""
    wrong = tmp_path / "docker-compose.yml"
    wrong.write_text(COMPOSE_FILE.read_text(encoding="utf-8").replace("read_only:", "readonly:"))
    assert schema_check(wrong) != 0


def test_compose_file_holds_nothing_that_version_1_refuses() -> None:
    """Debian still ships compose 1.29: none of the settings that it does not know are used."""
    newer = {"start_interval", "additional_contexts", "dockerfile_inline", "develop", "include"}
    assert not keys(COMPOSE) & newer
    assert "name" not in COMPOSE
    assert all(isinstance(entry.get("depends_on", []), list) for entry in SERVICES.values())


@pytest.mark.parametrize("word", PROFILES)
def test_each_role_is_played_exactly_once_in_a_profile(word: str) -> None:
    """Each profile is a whole cell, in which no two containers write the same topics."""
    played = sorted(role for name in profile(word) for role in roles_of(name))
    assert played == sorted((*ROLES, *HELPERS))


@process
def test_container_runs_the_module_of_its_name(name: str) -> None:
    """One name: container `x` runs services.x, container `x-sim` runs sim.x, and both exist."""
    python, flag, module, *words = SERVICES[name]["command"]
    expected = f"sim.{name.removesuffix('-sim')}" if name.endswith("-sim") else f"services.{name}"
    assert (python, flag, module) == ("python", "-m", expected)
    assert words[words.index("--cell") + 1] == CELL
    assert importlib.util.find_spec(f"{module}.__main__") is not None


@service
def test_health_of_a_container_is_its_own_heartbeat(name: str) -> None:
    """A few lines of shell read the file that its process writes: no Python, nothing of the bus."""
    entry = SERVICES[name]
    assert entry["healthcheck"]["test"] == ["CMD", "sh", "common/runtime/alive.sh", "watch"]
    named = entry["environment"]["FORCEMESH_HEARTBEAT"]
    assert named.startswith("/tmp/")  # noqa: S108 - in the container, in memory
    assert "python" not in (ROOT / "common" / "runtime" / "alive.sh").read_text(encoding="utf-8")


def test_health_is_known_well_within_half_a_minute() -> None:
    """The first check comes after seconds; one that is well is asked again only after a minute."""
    health = COMPOSE["x-contained"]["healthcheck"]
    assert health["interval"] == "5s"
    assert int(health["timeout"][:-1]) > WATCHED_S


@with_a_role
def test_container_has_its_own_key_and_no_other(name: str) -> None:
    """The secrets are the authority's certificate and the pair of the role that it connects as."""
    role = "robot" if "robot" in roles_of(name) else name
    assert SERVICES[name]["secrets"] == ["ca.pem", f"{role}.pem", f"{role}.key"]
    assert role in roles_of(name)


def test_secrets_are_files_and_never_the_authoritys_key() -> None:
    """Each secret is the file of its name in the folder of `make pki`; ca.key is none of them."""
    assert "ca.key" not in COMPOSE["secrets"]
    for name, entry in COMPOSE["secrets"].items():
        assert entry == {"file": f"${{FORCEMESH_PKI:-./tools/no-certificates}}/{name}"}
    used = {name for entry in SERVICES.values() for name in entry.get("secrets", [])}
    assert used == set(COMPOSE["secrets"])


@pytest.mark.parametrize("name", STATE_CELL)
def test_the_publisher_of_the_cell_file_has_no_key_and_no_network(name: str) -> None:
    """It writes one link for the others, and has no network."""
    assert not SERVICES[name].keys() & {"secrets", "networks", "ports", "depends_on"}


def test_emulated_hardware_has_no_access_to_the_bus() -> None:
    """The emulated controller has two wires, no certificate and no connection to the hub."""
    entry = SERVICES["controller-sim"]
    assert "secrets" not in entry
    assert set(entry["networks"]) == {"robot", "sensor"}


@service
def test_container_may_do_nothing_but_its_work(name: str) -> None:
    """Read-only, no capabilities, no root, bounded in memory, processes and log."""
    entry = SERVICES[name]
    assert entry["read_only"] is True
    assert entry["cap_drop"] == ["ALL"]
    assert entry["security_opt"] == ["no-new-privileges:true"]
    assert entry["init"] is True
    assert entry["logging"]["options"].keys() == {"max-size", "max-file"}
    assert not entry.keys() & {"privileged", "cap_add", "devices", "pid"}
    assert entry.get("network_mode") == ("none" if name in STATE_CELL else None)
    assert entry["user"] == "${FORCEMESH_USER:-10001:10001}"
    assert entry["tmpfs"] == ["/tmp:noexec,nosuid,nodev,size=16m"]  # noqa: S108 - in there
    assert entry["mem_limit"]
    assert entry["pids_limit"]
    assert entry["restart"] == "unless-stopped"
    assert entry["healthcheck"]["test"][0] == "CMD"
    more = {
        "wrench": ["${FORCEMESH_CALIBRATION:-calibration}:/calibration:ro"],
        "panel": ["${FORCEMESH_CALIBRATION:-calibration}:/calibration"],
        "recorder": ["${FORCEMESH_RECORDINGS:-recordings}:/recordings"],
    }
    in_use = "in-use:/in-use" if name in STATE_CELL else "in-use:/in-use:ro"
    assert entry["volumes"] == ["./cells:/cells:ro", in_use, *more.get(name, [])]


def test_hub_and_panel_are_published_and_only_on_this_machine() -> None:
    """Two ports, on the loopback address unless the user sets another one, each by itself."""
    published = {name: entry["ports"] for name, entry in SERVICES.items() if "ports" in entry}
    assert published == {
        "hub": [f"{PUBLISHED['HUB']}:7447:7447"],
        "panel": [f"{PUBLISHED['PANEL']}:8080:8080"],
    }


def test_containers_get_the_published_addresses() -> None:
    """The start-up check judges the same address that compose publishes."""
    for name in [*ON_THE_BUS, "panel"]:
        assert SERVICES[name]["environment"]["FORCEMESH_HUB_PUBLISHED"] == PUBLISHED["HUB"]
    assert SERVICES["panel"]["environment"]["FORCEMESH_PANEL_PUBLISHED"] == PUBLISHED["PANEL"]
    for name in STATE_CELL:
        environment = SERVICES[name]["environment"]
        assert environment["FORCEMESH_HUB_PUBLISHED"] == PUBLISHED["HUB"]
        assert environment["FORCEMESH_PANEL_PUBLISHED"] == PUBLISHED["PANEL"]
        assert environment["FORCEMESH_CERTIFICATES"] == "${FORCEMESH_PKI:-}"


def test_panel_requires_its_token_and_has_its_own_certificate() -> None:
    """Reached from outside this machine it requires a token; on the bus it is a person."""
    entry = SERVICES["panel"]
    assert entry["command"][-2:] == ["--host", "0.0.0.0"]
    given = entry["environment"]["FORCEMESH_PANEL_TOKEN"]
    assert given == "${FORCEMESH_PANEL_TOKEN:-}"
    assert entry["environment"]["FORCEMESH_ENDPOINT"] == f"{SCHEME}/hub:7447"
    page = ["panel-page.pem", "panel-page.key"]  # for browsers, where it is published wider
    assert entry["secrets"] == ["ca.pem", "panel.pem", "panel.key", *page]


def test_recorder_writes_into_its_folder_alone() -> None:
    """On the bus it is itself, by its own certificate; its recordings are outside of the image."""
    entry = SERVICES["recorder"]
    assert entry["environment"]["FORCEMESH_RECORDINGS"] == "/recordings"
    assert entry["environment"]["FORCEMESH_ENDPOINT"] == f"{SCHEME}/hub:7447"
    assert entry["networks"] == ["bus"]


def test_networks_lead_only_where_a_container_has_to_go() -> None:
    """The bus reaches nothing outside; only gateway and sensor have a network to their hardware."""
    outward = {name: set(SERVICES[name]["networks"]) - {"bus"} for name in RUN}
    assert COMPOSE["networks"]["bus"] == {"internal": True}
    assert all("bus" in SERVICES[name]["networks"] for name in ON_THE_BUS)
    assert {name: networks for name, networks in outward.items() if networks} == {
        "hub": {"front"},
        "panel": {"front"},
        "gateway": {"robot"},
        "sensor": {"sensor"},
        "controller-sim": {"robot", "sensor"},
    }


@on_the_bus
def test_endpoint_is_explicit_and_encrypted_where_there_are_certificates(name: str) -> None:
    """No process searches for its hub: the hub listens, the others name it, all alike."""
    host = "0.0.0.0" if name == "hub" else "hub"
    assert SERVICES[name]["environment"] == {
        "FORCEMESH_ENDPOINT": f"{SCHEME}/{host}:7447",
        "FORCEMESH_HUB_PUBLISHED": PUBLISHED["HUB"],
        "FORCEMESH_PKI": "/run/secrets",
        "FORCEMESH_CELL": CELL,
        "FORCEMESH_HEARTBEAT": "/tmp/alive",  # noqa: S108 - in the container, in memory
    }


def test_the_real_time_override_gives_a_limit_and_nothing_else() -> None:
    """On top of the file it only lets the loops of the bus go first; it is valid as well."""
    path = ROOT / "docker-compose.realtime.yml"
    override = yaml.safe_load(path.read_text(encoding="utf-8"))["services"]
    assert set(override) == set(ON_THE_BUS)
    assert all(
        entry == {"ulimits": {"core": 0, "rtprio": 20, "memlock": -1}}
        for entry in override.values()
    )
    assert schema_check(path) == 0


def test_a_role_on_another_machine_gets_the_endpoint_of_its_hub() -> None:
    """The override adds a route out and requires the endpoint; the hub stays where it is."""
    path = ROOT / "docker-compose.remote.yml"
    override = yaml.safe_load(path.read_text(encoding="utf-8"))["services"]
    assert set(override) == set(ON_THE_BUS) - {"hub", "robot-sim"}
    for entry in override.values():
        assert entry["networks"] == ["front"]
        assert entry["environment"]["FORCEMESH_ENDPOINT"].startswith("${FORCEMESH_ENDPOINT:?")
        assert entry["environment"]["FORCEMESH_HUB_PUBLISHED"] == ""  # its wire leaves the machine
    assert schema_check(path) == 0


def dockerfile_stages() -> list[list[str]]:
    """Return the instructions of each stage, continued lines joined, comments left out."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    instructions = "\n".join(lines).replace("\\\n", " ").splitlines()
    starts = [i for i, line in enumerate(instructions) if line.startswith("FROM ")]
    return [instructions[a:b] for a, b in zip(starts, [*starts[1:], None], strict=True)]


def test_image_does_not_run_as_root() -> None:
    """The last word on the user is a number that is not root's."""
    users = [line.split()[1] for line in dockerfile_stages()[-1] if line.startswith("USER ")]
    assert users
    assert all(re.fullmatch(r"[1-9]\d*:[1-9]\d*", user) for user in users)


def test_final_stage_builds_nothing() -> None:
    """The final image has neither compiler nor installer's leftovers: it copies the build."""
    final = "\n".join(dockerfile_stages()[-1])
    tools = r"\b(gcc|g\+\+|clang|cmake|build-essential|cargo|rustc|make|python3-dev|pip|uv)\b"
    assert not re.search(tools, final)
    assert len({stage[0].split()[1] for stage in dockerfile_stages()}) == 1


def test_image_holds_the_versions_of_the_lock() -> None:
    """Everything that is installed has a hash, or is the checkout itself without dependencies."""
    installs = [line for line in dockerfile_stages()[0] if "pip install" in line]
    locked = "--require-hashes --only-binary :all: -r requirements-run.lock"
    own = "--no-deps --no-build-isolation -e ."
    assert [locked in line or own in line for line in installs] == [True, True]


def test_dockerfile_needs_no_frontend_and_no_shell_to_start() -> None:
    """It builds without a registry's frontend, and signals reach the process itself."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert "syntax=" not in text
    assert all(
        line.split(None, 1)[1].startswith("[")
        for stage in dockerfile_stages()
        for line in stage
        if line.startswith(("CMD", "ENTRYPOINT"))
    )


def test_build_context_holds_just_the_copied_paths() -> None:
    """Each path that the image copies exists and is let in; nothing else is let in."""
    ignore = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    let_in = {line.removeprefix("!") for line in ignore if line.startswith("!")}
    copied = {
        source
        for line in dockerfile_stages()[0]
        if line.startswith("COPY ")
        for source in line.split()[1:-1]
    }
    assert copied == let_in
    assert all((ROOT / source).exists() for source in copied)
