"""Label of the containers: `/in-use/cell.yaml` leads to `PROFILE`, and that to the cell file.

The container of a profile sets the label (`keep`). Every other one waits for it and runs its
command while it stays (`run`). It is replaced only when no process runs with it, or if it is that
of the simulation, which compose starts with every profile. The folder is a volume in memory.

    python -m common.bus.profile_label keep PROFILE                 FORCEMESH_CELL names the file
    python -m common.bus.profile_label check PROFILE                exit code 0 if it is in use
    python -m common.bus.profile_label run [PROFILE ...] -- COMMAND   with these profiles, or any
"""

import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

from common.runtime.heartbeat import heartbeat_of_this_process
from forcemesh.published_ports import is_loopback

FOLDER = Path("/in-use")
LABEL = "cell.yaml"
SIM = "sim"  # the default, without a profile in compose
# Implementations of robot and sensor in the containers of a profile.
IMPLEMENTATIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "sim": {"robot": ("sim",), "sensor": ("sim",)},
    "emulated": {"robot": ("gateway",), "sensor": ("driver",)},
    "real": {"robot": ("gateway", "external"), "sensor": ("driver", "external")},
}

LABEL_POLL_S = 0.5
PATIENCE_POLLS = 16  # a started profile has set its label by then
END_WITHIN_S = 3.0
WAITS = "no cell file is in use: start the whole cell, `docker compose up`"


def in_use(folder: Path) -> str:
    """Return the profile of the label, empty when there is none."""
    label = folder / LABEL
    return label.readlink().name if label.is_symlink() else ""


def hold(folder: Path, profile: str, mode: str = "r") -> IO[str]:
    """Return an open file that shows that a process runs with a profile."""
    lock = (folder / f"{profile}.lock").open(mode)
    fcntl.flock(lock, fcntl.LOCK_SH)
    return lock


def is_held(folder: Path, profile: str) -> bool:
    """Return whether any process runs with a profile."""
    try:
        with (folder / f"{profile}.lock").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def put(folder: Path, profile: str, file: Path) -> str:
    """Put a profile and its cell file in use; return why they are not, empty when they are."""
    own, present = folder / profile, in_use(folder)
    if present != profile and (present == SIM or not is_held(folder, present)):
        own.unlink(missing_ok=True)
        new = folder / f"{profile}-{os.getpid()}"
        new.symlink_to(profile)
        new.replace(folder / LABEL)
    present = in_use(folder)
    if present == profile and not own.is_symlink():
        if problem := problem_with(profile, file):
            return problem  # the label leads to no file: nothing runs
        with suppress(FileExistsError):  # `keep` and `check` at once
            own.symlink_to(file)
    if present == profile and own.readlink() == file:
        return ""
    if profile == SIM != present:
        down = command_of(present, "down")
        return f"on standby: the profile {present} replaces the simulation, until `{down}`"
    return (
        f"the profile {present} is in use with {os.path.realpath(folder / present)}, and a cell "
        f"has only one profile and file: first `{command_of(present, 'down')}`, or remove this "
        f"one: `{command_of(profile, f'rm -s -f {profile}-cell')}`"
    )


def command_of(profile: str, verb: str) -> str:
    """Return the shell command of a compose verb for a profile."""
    return f"docker compose {'' if profile == SIM else f'--profile {profile} '}{verb}"


