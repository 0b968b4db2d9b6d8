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
from tests.unit.repository.test_dependencies import EXTRAS
from tests.unit.repository.test_repository import IMAGE_EXTRAS

ENDPOINT = "${FORCEMESH_BUS:-tcp}/hub:7447"
HUB, PANEL = (f"${{FORCEMESH_PUBLISH_{port}:-127.0.0.1}}" for port in ("HUB", "PANEL"))
WATCHED_S = 60
service = pytest.mark.parametrize("name", SERVICES)
process = pytest.mark.parametrize("name", RUN)


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


def override(name: str) -> dict[str, dict[str, Any]]:
    """Return the services of a file on top of docker-compose.yml, which must be valid as well."""
    path = ROOT / f"docker-compose.{name}.yml"
    assert schema_check(path) == 0
    tree: dict[str, dict[str, dict[str, Any]]] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return tree["services"]


def test_compose_file_follows_the_compose_specification(tmp_path: Path) -> None:
    """Of 1.29, which Debian ships, too; a typo cannot switch hardening off."""
    assert schema_check(COMPOSE_FILE) == 0
    wrong = tmp_path / "docker-compose.yml"
    wrong.write_text(COMPOSE_FILE.read_text(encoding="utf-8").replace("read_only:", "readonly:"))
    assert schema_check(wrong) != 0
    newer = {"start_interval", "additional_contexts", "dockerfile_inline", "develop", "include"}
    assert not keys(COMPOSE) & newer
    assert "name" not in COMPOSE
    assert all(isinstance(entry.get("depends_on", []), list) for entry in SERVICES.values())


@pytest.mark.parametrize("word", PROFILES)
def test_each_role_is_played_exactly_once_in_a_profile(word: str) -> None:
    """Each profile is a whole cell, in which no two containers write the same topics."""
    played = sorted(role for name in profile(word) for role in roles_of(name))
    assert played == sorted((*ROLES, *HELPERS))


@service
def test_image_of_a_container_has_what_its_process_imports(name: str) -> None:
    """A kind for each container; those that judge a cell file need the base alone."""
    entry = SERVICES[name]
    kind = entry["build"]["args"]["KIND"]
    assert entry["image"] == f"forcemesh-{kind}:local"
    extras = EXTRAS.get(entry["command"][2], ())  # test_dependencies.py lists every process
    assert set(extras) <= set(IMAGE_EXTRAS[kind])
    assert (ROOT / f"requirements-{kind}.lock").exists()


@process
def test_container_runs_the_module_of_its_name_with_its_own_key(name: str) -> None:
    """Container `x` runs services.x, `x-sim` runs sim.x; a role has its own certificate."""
    python, flag, module, *words = SERVICES[name]["command"]
    expected = f"sim.{name.removesuffix('-sim')}" if name.endswith("-sim") else f"services.{name}"
    assert (python, flag, module) == ("python", "-m", expected)
    assert words[words.index("--cell") + 1] == CELL
    assert importlib.util.find_spec(f"{module}.__main__") is not None
    if roles := roles_of(name):
        role = "robot" if "robot" in roles else name
        assert role in roles
        assert SERVICES[name]["secrets"] == ["ca.pem", f"{role}.pem", f"{role}.key"]


def test_health_of_a_container_is_its_own_heartbeat_within_half_a_minute() -> None:
    """A few lines of shell read the file of the process: no Python, nothing of the bus."""
    for entry in SERVICES.values():
        assert entry["healthcheck"]["test"] == ["CMD", "sh", "common/runtime/alive.sh", "watch"]
        named = entry["environment"]["FORCEMESH_HEARTBEAT"]
        assert named.startswith("/tmp/")  # noqa: S108 - in the container, in memory
    assert "python" not in (ROOT / "common" / "runtime" / "alive.sh").read_text(encoding="utf-8")
    health = COMPOSE["x-contained"]["healthcheck"]
    assert health["interval"] == "5s"
    assert int(health["timeout"][:-1]) > WATCHED_S


def test_secrets_are_files_and_never_the_authoritys_key() -> None:
    """Each secret is the file of its name in the folder of `make pki`; ca.key is none of them."""
    assert "ca.key" not in COMPOSE["secrets"]
    for name, entry in COMPOSE["secrets"].items():
        assert entry == {"file": f"${{FORCEMESH_PKI:-./tools/no-certificates}}/{name}"}
    used = {name for entry in SERVICES.values() for name in entry.get("secrets", [])}
    assert used == set(COMPOSE["secrets"])


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
    assert entry["user"] == "${FORCEMESH_USER:-10001:10001}"
    assert entry["tmpfs"] == ["/tmp:noexec,nosuid,nodev,size=16m"]  # noqa: S108 - in there
    assert entry["mem_limit"]
    assert entry["pids_limit"]
    assert entry["restart"] == "unless-stopped"
    more = {
        "wrench": ["${FORCEMESH_CALIBRATION:-calibration}:/calibration:ro"],
        "panel": ["${FORCEMESH_CALIBRATION:-calibration}:/calibration"],
        "recorder": ["${FORCEMESH_RECORDINGS:-recordings}:/recordings"],
    }
    in_use = "in-use:/in-use" if name in STATE_CELL else "in-use:/in-use:ro"
    assert entry["volumes"] == ["./cells:/cells:ro", in_use, *more.get(name, [])]


