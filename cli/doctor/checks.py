"""The checks of `forcemesh doctor` as pure functions: what was found goes in, lines come out."""

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal

from cli.doctor.remedies import BITS, FAULTS, REMEDIES, Word
from controller.packet_table import PROTOCOL_VERSION, Status
from forcemesh.version import __version__

if TYPE_CHECKING:
    from controller.packet import VecInt
    from services.gateway.round_trips import Spread
    from services.gateway.scales import Scales

SLOW_BELOW = 0.9  # of the rate in the cell file

Opened = Literal["open", "unresolved", "refused", "silent", "unreachable"]
Greeted = Literal["answered", "silent", "closed", "garbled"]


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the report."""

    check: str
    word: Word
    found: str
    remedy: str = ""


def passed(check: str, found: str) -> Line:
    """Return a line that needs nothing done."""
    return Line(check, "PASS", found)


def skipped(check: str, why: str) -> Line:
    """Return a line for what was not looked at; never without a reason."""
    return Line(check, "SKIP", why)


def trouble(check: str, word: Word, found: str, remedy: str) -> Line:
    """Return a line with what to do, from the table of remedies."""
    return Line(check, word, found, REMEDIES[remedy])


# --- the way there --------------------------------------------------------------------------------


def check_address(
    where: str, opened: Opened, detail: str, took_s: float, *, is_emulated: bool = False
) -> Line:
    """Tell whether TCP gets through to the controller; `detail` is what the system said."""
    if opened == "open":
        return passed("address", f"{where} answers in {1e3 * took_s:.1f} ms")
    texts = {
        "unresolved": f"{where}: the name does not resolve",
        "refused": f"{where}: there, but the port is closed",
        "silent": f"{where}: no answer in {took_s:.1f} s",
        "unreachable": f"{where}: no way there",
    }
    found = texts[opened] + (f" ({detail})" if detail else "")
    remedy = "address.emulated" if is_emulated else f"address.{opened}"
    return trouble("address", "FAIL", found, remedy)


def check_hello(greeted: Greeted, detail: str, took_s: float) -> Line:
    """Tell whether the program answered hello."""
    if greeted == "answered":
        return passed("hello", f"answered in {1e3 * took_s:.0f} ms")
    texts = {
        "silent": f"connected, but no answer in {took_s:.1f} s: somebody else is connected",
        "closed": "the controller closed the connection",
        "garbled": "the answer is no packet",
    }
    found = texts[greeted] + (f": {detail}" if detail else "")
    return trouble("hello", "FAIL", found, f"hello.{greeted}")


def check_protocol(version: int) -> Line:
    """Compare the version that the program speaks with ours."""
    if version == PROTOCOL_VERSION:
        return passed("protocol", f"version {version}")
    found = f"the controller speaks version {version}, this PC {PROTOCOL_VERSION}"
    return trouble("protocol", "FAIL", found, "protocol")


def check_arm(number: int, wanted: int) -> Line:
    """Compare the number of the arm with the cell file's: cables may be swapped."""
    if number == wanted:
        return passed("arm", f"number {number}")
    return trouble("arm", "FAIL", f"number {number}, the cell file says {wanted}", "arm")


def check_peer(*, any_peer: bool | None) -> Line:
    """Tell whether the program takes a connection from any address."""
    if any_peer is None:
        return trouble("peer", "WARN", "not known: no 103 came", "error.none")
    if any_peer:
        return trouble("peer", "WARN", "a connection from any address is taken", "peer")
    return passed("peer", "connections from one address only")


def check_scales(asked: "Scales", answered: "VecInt") -> Line:
    """Compare the scales that the program has set with those of the cell file."""
    names = [field.name for field in fields(asked)]
    triples = list(zip(names, asked.vec, answered, strict=True))
    wrong = [f"{name} asked {a}, has {b}" for name, a, b in triples if a != b]
    if wrong:
        return trouble("scales", "FAIL", "; ".join(wrong), "scales")
    return passed("scales", "as asked: " + ", ".join(f"{name} {a}" for name, a, _ in triples))


# --- what the controller says ---------------------------------------------------------------------


def check_sender(
    hz: float | None, longest_gap_s: float | None, *, robot_hz: float, stale_after_s: float
) -> Line:
    """Judge how often pose and joints come: 101 and 102 are one sample."""
    if not hz:
        return trouble("sender", "FAIL", "no 101 and 102 come", "reports.none")
    found = f"{hz:.1f} samples/s, the cell file says {robot_hz:g}"
    if longest_gap_s is not None:
        found += f"; longest gap {1e3 * longest_gap_s:.0f} ms"
    if 1.0 / hz > stale_after_s:
        return trouble("sender", "FAIL", found, "sender.stale")
    if hz < SLOW_BELOW * robot_hz:
        return trouble("sender", "WARN", found, "sender.slow")
    if longest_gap_s is not None and longest_gap_s > stale_after_s:
        found += f", stale from {1e3 * stale_after_s:.0f} ms"
        return trouble("sender", "WARN", found, "sender.gap")
    return passed("sender", found)


