"""Checks of `forcemesh doctor` as pure functions from findings to report lines."""

from dataclasses import dataclass
from typing import Literal

from cli.doctor.remedies import BITS, FAULTS, REMEDIES, CheckResult
from controller.error_codes import error_shown
from controller.packet import VecInt
from controller.packet_table import PROTOCOL_VERSION, Scales, Status
from controller.plain import NOT_PROTECTED
from forcemesh.bus import Reading
from forcemesh.messages import Health, SensorWrench
from forcemesh.version import __version__
from services.gateway.packet_window import Spread

SLOW_BELOW = 0.9  # of the rate in the cell file
SPEED_TOLERANCE = 0.02  # of the monitor speed: it is reported in whole percent

Opened = Literal["open", "unresolved", "refused", "silent", "unreachable"]
HelloOutcome = Literal["answered", "silent", "closed", "garbled"]


@dataclass(frozen=True, slots=True)
class ReportLine:
    """One line of the report."""

    check: str
    result: CheckResult
    found: str
    remedy: str = ""


def passed(check: str, found: str) -> ReportLine:
    """Return a line that needs no action."""
    return ReportLine(check, "PASS", found)


def skipped(check: str, reason: str) -> ReportLine:
    """Return a line for a skipped check; always with a reason."""
    return ReportLine(check, "SKIP", reason)


def finding(check: str, result: CheckResult, found: str, remedy: str) -> ReportLine:
    """Return a line with a remedy from the table of remedies."""
    return ReportLine(check, result, found, REMEDIES[remedy])


# --- connection -----------------------------------------------------------------------------------


def check_address(
    endpoint: str, opened: Opened, detail: str, took_s: float, *, is_emulated: bool = False
) -> ReportLine:
    """Check the TCP connection to the controller; `detail` is the system's error text."""
    if opened == "open":
        return passed("address", f"{endpoint} responds in {1e3 * took_s:.1f} ms")
    texts = {
        "unresolved": f"{endpoint}: the name does not resolve",
        "refused": f"{endpoint}: host reached, but the port is closed",
        "silent": f"{endpoint}: no reply in {took_s:.1f} s",
        "unreachable": f"{endpoint}: no route to host",
    }
    found = texts[opened] + (f" ({detail})" if detail else "")
    remedy = "address.emulated" if is_emulated else f"address.{opened}"
    return finding("address", "FAIL", found, remedy)


def check_hello(outcome: HelloOutcome, detail: str, took_s: float) -> ReportLine:
    """Check whether the program replied to hello."""
    if outcome == "answered":
        return passed("hello", f"reply in {1e3 * took_s:.0f} ms")
    texts = {
        "silent": f"connected, but no reply in {took_s:.1f} s: another client is connected",
        "closed": "the controller closed the connection",
        "garbled": "the reply is not a packet",
    }
    found = texts[outcome] + (f": {detail}" if detail else "")
    return finding("hello", "FAIL", found, f"hello.{outcome}")


def check_protocol(version: int) -> ReportLine:
    """Compare the protocol version of the program with ours."""
    if version == PROTOCOL_VERSION:
        return passed("protocol", f"version {version}")
    found = f"the controller uses version {version}, this PC {PROTOCOL_VERSION}"
    return finding("protocol", "FAIL", found, "protocol")


def check_plain() -> list[ReportLine]:
    """Warn of protocol plain: a line for each protection that it gives up, the remedy last."""
    last = len(NOT_PROTECTED)
    return [
        ReportLine(f"protection {k}", "WARN", f"without {row}", REMEDIES["plain"] * (k == last))
        for k, row in enumerate(NOT_PROTECTED, 1)
    ]


def check_arm(number: int, expected: int) -> ReportLine:
    """Compare the number of the arm with the cell file's: cables may be swapped."""
    if number == expected:
        return passed("arm", f"number {number}")
    return finding("arm", "FAIL", f"number {number}, the cell file requires {expected}", "arm")


