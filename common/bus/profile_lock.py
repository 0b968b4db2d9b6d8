"""Lock of the active cell file: all containers of a cell run with the cell file of one profile.

`/in-use` is a small volume in memory. The container of a profile runs `keep`: it links the
profile's cell file there. Every other container starts with `run`: it waits for the link and holds
a lock while its process lives. The link changes only when no process holds the lock, so all running
processes have the same cell file, whatever was started, in any order.

The simulation needs no profile, so compose also starts it with every other profile: while another
profile's `keep` runs, that of the simulation is on standby, and its processes are ended.

    python -m common.bus.profile_lock keep PROFILE                    FORCEMESH_CELL names the file
    python -m common.bus.profile_lock check PROFILE                   exit code 0 once it is in use
    python -m common.bus.profile_lock run [PROFILE ...] -- COMMAND    with these profiles, or any
"""

import ctypes
import fcntl
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from common.bus.profile_fit import IMPLEMENTATIONS, REPLACED_BY, Choice, command_of, problem_with
from common.runtime.heartbeat import Heartbeat, heartbeat_of_this_process

FOLDER = Path("/in-use")
LINK = "cell.yaml"
LOCK = "profile"  # holds the profile's name

LOCK_POLL_S = 0.1
RETRY_S = 0.5  # while another profile is in use, or the cell file holds mistakes
LOCK_PATIENCE_S = 8.0  # longest time until a started profile has linked its cell file
GRACE_S = 2.0  # longest time between containers started together
END_WITHIN_S = 3.0
PR_SET_PDEATHSIG = 1


def chosen(folder: Path) -> Choice | None:
    """Return the choice in use, None when there is none."""
    try:
        return Choice((folder / LOCK).read_text("utf-8"), (folder / LINK).readlink())
    except FileNotFoundError:
        return None


def announce(folder: Path, profile: str) -> int:
    """Announce that a profile is requested, until the returned lock is closed."""
    lock = os.open(folder / f"asked-{profile}", os.O_RDWR | os.O_CREAT, 0o644)
    fcntl.flock(lock, fcntl.LOCK_EX)
    return lock


def replaced_by(folder: Path, profile: str) -> str:
    """Return the requested profile that replaces another one, empty when there is none."""
    return next((each for each in REPLACED_BY.get(profile, ()) if _is_requested(folder, each)), "")


