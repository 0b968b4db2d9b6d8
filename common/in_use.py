"""Which cell file the containers of a cell run with: the profile says it, every process waits.

`/in-use` is a small volume in memory. `keep` is what the container of a profile's own does: it puts
the profile's cell file there, as a link. `run` is how every other container starts: it waits for
the link and holds a lock while its process lives. The link changes only when nobody holds the lock,
so processes that run together have one cell file, whatever was started, in whichever order.

    python -m common.in_use keep PROFILE                    FORCEMESH_CELL says which file
    python -m common.in_use check PROFILE                   exit code 0 once it is in use
    python -m common.in_use run [PROFILE ...] -- COMMAND    of these profiles, or of any
"""

import fcntl
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

FOLDER = Path("/in-use")
LINK = "cell.yaml"
LOCK = "profile"  # its text is the profile's name

# Who plays robot and sensor in the containers of a profile.
PLAYERS: dict[str, dict[str, tuple[str, ...]]] = {
    "sim": {"robot": ("sim",), "sensor": ("sim",)},
    "emulated": {"robot": ("gateway",), "sensor": ("driver",)},
    "real": {"robot": ("gateway",), "sensor": ("driver", "external")},
}

POLL_S = 0.1
RETRY_S = 0.5  # while another profile is in use, or the cell file holds mistakes
PATIENCE_S = 8.0  # a profile that was started has said its cell file by then


@dataclass(frozen=True, slots=True)
class Choice:
    """A profile and its cell file."""

    profile: str
    file: Path


def chosen(folder: Path) -> Choice | None:
    """Return what is in use, None when nothing is."""
    try:
        return Choice((folder / LOCK).read_text("utf-8"), (folder / LINK).readlink())
    except FileNotFoundError:
        return None


def claim(folder: Path, wanted: Choice) -> int | None:
    """Put a choice in use where nobody runs with another one.

    Returns:
        The lock that keeps it in use, None when another choice is.
    """
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        pass  # somebody runs, perhaps with this very choice
    else:
        (folder / LINK).unlink(missing_ok=True)
        (folder / LOCK).write_text(wanted.profile, "utf-8")
        (folder / LINK).symlink_to(wanted.file)
    return _share(lock, folder, wanted)


def hold(folder: Path, profiles: tuple[str, ...]) -> int | None:
    """Take part in what is in use, if it is one of these profiles; in any, where none is named.

    Returns:
        The lock that keeps it in use, None when there is nothing to take part in.
    """
    there = chosen(folder)
    if there is None or (profiles and there.profile not in profiles):
        return None
    return _share(os.open(folder / LOCK, os.O_RDONLY), folder, there)


def _share(lock: int, folder: Path, wanted: Choice) -> int | None:
    fcntl.flock(lock, fcntl.LOCK_SH)
    if chosen(folder) == wanted:
        return lock
    os.close(lock)  # another choice came before the lock was had
    return None


def misfit(choice: Choice) -> str:
    """Return why a cell file cannot be used with its profile, empty when it can."""
    # Long imports, which a process that only waits is spared.
    from common.config import load_cell  # noqa: PLC0415
    from common.errors import ConfigError  # noqa: PLC0415

    if choice.file.is_dir():
        return (
            f"the profile {choice.profile} needs a cell file of yours, one in cells/: "
            f"CELL=my-cell.yaml docker compose --profile {choice.profile} up"
        )
    try:
        roles = load_cell(choice.file).roles
    except ConfigError as error:
        return str(error)
    for role, players in PLAYERS[choice.profile].items():
        if getattr(roles, role) not in players:
            return (
                f"{choice.file} says `{role}: {getattr(roles, role)}`, and in the profile "
                f"{choice.profile} it is {' or '.join(players)}: take another profile, or say "
                "another file with CELL"
            )
    return ""


def taken(there: Choice | None, wanted: Choice) -> str:
    """Return what to say while a choice is not in use, though nothing speaks against it.

    One that goes on waiting would be as good as the other after the next start of the machine.
    """
    if there is None:
        return "not in use yet; the log of this container says why"
    return (
        f"the profile {there.profile} is in use with {there.file}, and one cell has one profile "
        f"and one file: first `docker compose --profile {there.profile} down`, or take this one "
        f"back: `docker compose --profile {wanted.profile} rm -s -f {wanted.profile}-cell`"
    )


def keep(folder: Path, wanted: Choice) -> NoReturn:
    """Keep a choice in use until the process is ended; say once what is in the way."""
    (folder / LOCK).touch()  # who waits need not say that no profile was started
    said = ""
    while (complaint := misfit(wanted)) or claim(folder, wanted) is None:
        complaint = complaint or taken(chosen(folder), wanted)
        if complaint != said:
            _say(f"{wanted.profile}-cell: {complaint}")
        said = complaint
        time.sleep(RETRY_S)
    _say(f"{wanted.profile}-cell: in use with {wanted.file}")
    while True:
        signal.pause()


def run(folder: Path, profiles: tuple[str, ...], command: list[str]) -> NoReturn:
    """Wait for the cell file that is in use, then become the command."""
    patient_until_s = time.monotonic() + PATIENCE_S
    said = ""
    while (lock := hold(folder, profiles)) is None:
        if time.monotonic() > patient_until_s and (why := waiting(folder)) != said:
            _say(f"{' '.join(command[:3])} waits: {why}" if why else "")
            said = why
        time.sleep(POLL_S)
    os.set_inheritable(lock, True)  # noqa: FBT003 - the lock lives as long as the process
    os.execvp(command[0], command)  # noqa: S606 - no shell is wanted


def waiting(folder: Path) -> str:
    """Return why there is nothing to take part in, empty where a profile's container says it."""
    if there := chosen(folder):
        return f"the profile {there.profile} is in use, and this container belongs to another one"
    if (folder / LOCK).exists():
        return ""
    return "no cell file is in use: start one profile, `docker compose --profile sim up`"


def check(folder: Path, wanted: Choice) -> int:
    """Wait a little until a choice is in use; say why it is not; return the exit code."""
    patient_until_s = time.monotonic() + PATIENCE_S
    while chosen(folder) != wanted:
        complaint = misfit(wanted)
        if not complaint and time.monotonic() > patient_until_s:
            complaint = taken(chosen(folder), wanted)
        if complaint:
            _say(f"{wanted.profile}-cell: {complaint}")
            return 1
        time.sleep(POLL_S)
    return 0


def _say(line: str) -> None:
    if line:
        sys.stderr.write(f"{line}\n")


def main(words: list[str], folder: Path = FOLDER) -> int:
    """Do what the first word says."""
    file = Path(os.environ.get("FORCEMESH_CELL", ""))
    match words:
        case ["keep", profile] if profile in PLAYERS:
            keep(folder, Choice(profile, file))
        case ["check", profile] if profile in PLAYERS:
            return check(folder, Choice(profile, file))
        case ["run", *rest] if "--" in rest[:-1]:
            end = rest.index("--")
            run(folder, tuple(rest[:end]), rest[end + 1 :])
    _say(__doc__ or "")
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
