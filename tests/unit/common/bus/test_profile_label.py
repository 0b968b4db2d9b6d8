"""One cell has one profile and cell file: refusal, replacement of the simulation, requirements."""

import os
import subprocess
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import pytest

from common.bus import profile_label
from common.bus.profile_label import (
    IMPLEMENTATIONS,
    LABEL,
    WAITS,
    hold,
    in_use,
    is_held,
    problem_with,
    put,
)
from common.config.load import load_cell
from common.runtime.heartbeat import HEARTBEAT_VARIABLE
from forcemesh.clock import MonotonicClock, wait_until

ROOT = Path(__file__).resolve().parents[4]
CELLS = ROOT / "cells"
DEMO, EMULATED = CELLS / "demo.yaml", CELLS / "emulated.yaml"
SAFE = {
    "FORCEMESH_BUS": "tls", "FORCEMESH_PKI": "pki", "FORCEMESH_PANEL_TOKEN": "0" * 32,
    "FORCEMESH_CALIBRATION": "./calibration",
}  # fmt: skip
# An emulated controller has the implementations of a real one.
FILE_OF = {"sim": "demo.yaml", "emulated": "emulated.yaml", "real": "emulated.yaml"}
RUN = "import sys; from pathlib import Path; from common.bus.profile_label import main; "
RUN += "sys.exit(main(sys.argv[2:], Path(sys.argv[1])))"


def test_the_first_profile_stays_and_a_second_one_is_refused(tmp_path: Path) -> None:
    """While a process runs, another profile or file is refused: what is in use, and a remedy."""
    with hold(tmp_path, "emulated", "w"):
        assert put(tmp_path, "emulated", EMULATED) == ""
        assert put(tmp_path, "real", DEMO) == (
            f"the profile emulated is in use with {EMULATED}, and a cell has only one profile and "
            "file: first `docker compose --profile emulated down`, or remove this one: "
            "`docker compose --profile real rm -s -f real-cell`"
        )
        assert "a cell has only one profile and file" in put(tmp_path, "emulated", DEMO)
        assert put(tmp_path, "emulated", EMULATED) == ""  # started anew
        assert (tmp_path / LABEL).resolve() == EMULATED
    put(tmp_path, "sim", DEMO)
    assert (in_use(tmp_path), (tmp_path / LABEL).resolve()) == ("sim", DEMO)


@pytest.mark.parametrize("order", [("sim", "emulated"), ("emulated", "sim")])
def test_the_simulation_is_replaced_in_either_order(tmp_path: Path, order: list[str]) -> None:
    """Compose starts its containers with every profile, in any order."""
    with hold(tmp_path, "sim", "w"), hold(tmp_path, "emulated", "w"):
        for profile in order:
            put(tmp_path, profile, CELLS / FILE_OF[profile])
        assert (in_use(tmp_path), (tmp_path / LABEL).resolve()) == ("emulated", EMULATED)
        standby = put(tmp_path, "sim", DEMO)
        assert standby.startswith("on standby: the profile emulated replaces the simulation")


def test_a_profile_with_a_mistake_leaves_nothing_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It replaces the simulation, yet leads to no file until the mistake is corrected."""
    put(tmp_path, "sim", DEMO)
    with hold(tmp_path, "real", "w"):
        assert "needs FORCEMESH_PKI" in put(tmp_path, "real", EMULATED)
        assert in_use(tmp_path) == "real"
        assert not (tmp_path / LABEL).exists()
        assert "the profile real is in use" in put(tmp_path, "emulated", EMULATED)
        monkeypatch.setattr(profile_label, "problem_with", lambda *_: "")
        assert put(tmp_path, "real", EMULATED) == ""
        assert (tmp_path / LABEL).resolve() == EMULATED


def start(folder: Path, exits: ExitStack, *words: str) -> subprocess.Popen[str]:
    """Start a container's process, which prints the profile in use."""
    shows = f"import os, time; print(os.readlink('{folder}/{LABEL}'), flush=True); time.sleep(60)"
    command = [sys.executable, "-c", RUN, str(folder), "run", *words, "--", sys.executable, "-c"]
    environment = {**os.environ, HEARTBEAT_VARIABLE: str(folder / "-".join(["alive", *words]))}
    process = subprocess.Popen(
        [*command, shows], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    )
    exits.enter_context(process)
    exits.callback(process.terminate)
    return process