def check_status(status: Status) -> list[Line]:
    """Judge the controller's status bits one by one."""
    lines = []
    for row in BITS:
        if bool(status & row.bit) == row.good:
            lines.append(passed(row.check, row.good_text))
        else:
            lines.append(Line(row.check, row.word, row.bad_text, row.remedy))
    held = "held, until the next motion" if status & Status.HELD else "no"
    return [*lines, passed("held", held)]


def check_error_code(code: int | None) -> Line:
    """Judge what 103 says: 0, a fault of the program, or AS's own error."""
    if code is None:
        return trouble("error code", "WARN", "no 103 came", "error.none")
    if code == 0:
        return passed("error code", "0")
    if code < 0:
        return trouble("error code", "FAIL", f"{code}: an error of AS", "error.as")
    fault = FAULTS.get(code)
    if fault is None:
        return trouble("error code", "WARN", f"{code}", "error.unknown")
    return Line("error code", fault.word, f"{code}: {fault.text}", fault.remedy)


def check_loops(hz: float | None) -> Line:
    """Judge the turns of the robot program's loop; idle it turns twice a second."""
    if hz is None:
        return trouble("program loop", "WARN", "not known", "loops.unknown")
    if hz <= 0.0:
        return trouble("program loop", "FAIL", "stands", "loops.stand")
    return passed("program loop", f"{hz:.1f} turns/s (idle about 2, and one for each command)")


def check_monitor_speed(fraction: float | None) -> Line:
    """Judge the pendant's speed: it multiplies every other one."""
    if fraction is None:
        return trouble("monitor speed", "WARN", "not known: no 103 came", "error.none")
    found = f"{100.0 * fraction:g} %"
    if fraction <= 0.0:
        return trouble("monitor speed", "FAIL", found, "monitor speed.zero")
    if fraction < 1.0:
        return trouble("monitor speed", "WARN", found, "monitor speed.slow")
    return passed("monitor speed", found)


def check_round_trip(spread: "Spread | None", watchdog_s: float) -> Line:
    """Judge the time from a packet to the 102 that names it, against the watchdog's limit."""
    if spread is None:
        return trouble("round trip", "FAIL", "command 12 was not echoed", "round trip.none")
    found = f"p50 {1e3 * spread.p50_s:.0f} ms, p99 {1e3 * spread.p99_s:.0f} ms"
    if spread.p99_s > 0.5 * watchdog_s:
        found += f": more than half of the watchdog's {1e3 * watchdog_s:.0f} ms"
        return trouble("round trip", "WARN", found, "round trip.long")
    return passed("round trip", found)


def check_goodbye(held: bool) -> Line:
    """Tell how the controller was left."""
    if held:
        return passed("left behind", "hold confirmed, connection closed, nothing armed")
    return trouble("left behind", "WARN", "hold sent, not confirmed; closed", "goodbye")


# --- the cell's processes -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RoleHeard:
    """What a role's health says."""

    role: str
    age_s: float | None  # None: never heard
    is_fresh: bool
    rate_hz: float | None = None  # None: a sensor of somebody else's
    fault: str = ""
    same_config: bool = True
    version: str = ""  # empty: not said


def check_role(heard: RoleHeard) -> Line:
    """Judge one role by its health."""
    check = f"process {heard.role}"
    if heard.age_s is None:
        return trouble(check, "FAIL", "no health", "role.silent")
    found = f"heard {1e3 * heard.age_s:.0f} ms ago"
    if heard.rate_hz is not None:
        found += f", {heard.rate_hz:.0f} steps/s"
    if not heard.is_fresh:
        return trouble(check, "FAIL", found, "role.silent")
    if heard.fault:
        return trouble(check, "FAIL", heard.fault, "role.fault")
    if heard.version and heard.version != __version__:
        found += f", version {heard.version}, this is {__version__}"
        return trouble(check, "FAIL", found, "role.version")
    if not heard.same_config:
        return trouble(check, "WARN", found + ", not this cell file", "role.config")
    return passed(check, found)


def check_stream(
    key: str, hz: float | None, wanted_hz: float, *, slow_below: float = SLOW_BELOW
) -> Line:
    """Judge how often a topic comes."""
    if hz is None:
        return trouble(key, "FAIL", "silent", "stream.silent")
    found = f"{hz:.1f}/s, the cell file says {wanted_hz:g}"
    if hz < slow_below * wanted_hz:
        return trouble(key, "WARN", found, "stream.slow")
    return passed(key, found)