def test_networks_lead_only_where_a_container_has_to_go() -> None:
    """The bus reaches nothing outside; emulated hardware has no certificate and no bus."""
    assert COMPOSE["networks"]["bus"] == {"internal": True}
    assert all("bus" in SERVICES[name]["networks"] for name in [*ON_THE_BUS, "recorder"])
    outward = {name: set(SERVICES[name]["networks"]) - {"bus"} for name in RUN}
    assert {name: networks for name, networks in outward.items() if networks} == {
        "hub": {"front"},
        "panel": {"front"},
        "gateway": {"robot"},
        "sensor": {"sensor"},
        "controller-sim": {"robot", "sensor"},
    }
    assert not SERVICES["controller-sim"].keys() & {"secrets"}
    assert "bus" not in SERVICES["controller-sim"]["networks"]
    for name, entry in SERVICES.items():
        assert entry.get("network_mode") == ("none" if name in STATE_CELL else None)
        if name in STATE_CELL:  # it writes one link for the others
            assert not entry.keys() & {"secrets", "networks", "ports", "depends_on"}
    published = {name: entry["ports"] for name, entry in SERVICES.items() if "ports" in entry}
    assert published == {"hub": [f"{HUB}:7447:7447"], "panel": [f"{PANEL}:8080:8080"]}


def test_containers_get_their_endpoint_and_the_published_addresses() -> None:
    """The hub listens, the others name it; the start-up check judges what compose publishes."""
    for name in [*ON_THE_BUS, "panel", "recorder"]:
        endpoint = ENDPOINT.replace("hub", "0.0.0.0") if name == "hub" else ENDPOINT
        assert SERVICES[name]["environment"]["FORCEMESH_ENDPOINT"] == endpoint
    for name in [*ON_THE_BUS, "panel"]:
        assert SERVICES[name]["environment"]["FORCEMESH_HUB_PUBLISHED"] == HUB
    for name in STATE_CELL:
        assert SERVICES[name]["environment"]["FORCEMESH_PUBLISH_HUB"] == HUB
    assert SERVICES["panel"]["environment"]["FORCEMESH_PANEL_PUBLISHED"] == PANEL
    page = ["panel-page.pem", "panel-page.key"]  # for browsers, where it is published wider
    assert SERVICES["panel"]["secrets"] == ["ca.pem", "panel.pem", "panel.key", *page]


def test_the_real_time_override_gives_a_limit_and_nothing_else() -> None:
    """On top of the file it only lets the loops of the bus go first."""
    limits = {"ulimits": {"core": 0, "rtprio": 20, "memlock": -1}}
    assert override("realtime") == dict.fromkeys(ON_THE_BUS, limits)


def test_a_role_on_another_machine_gets_the_endpoint_of_its_hub() -> None:
    """The override adds a route out and requires the endpoint; the hub stays where it is."""
    remote = override("remote")
    assert set(remote) == set(ON_THE_BUS) - {"hub", "robot-sim"}
    for entry in remote.values():
        assert entry["networks"] == ["front"]
        assert entry["environment"]["FORCEMESH_ENDPOINT"].startswith("${FORCEMESH_ENDPOINT:?")
        assert entry["environment"]["FORCEMESH_HUB_PUBLISHED"] == ""  # its wire leaves the machine


# --- the image ------------------------------------------------------------------------------------


def dockerfile_stages() -> list[list[str]]:
    """Return the instructions of each stage, continued lines joined, comments left out."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert "syntax=" not in text  # it builds without a registry's frontend
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    instructions = "\n".join(lines).replace("\\\n", " ").splitlines()
    starts = [i for i, line in enumerate(instructions) if line.startswith("FROM ")]
    return [instructions[a:b] for a, b in zip(starts, [*starts[1:], None], strict=True)]


def test_final_stage_builds_nothing_and_does_not_run_as_root() -> None:
    """It copies the build: neither compiler nor installer; signals reach the process itself."""
    final = dockerfile_stages()[-1]
    tools = r"\b(gcc|g\+\+|clang|cmake|build-essential|cargo|rustc|make|python3-dev|pip|uv)\b"
    assert not re.search(tools, "\n".join(final))
    assert len({stage[0].split()[1] for stage in dockerfile_stages()}) == 1
    users = [line.split()[1] for line in final if line.startswith("USER ")]
    assert users
    assert all(re.fullmatch(r"[1-9]\d*:[1-9]\d*", user) for user in users)
    starts = [line for line in final if line.startswith(("CMD", "ENTRYPOINT"))]
    assert all(line.split(None, 1)[1].startswith("[") for line in starts)


def test_build_copies_what_is_let_in_and_installs_the_versions_of_the_lock() -> None:
    """With hashes, or the checkout itself without dependencies; each copied path exists."""
    build = dockerfile_stages()[0]
    installs = [line for line in build if "pip install" in line]
    locked = "--require-hashes --only-binary :all:"
    assert "requirements-$KIND.lock" in "\n".join(build)
    own = "--no-deps --no-build-isolation -e ."
    assert [locked in line or own in line for line in installs] == [True, True]
    ignore = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    let_in = {line.removeprefix("!") for line in ignore if line.startswith("!")}
    lines = [line.split()[1:-1] for line in build if line.startswith("COPY ")]
    copied = {
        source.replace("$KIND", kind) for line in lines for source in line for kind in IMAGE_EXTRAS
    }
    assert copied == let_in
    assert all((ROOT / source).exists() for source in copied)