def problem_with(profile: str, file: Path, settings: Mapping[str, str] = os.environ) -> str:
    """Return why a cell file cannot be used with its profile here, empty when it can."""
    # Slow imports, not needed by a process that only waits.
    from common.config.load import load_cell  # noqa: PLC0415
    from forcemesh.errors import ConfigError  # noqa: PLC0415

    if file.is_dir():
        return (
            f"the profile {profile} needs your own cell file in cells/: "
            f"CELL=my-cell.yaml {command_of(profile, 'up')}"
        )
    has_certificates = bool(settings.get("FORCEMESH_PKI"))
    if has_certificates != (settings.get("FORCEMESH_BUS") == "tls"):
        return (
            "FORCEMESH_PKI (folder of the certificates) and FORCEMESH_BUS=tls (the bus uses "
            "them) belong together: write both into .env, as `make pki` does, or neither"
        )
    hub = settings.get("FORCEMESH_PUBLISH_HUB", "127.0.0.1")
    if not has_certificates and not is_loopback(hub):
        return (
            f"FORCEMESH_PUBLISH_HUB={hub} is reachable from outside this machine, and without "
            "certificates any client there may move the arm: `make pki` first, or leave it at "
            "127.0.0.1"
        )
    try:
        cell = load_cell(file)
    except ConfigError as error:
        return str(error)
    for role, implementations in IMPLEMENTATIONS[profile].items():
        if (named := getattr(cell.roles, role)) not in implementations:
            fitting = [name for name, plays in IMPLEMENTATIONS.items() if named in plays[role]]
            return (
                f"{file} has `{role}: {named}`, but the profile {profile} needs "
                f"{' or '.join(implementations)}: use another profile (CELL={file.name} "
                f"{command_of(fitting[-1], 'up')}), or another file with CELL"
            )
    if cell.together:
        return f"{file} has `together`, but containers have one role each: remove it"
    needed_by_real = {
        "FORCEMESH_PKI": has_certificates,
        "FORCEMESH_CALIBRATION": settings.get("FORCEMESH_CALIBRATION"),
        "FORCEMESH_PANEL_TOKEN": settings.get("FORCEMESH_PANEL_TOKEN") or cell.panel.token,
    }
    missing = [name for name, given in needed_by_real.items() if not given]
    if profile == "real" and missing:
        return (
            f"the profile real needs {', '.join(missing)} in .env, where "
            '`make pki ARGS="--cell cells/my-cell.yaml"` puts them'
        )
    return ""


def keep(folder: Path, profile: str, file: Path) -> None:
    """Put a profile in use until the process is ended; log what prevents it."""
    heartbeat, logged = heartbeat_of_this_process(), ""
    with hold(folder, profile, "w"):
        while True:
            problem = put(folder, profile, file)
            is_standby = profile == SIM != in_use(folder)
            heartbeat.beat(time.monotonic_ns(), "" if is_standby else problem)
            if (text := problem or f"in use with {file}") != logged:
                sys.stderr.write(f"{profile}-cell: {text}\n")
                logged = text
            time.sleep(LABEL_POLL_S)


def run(folder: Path, profiles: list[str], command: list[str]) -> int:
    """Run a command while the label has one of its profiles; return the exit code."""
    profile = wait(folder, profiles, " ".join(command[:3]))
    with hold(folder, profile):
        child = subprocess.Popen(command)
        signal.signal(signal.SIGTERM, lambda *_: child.terminate())
        while child.poll() is None and in_use(folder) == profile:
            with suppress(subprocess.TimeoutExpired):
                child.wait(LABEL_POLL_S)
        child.terminate()
        with suppress(subprocess.TimeoutExpired):  # a hanging child ends with the container
            child.wait(END_WITHIN_S)
    return child.poll() or 0


def wait(folder: Path, profiles: list[str], name: str) -> str:
    """Wait for a label of one of these profiles, or of any; return its profile."""
    heartbeat, polls = heartbeat_of_this_process(), 0
    while True:
        present = in_use(folder)
        if (folder / LABEL).is_file() and (not profiles or present in profiles):
            return present
        is_standby = SIM in profiles and present not in {"", SIM}
        heartbeat.beat(time.monotonic_ns(), "" if is_standby else WAITS)
        polls += 1
        if polls == PATIENCE_POLLS and not present:
            sys.stderr.write(f"{name} waits: {WAITS}\n")
        time.sleep(LABEL_POLL_S)


def main(words: list[str], folder: Path = FOLDER) -> int:
    """Run the command named by the first word."""
    match words:
        case ["keep", profile]:
            keep(folder, profile, Path(os.environ["FORCEMESH_CELL"]))
        case ["check", profile]:
            problem = put(folder, profile, Path(os.environ["FORCEMESH_CELL"]))
            sys.stderr.write(f"{profile}-cell: {problem}\n" if problem else "")
            return int(bool(problem))
        case ["run", *rest] if "--" in rest[:-1]:
            end = rest.index("--")
            return run(folder, rest[:end], rest[end + 1 :])
    sys.stderr.write(__doc__ or "")
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