def _is_requested(folder: Path, profile: str) -> bool:
    """Return whether the container of a profile runs. Shared locks do not block each other."""
    try:
        lock = os.open(folder / f"asked-{profile}", os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(lock)
    return False


def acquire(folder: Path, choice: Choice) -> int | None:
    """Put a choice in use, if no process runs with another one.

    Returns:
        The lock that keeps it in use, None when another choice is in use.
    """
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        pass  # a process runs, perhaps with this choice
    else:
        (folder / LINK).unlink(missing_ok=True)
        (folder / LOCK).write_text(choice.profile, "utf-8")
        (folder / LINK).symlink_to(choice.file)
    return _share(lock, folder, choice)


def hold(folder: Path, profiles: tuple[str, ...]) -> int | None:
    """Share the choice in use, if it is one of these profiles, or any if none is named.

    Returns:
        The lock that keeps it in use, None when there is none to share.
    """
    present = chosen(folder)
    if present is None or (profiles and present.profile not in profiles):
        return None
    if replaced_by(folder, present.profile):
        return None
    return _share(os.open(folder / LOCK, os.O_RDONLY), folder, present)


def _share(lock: int, folder: Path, choice: Choice) -> int | None:
    fcntl.flock(lock, fcntl.LOCK_SH)
    if chosen(folder) == choice:
        return lock
    os.close(lock)  # the choice changed before the lock was acquired
    return None


def not_in_use_text(present: Choice | None, choice: Choice) -> str:
    """Return the message while a valid choice is not in use.

    A choice left waiting could be the first one after the next boot.
    """
    if present is None:
        return "not in use yet; see the log of this container"
    return (
        f"the profile {present.profile} is in use with {present.file}, and a cell has only one "
        f"profile and file: first `{command_of(present.profile, 'down')}`, or remove this one: "
        f"`{command_of(choice.profile, f'rm -s -f {choice.profile}-cell')}`"
    )


def standby_text(other: str) -> str:
    """Return the message of the simulation while another profile is requested."""
    return (
        f"on standby: the profile {other} replaces the simulation, until "
        f"`{command_of(other, 'down')}`"
    )


class Keeper:
    """Keeper of a choice: puts it in use, or reports once what prevents it."""

    def __init__(self, folder: Path, choice: Choice) -> None:
        """Announce the choice; the profiles that it replaces end."""
        self._folder, self._choice = folder, choice
        (folder / LOCK).touch()  # waiting containers then do not report a missing profile
        self._announcement = announce(folder, choice.profile)
        self._lock: int | None = None
        self._logged = ""
        self._since_s = time.monotonic()
        self._heartbeat = heartbeat_of_this_process()

    def step(self) -> str:
        """Run one step; return what prevents the use, empty when in use or on standby."""
        if other := replaced_by(self._folder, self._choice.profile):
            if self._lock is not None:
                os.close(self._lock)
                self._lock = None
            return self._log("", standby_text(other))
        if self._lock is not None:
            return self._log("", f"in use with {self._choice.file}")
        if fault := problem_with(self._choice):
            return self._log(fault, fault)
        self._lock = acquire(self._folder, self._choice)
        if self._lock is not None:
            return self._log("", f"in use with {self._choice.file}")
        present = chosen(self._folder)
        if present is not None and replaced_by(self._folder, present.profile):
            return self._log("replacing the simulation", "")
        fault = not_in_use_text(present, self._choice)
        return self._log(fault, fault)

    def _log(self, fault: str, text: str) -> str:
        """Log a new message. A complaint that another container may resolve is delayed."""
        self._heartbeat.beat(time.monotonic_ns(), fault)
        replaceable = self._choice.profile in REPLACED_BY
        too_early = time.monotonic() - self._since_s < GRACE_S
        if text and text != self._logged and not (fault and replaceable and too_early):
            _write(f"{self._choice.profile}-cell: {text}")
            self._logged = text
        return fault


def keep(folder: Path, choice: Choice) -> NoReturn:
    """Keep a choice in use until the process is ended."""
    keeper = Keeper(folder, choice)
    while True:
        keeper.step()
        time.sleep(RETRY_S)


def run(folder: Path, profiles: tuple[str, ...], command: list[str]) -> NoReturn:
    """Run a command with the cell file in use; wait again when the file is replaced."""
    heartbeat = heartbeat_of_this_process()
    while True:
        lock = _wait(folder, profiles, command, heartbeat)
        present = chosen(folder)
        os.set_inheritable(lock, True)  # noqa: FBT003 - the lock lives as long as the process
        code = _play(folder, command, "" if present is None else present.profile, lock)
        os.close(lock)
        if code is not None:
            sys.exit(code if code >= 0 else 128 - code)


def _wait(folder: Path, profiles: tuple[str, ...], command: list[str], heartbeat: Heartbeat) -> int:
    """Wait for a choice to share; return its lock."""
    patient_until_s = time.monotonic() + LOCK_PATIENCE_S
    logged = ""
    while (lock := hold(folder, profiles)) is None:
        cause = waiting(folder, profiles)
        if time.monotonic() > patient_until_s and cause != logged:
            _write(f"{' '.join(command[:3])} waits: {cause}" if cause else "")
            logged = cause
        is_standby = any(replaced_by(folder, profile) for profile in profiles)
        heartbeat.beat(time.monotonic_ns(), "" if is_standby else cause or "waits for a cell file")
        time.sleep(LOCK_POLL_S)
    return lock


def _play(folder: Path, command: list[str], profile: str, lock: int) -> int | None:
    """Run a command to its end; return its exit code, None when its profile was replaced."""
    child = subprocess.Popen(command, pass_fds=(lock,), preexec_fn=_end_with_parent)  # noqa: PLW1509
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda passed, _frame: child.send_signal(passed))
    while (code := child.poll()) is None:
        if other := replaced_by(folder, profile):
            _write(f"{' '.join(command[:3])} ends: the profile {other} replaces the simulation")
            _end(child)
            return None
        with suppress(subprocess.TimeoutExpired):
            child.wait(RETRY_S)
    return code


def _end(child: subprocess.Popen[bytes]) -> None:
    child.terminate()
    with suppress(subprocess.TimeoutExpired):
        child.wait(END_WITHIN_S)
    child.kill()
    child.wait()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)


def _end_with_parent() -> None:
    """Make the kernel end the command when its `run` process is killed."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)


def waiting(folder: Path, profiles: tuple[str, ...] = ()) -> str:
    """Return why no choice can be shared, empty if a profile's container reports it."""
    if other := next((each for name in profiles if (each := replaced_by(folder, name))), ""):
        return standby_text(other)
    present = chosen(folder)
    if present is not None and not replaced_by(folder, present.profile):
        return f"the profile {present.profile} is in use, but this container belongs to another one"
    if (folder / LOCK).exists():
        return ""
    return "no cell file is in use: start the whole cell, `docker compose up`"


def check(folder: Path, choice: Choice) -> int:
    """Wait until a choice is in use, or print why it is not; return the exit code."""
    patient_until_s = time.monotonic() + LOCK_PATIENCE_S
    while chosen(folder) != choice or replaced_by(folder, choice.profile):
        fault = problem_with(choice)
        if not fault and time.monotonic() > patient_until_s:
            other = replaced_by(folder, choice.profile)
            fault = standby_text(other) if other else not_in_use_text(chosen(folder), choice)
        if fault:
            _write(f"{choice.profile}-cell: {fault}")
            return 1
        time.sleep(LOCK_POLL_S)
    return 0


def _write(line: str) -> None:
    if line:
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def main(words: list[str], folder: Path = FOLDER) -> int:
    """Run the command named by the first word."""
    file = Path(os.environ.get("FORCEMESH_CELL", ""))
    match words:
        case ["keep", profile] if profile in IMPLEMENTATIONS:
            keep(folder, Choice(profile, file))
        case ["check", profile] if profile in IMPLEMENTATIONS:
            return check(folder, Choice(profile, file))
        case ["run", *rest] if "--" in rest[:-1]:
            end = rest.index("--")
            run(folder, tuple(rest[:end]), rest[end + 1 :])
    _write(__doc__ or "")
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
