"""Clocks: time as monotonic integer nanoseconds, with a virtual clock for tests."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol
from uuid import uuid4

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """Time source of every service."""

    @property
    def boot(self) -> str:
        """Identity of the clock: stamps may be subtracted only between equal ones."""

    def now_ns(self) -> int:
        """Return the monotonic time [ns]."""

    def sleep_s(self, duration_s: float) -> None:
        """Wait."""


class MonotonicClock:
    """The host's CLOCK_MONOTONIC."""

    def __init__(self) -> None:
        """Read the host's boot id once."""
        self.boot = _host_boot_id()

    now_ns = staticmethod(time.monotonic_ns)
    sleep_s = staticmethod(time.sleep)


class ManualClock:
    """Virtual clock: advances only on request."""

    def __init__(self, start_ns: int = NS_PER_S, boot: str = "virtual") -> None:
        """Start at a non-zero time, so that an uninitialised stamp is visible."""
        self._now_ns = start_ns
        self.boot = boot

    def now_ns(self) -> int:
        """Return the virtual time [ns]."""
        return self._now_ns

    def sleep_s(self, duration_s: float) -> None:
        """Advance the time."""
        self.advance_ns(round(duration_s * NS_PER_S))

    def advance_ns(self, duration_ns: int) -> None:
        """Advance the time."""
        self._now_ns += duration_ns


def wait_until(
    clock: Clock, condition: Callable[[], object], *, within_s: float, poll_s: float
) -> bool:
    """Return whether a condition holds within a time [s]; it is evaluated at least once."""
    give_up_ns = clock.now_ns() + round(within_s * NS_PER_S)
    while not condition():
        if clock.now_ns() >= give_up_ns:
            return False
        clock.sleep_s(poll_s)
    return True


def _host_boot_id() -> str:
    """Return the kernel's boot id with the time namespace, or a unique name."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        namespace = Path("/proc/self/ns/time")
        return f"{boot}/{namespace.readlink().name}" if namespace.is_symlink() else boot
    except OSError:
        return f"unknown-{uuid4()}"