def check_peer(*, any_peer: bool | None) -> ReportLine:
    """Check whether the program accepts a connection from any address."""
    if any_peer is None:
        return finding("peer", "WARN", "unknown: no 103 received", "error.none")
    if any_peer:
        return finding("peer", "WARN", "connections from any address are accepted", "peer")
    return passed("peer", "connections from one address only")


def check_scales(asked: Scales, answered: "VecInt") -> ReportLine:
    """Compare the scales that the program has set with those of the cell file."""
    triples = list(zip(Scales.model_fields, asked.vec, answered, strict=True))
    wrong = [f"{name} requested {a}, set {b}" for name, a, b in triples if a != b]
    if wrong:
        return finding("scales", "FAIL", "; ".join(wrong), "scales")
    return passed("scales", "as requested: " + ", ".join(f"{name} {a}" for name, a, _ in triples))


# --- reports of the controller --------------------------------------------------------------------


def check_sender(
    hz: float | None, longest_gap_s: float | None, *, robot_hz: float, stale_after_s: float
) -> ReportLine:
    """Check the rate of pose and joint reports: 101 and 102 are one sample."""
    if not hz:
        return finding("sender", "FAIL", "no 101 and 102 received", "reports.none")
    found = f"{hz:.1f} samples/s, the cell file expects {robot_hz:g}"
    if longest_gap_s is not None:
        found += f"; longest gap {1e3 * longest_gap_s:.0f} ms"
    if 1.0 / hz > stale_after_s:
        return finding("sender", "FAIL", found, "sender.stale")
    if hz < SLOW_BELOW * robot_hz:
        return finding("sender", "WARN", found, "sender.slow")
    if longest_gap_s is not None and longest_gap_s > stale_after_s:
        found += f", stale from {1e3 * stale_after_s:.0f} ms"
        return finding("sender", "WARN", found, "sender.gap")
    return passed("sender", found)


def check_status(status: Status) -> list[ReportLine]:
    """Check the controller's status bits one by one."""
    lines = []
    for row in BITS:
        if bool(status & row.bit) == row.normal:
            lines.append(passed(row.check, row.normal_text))
        else:
            lines.append(ReportLine(row.check, row.result, row.abnormal_text, row.remedy))
    held = "held, until the next motion" if status & Status.HELD else "no"
    return [*lines, passed("held", held)]


def check_error_code(code: int | None) -> ReportLine:
    """Check the error code of 103: 0, a fault of the program, or an AS error."""
    if code is None:
        return finding("error code", "WARN", "no 103 received", "error.none")
    if code == 0:
        return passed("error code", "0")
    if code < 0:
        return finding("error code", "FAIL", error_shown(code), "error.as")
    if code not in FAULTS:
        return finding("error code", "WARN", f"{code}", "error.unknown")
    text, result, remedy = FAULTS[code]
    return ReportLine("error code", result, f"{code}: {text}", remedy)


def check_loops(hz: float | None) -> ReportLine:
    """Check the rate of the robot program's loop; when idle it runs twice a second."""
    if hz is None:
        return finding("program loop", "WARN", "unknown", "loops.unknown")
    if hz <= 0.0:
        return finding("program loop", "FAIL", "stopped", "loops.stand")
    return passed("program loop", f"{hz:.1f} cycles/s (about 2 when idle, plus one per command)")


def check_monitor_speed(
    fraction: float | None, measured_percent: float | None = None
) -> ReportLine:
    """Check the pendant's speed, which scales every other speed.

    Args:
        fraction: Monitor speed now, None without a report.
        measured_percent: The one at which robot.delay_s was measured, None if not recorded [%].
            A lower one makes the loop slower than its gains allow for.
    """
    if fraction is None:
        return finding("monitor speed", "WARN", "unknown: no 103 received", "error.none")
    found = f"{100.0 * fraction:g} %"
    if fraction <= 0.0:
        return finding("monitor speed", "FAIL", found, "monitor speed.zero")
    if measured_percent is not None:
        found += f"; robot.delay_s was measured at {measured_percent:g} %"
        if 100.0 * fraction < (1.0 - SPEED_TOLERANCE) * measured_percent:
            return finding("monitor speed", "FAIL", found, "monitor speed.lower")
        if 100.0 * fraction > (1.0 + SPEED_TOLERANCE) * measured_percent:
            return finding("monitor speed", "WARN", found, "monitor speed.higher")
        return passed("monitor speed", found)
    if fraction < 1.0:
        return finding("monitor speed", "WARN", found, "monitor speed.slow")
    return passed("monitor speed", found)


