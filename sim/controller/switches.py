"""System switches: name ON, name OFF, SWITCH(name)."""

from collections.abc import Callable

# Switches used by programs, with their factory setting. CP, REPEAT and similar take effect here;
# the others are only stored.
FACTORY = {
    "cp": True,
    "check.hold": False,
    "messages": True,
    "screen": True,
    "oxpreset": False,
    "prefetch.sigins": False,
    "qtool": False,
    "rep_once": False,
    "rps": False,
    "stp_once": False,
    "autostart.pc": False,
    "autostart2.pc": False,
    "autostart3.pc": False,
    "autostart4.pc": False,
    "autostart5.pc": False,
    "errstart.pc": False,
    "dispio_01": False,
    "hold.step": False,
    "wait.nozer": False,
    "trace": False,
    "singular": True,
    "abs.speed": False,
    "slow_start": False,
    "after.wait.tmr": False,
    "udp_send_nobind": False,
    "udp_emsg": False,
    "flexcomp": False,
    "disable_interrupt": False,
}


class SystemSwitches:
    """Switches by lower-case name. Some only report the state of the machine."""

    def __init__(self, reported: dict[str, Callable[[], bool]]) -> None:
        """Set all to the factory setting; programs cannot set `reported` ones."""
        self._set = dict(FACTORY)
        self._reported = reported

    def exists(self, name: str) -> bool:
        """Return whether the switch exists."""
        return name in self._set or name in self._reported

    def is_reported(self, name: str) -> bool:
        """Return whether a switch only reports."""
        return name in self._reported

    def read(self, name: str) -> bool:
        """Return the state of a switch."""
        report = self._reported.get(name)
        return report() if report is not None else self._set[name]

    def write(self, name: str, *, on: bool) -> None:
        """Set a switch."""
        self._set[name] = on
