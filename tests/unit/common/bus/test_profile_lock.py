"""One cell has one cell file, which fits the profile: publication, waiting, refusals."""

import os
from collections.abc import Iterable
from pathlib import Path

import pytest

from common.bus.profile_fit import IMPLEMENTATIONS, Choice, problem_with, unsafe
from common.bus.profile_lock import acquire, chosen, hold
from common.config.load import load_cell

ROOT = Path(__file__).resolve().parents[4]
CELLS = ROOT / "cells"
SIM = Choice("sim", CELLS / "demo.yaml")
EMULATED = Choice("emulated", CELLS / "emulated.yaml")
REAL = Choice("real", CELLS / "emulated.yaml")  # it has the implementations of a real one
SAFE = {
    "FORCEMESH_BUS": "tls", "FORCEMESH_CERTIFICATES": "pki", "FORCEMESH_PANEL_TOKEN": "0" * 32,
    "FORCEMESH_CALIBRATION": "./calibration",
}  # fmt: skip


def end(lock: int | None) -> None:
    """End the process that has a lock."""
    assert lock is not None
    os.close(lock)


# --- the lock -------------------------------------------------------------------------------------


def test_a_published_choice_is_in_use_for_the_containers_of_its_profile(tmp_path: Path) -> None:
    """The link leads to the cell file; the robot of another profile stays out."""
    assert chosen(tmp_path) is None
    assert hold(tmp_path, ()) is None
    acquire(tmp_path, SIM)
    assert (tmp_path / "cell.yaml").resolve() == SIM.file
    for profiles in ((), ("sim",), ("emulated", "sim")):
        assert hold(tmp_path, profiles) is not None
    assert hold(tmp_path, ("emulated", "real")) is None
    assert acquire(tmp_path, SIM) is not None  # started anew


@pytest.mark.parametrize(
    "other", [EMULATED, Choice("sim", EMULATED.file), Choice("real", SIM.file)]
)
def test_another_choice_is_refused_while_any_process_runs(tmp_path: Path, other: Choice) -> None:
    """One process of the cell is enough; the container that published it may have ended."""
    claimed = acquire(tmp_path, SIM)
    runs = hold(tmp_path, ())
    end(claimed)
    assert acquire(tmp_path, other) is None
    assert chosen(tmp_path) == SIM
    end(runs)
    assert acquire(tmp_path, other) is not None
    assert chosen(tmp_path) == other


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