def first_line(process: subprocess.Popen[str]) -> str:
    """Return what a process prints at its start."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


def health(path: Path) -> str:
    """Return the fault that a waiting process reports, after the seconds since boot."""
    clock = MonotonicClock()
    wait_until(clock, lambda: path.exists() and path.read_text(), within_s=10.0, poll_s=0.01)
    return path.read_text("ascii").strip().partition(" ")[2]


def test_a_process_runs_while_its_profile_is_in_use(tmp_path: Path) -> None:
    """It waits for a label of its own profiles, and ends with the label or with its container."""
    with ExitStack() as exits:
        exits.enter_context(hold(tmp_path, "emulated", "w"))
        hold(tmp_path, "sim", "w").close()
        put(tmp_path, "sim", DEMO)
        simulation, hub = start(tmp_path, exits, "sim"), start(tmp_path, exits)
        emulated = start(tmp_path, exits, "emulated")
        assert [first_line(simulation), first_line(hub)] == ["sim", "sim"]
        assert is_held(tmp_path, "sim")
        assert health(tmp_path / "alive-emulated") == WAITS
        put(tmp_path, "emulated", EMULATED)
        assert all(each.wait(10.0) for each in (simulation, hub))  # the engine starts them again
        assert not is_held(tmp_path, "sim")
        assert first_line(emulated) == "emulated"
        emulated.terminate()
        assert emulated.wait(10.0)
        (tmp_path / "alive-sim").unlink()
        start(tmp_path, exits, "sim")
        assert health(tmp_path / "alive-sim") == ""  # on standby is no fault


@pytest.mark.parametrize("profile", IMPLEMENTATIONS)
@pytest.mark.parametrize("file", ["demo.yaml", "emulated.yaml", "demo-netft.yaml", "demo-tcp.yaml"])
def test_a_profile_takes_only_a_cell_file_whose_implementations_it_starts(
    profile: str, file: str
) -> None:
    """Robot and sensor of the file are containers of the profile, or one sentence reports it."""
    roles = load_cell(CELLS / file).roles
    own = {"sim": ("sim", "sim")}.get(profile, ("gateway", "driver"))
    problem = problem_with(profile, CELLS / file, SAFE)
    assert (problem == "") == ((roles.robot, roles.sensor) == own)
    if problem:
        assert "use another profile" in problem
        assert "\n" not in problem


@pytest.mark.parametrize("profile", IMPLEMENTATIONS)
@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", "::", "labpc"])
def test_beyond_this_machine_the_hub_needs_certificates(profile: str, address: str) -> None:
    """One sentence names the setting; the panel refuses by itself."""
    wide = {"FORCEMESH_PUBLISH_HUB": address}
    problem = problem_with(profile, CELLS / FILE_OF[profile], wide)
    assert f"FORCEMESH_PUBLISH_HUB={address} is reachable from outside" in problem
    assert problem_with(profile, CELLS / FILE_OF[profile], {**SAFE, **wide}) == ""


@pytest.mark.parametrize(
    ("profile", "missing", "text"),
    [
        ("sim", SAFE, ""),  # as `docker compose up` starts it
        ("real", (), ""),
        ("real", ("FORCEMESH_BUS", "FORCEMESH_PKI"), "the profile real needs FORCEMESH_PKI"),
        ("real", ("FORCEMESH_PANEL_TOKEN",), "needs FORCEMESH_PANEL_TOKEN in .env"),
        ("real", ("FORCEMESH_CALIBRATION",), "needs FORCEMESH_CALIBRATION in .env"),
        ("sim", ("FORCEMESH_BUS",), "belong together"),
        ("sim", ("FORCEMESH_PKI",), "belong together"),
    ],
)
def test_a_real_cell_keeps_certificates_token_and_calibration(
    profile: str, missing: Iterable[str], text: str
) -> None:
    """Each that is missing is named, also when all is published on this machine alone."""
    settings = {name: value for name, value in SAFE.items() if name not in missing}
    problem = problem_with(profile, CELLS / FILE_OF[profile], settings)
    assert text in problem
    assert bool(text) == bool(problem)


def test_a_real_cell_needs_a_cell_file_of_its_own() -> None:
    """Without CELL compose names the folder of the cell files."""
    assert "needs your own cell file in cells/: CELL=my-cell.yaml" in problem_with("real", CELLS)