def check_round_trip(spread: "Spread | None", watchdog_s: float) -> ReportLine:
    """Check the time from a packet to its acknowledgement (102) against the watchdog's limit."""
    if spread is None:
        return finding("round trip", "FAIL", "command 12 was not acknowledged", "round trip.none")
    found = f"p50 {1e3 * spread.p50_s:.0f} ms, p99 {1e3 * spread.p99_s:.0f} ms"
    if spread.p99_s > 0.5 * watchdog_s:
        found += f": more than half of the watchdog's {1e3 * watchdog_s:.0f} ms"
        return finding("round trip", "WARN", found, "round trip.long")
    return passed("round trip", found)


def check_loop_delay(
    measured_s: float, modelled_s: float, *, delay_s: float, tolerance_s: float
) -> ReportLine:
    """Check the delay of the force loop that a session measured against the cell file's model.

    Args:
        measured_s: Delay of the loop in the last session.
        modelled_s: The same by the cell file.
        delay_s: `robot.delay_s` of the cell file.
        tolerance_s: Permitted difference.
    """
    text = (
        f"the last force feedback measured {1e3 * measured_s:.1f} ms, the cell file has "
        f"{1e3 * modelled_s:.1f} ms"
    )
    if abs(measured_s - modelled_s) <= tolerance_s:
        return passed("loop delay", text)
    fitting_s = max(delay_s + measured_s - modelled_s, 0.0)
    text = f"{text}: robot.delay_s would be {fitting_s:.3f}"
    return finding("loop delay", "WARN", text, "loop delay")


def check_goodbye(held: bool) -> ReportLine:
    """Check in which state the controller was left."""
    if held:
        return passed("left behind", "hold confirmed, connection closed, nothing armed")
    return finding("left behind", "WARN", "hold sent, not confirmed; closed", "goodbye")


# --- the cell's processes -------------------------------------------------------------------------


def check_role(
    role: str, reading: "Reading[Health] | Reading[SensorWrench]", config_hash: str
) -> ReportLine:
    """Check one role by its health; an external sensor is checked by its readings."""
    check, message = f"process {role}", reading.message
    if message is None:
        return finding(check, "FAIL", "no health received", "role.silent")
    health = message if isinstance(message, Health) else None
    found = f"health {1e3 * reading.age_s:.0f} ms old"
    if health is not None:
        found += f", {health.rate_hz:.0f} steps/s"
    if reading.silent:
        return finding(check, "FAIL", found, "role.silent")
    if health is None:
        return passed(check, found)
    if health.fault:
        return finding(check, "FAIL", health.fault, "role.fault")
    if health.version and health.version != __version__:
        found += f", version {health.version}, this is {__version__}"
        return finding(check, "FAIL", found, "role.version")
    if health.config_hash != config_hash:
        return finding(check, "WARN", found + ", another cell file", "role.config")
    return passed(check, found)


def check_serial(serial: str) -> ReportLine:
    """Check whether the sensor reports the number that its calibration names."""
    if serial:
        return passed("sensor serial", serial)
    text = "none reported: another sensor in its place would not be detected"
    return finding("sensor serial", "WARN", text, "sensor serial")


def check_stream(
    key: str, hz: float | None, expected_hz: float, *, slow_below: float = SLOW_BELOW
) -> ReportLine:
    """Check the rate of a topic."""
    if hz is None:
        return finding(key, "FAIL", "no messages", "stream.silent")
    found = f"{hz:.1f}/s, the cell file expects {expected_hz:g}"
    if hz < slow_below * expected_hz:
        return finding(key, "WARN", found, "stream.slow")
    return passed(key, found)
