"""Checks of a container set-up: profile, cell file, and published addresses.

Without certificates and token a cell is limited to this machine: compose publishes hub and panel on
127.0.0.1 and passes the address to the containers, which refuse to start on any other address.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from forcemesh.published_ports import HUB_PUBLISHED, PANEL_PUBLISHED, is_loopback

# Implementations of robot and sensor in the containers of a profile.
IMPLEMENTATIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "sim": {"robot": ("sim",), "sensor": ("sim",)},
    "emulated": {"robot": ("gateway",), "sensor": ("driver",)},
    "real": {"robot": ("gateway", "external"), "sensor": ("driver", "external")},
}
# The simulation is the default: a requested profile replaces it.
REPLACED_BY: dict[str, tuple[str, ...]] = {"sim": ("emulated", "real")}

ENCRYPTED = "tls"
PKI, SCHEME, TOKEN = "FORCEMESH_CERTIFICATES", "FORCEMESH_BUS", "FORCEMESH_PANEL_TOKEN"
CALIBRATION, RENAMED = "FORCEMESH_CALIBRATION", "FORCEMESH_PUBLISH"


@dataclass(frozen=True, slots=True)
class Choice:
    """A profile and its cell file."""

    profile: str
    file: Path


def command_of(profile: str, verb: str) -> str:
    """Return the shell command of a compose verb for a profile."""
    word = "" if profile == "sim" else f"--profile {profile} "
    return f"docker compose {word}{verb}"


def problem_with(choice: Choice, settings: Mapping[str, str] = os.environ) -> str:
    """Return why a cell file cannot be used with its profile here, empty when it can."""
    if choice.file.is_dir():
        return (
            f"the profile {choice.profile} needs your own cell file in cells/: "
            f"CELL=my-cell.yaml {command_of(choice.profile, 'up')}"
        )
    if why := unsafe(choice.profile, settings):
        return why
    # Slow imports, not needed by a process that only waits.
    from common.config.load import load_cell  # noqa: PLC0415
    from forcemesh.errors import ConfigError  # noqa: PLC0415

    try:
        cell = load_cell(choice.file)
    except ConfigError as error:
        return str(error)
    for role, implementations in IMPLEMENTATIONS[choice.profile].items():
        if getattr(cell.roles, role) not in implementations:
            return _wrong_implementation(choice, role, getattr(cell.roles, role))
    if choice.profile == "real" and not (settings.get(TOKEN) or cell.panel.token):
        return (
            f"the profile real needs a token for its panel: {TOKEN} in .env, where `make pki` "
            "puts one"
        )
    return ""


def _wrong_implementation(choice: Choice, role: str, implementation: str) -> str:
    fitting = [name for name, plays in IMPLEMENTATIONS.items() if implementation in plays[role]]
    other = command_of(fitting[-1], "up") if fitting else "none"
    return (
        f"{choice.file} has `{role}: {implementation}`, but the profile {choice.profile} needs "
        f"{' or '.join(IMPLEMENTATIONS[choice.profile][role])}: use another profile "
        f"(CELL={choice.file.name} {other}), or another file with CELL"
    )


def unsafe(profile: str, settings: Mapping[str, str]) -> str:
    """Return why a cell may not run with these settings, empty when it may."""
    hub = settings.get(HUB_PUBLISHED, "127.0.0.1")
    panel = settings.get(PANEL_PUBLISHED, "127.0.0.1")
    has_certificates = bool(settings.get(PKI))
    encrypted = settings.get(SCHEME) == ENCRYPTED
    if old := settings.get(RENAMED):
        return (
            f"{RENAMED}={old} is two settings now, one per port: FORCEMESH_PUBLISH_HUB and "
            "FORCEMESH_PUBLISH_PANEL; use them instead, or remove it"
        )
    if encrypted != has_certificates:
        return (
            "FORCEMESH_PKI (folder of the certificates) and FORCEMESH_BUS=tls (the bus uses "
            "them) belong together: write both into .env, as `make pki` does, or neither"
        )
    if not is_loopback(hub) and not encrypted:
        return (
            f"FORCEMESH_PUBLISH_HUB={hub} is reachable from outside this machine, and without "
            "certificates any client there may move the arm: `make pki` first, or leave it at "
            "127.0.0.1"
        )
    if not is_loopback(panel) and not (encrypted and settings.get(TOKEN)):
        return (
            f"FORCEMESH_PUBLISH_PANEL={panel} is reachable from outside this machine, and without "
            f"certificates and {TOKEN} any client there may move the arm: `make pki` makes both; "
            "or leave it at 127.0.0.1"
        )
    if profile == "real" and not encrypted:
        return 'the profile real needs certificates: `make pki ARGS="--cell cells/my-cell.yaml"`'
    if profile == "real" and not settings.get(CALIBRATION):
        return (
            f"the profile real keeps its calibration on this machine: {CALIBRATION}=./calibration "
            "and FORCEMESH_RECORDINGS=./recordings in .env, where `make pki` puts them"
        )
    return ""
