"""Causes of the hub's refusals, parsed from Zenoh's log and reported once a second."""

import os
import subprocess
import sys
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from services.hub.refusals import RefusalParser, Refusals

ROOT = Path(__file__).resolve().parents[4]
ACL = "zenoh::net::routing::interceptor::access_control"
ARBITER, MONITOR = "43e72ad703c02988df40ff33891b35c0", "2f1f30b60fc3a1a27ed41943e007d019"
MOST_AT_ONCE_B, REPORT_PERIOD_NS = 256_000, 1_000_000_000
KNOWN = frozenset({"arbiter.demo", "monitor.demo"})


def line(text: str, *, thread: int = 8, module: str = ACL, level: str = "TRACE") -> bytes:
    """Return a line as Zenoh writes it."""
    return (
        f"2026-11-22T04:45:03.421Z {level:>5}  rx-0 ThreadId({thread:02}) {module}: {text}"
    ).encode()


def decision(session: str, name: str, action: str, *, may: bool) -> str:
    """Return the text of an access decision."""
    verdict = "authorized" if may else "unauthorized"
    subject = f"Interface(lo)+CertCommonName({name})+Transport(Tls)+{session}"
    return f"{session} on {subject} is {verdict} to {action}"


def intercepted(thread: int = 8) -> bytes:
    """Return the line of a refusal."""
    module = "zenoh::net::routing::interceptor"
    return line("Msg intercepted!", thread=thread, module=module)


def causes(*lines: bytes) -> list[tuple[str, str]]:
    """Return the causes that a new parser finds in lines."""
    return RefusalParser(KNOWN).causes(lines)


def test_a_forbidden_message_is_reported_with_name_and_key() -> None:
    """The line before the refusal on the same thread has the name and the action."""
    text = decision(MONITOR, "monitor.demo", "Put (ingress) on demo/robot/command", may=False)
    assert causes(line(text), intercepted()) == [
        ("forbidden", "monitor.demo may not: Put on demo/robot/command")
    ]


def test_an_access_check_alone_is_no_refusal() -> None:
    """Zenoh checks every action on a key at its declaration: this refuses nothing."""
    text = decision(MONITOR, "monitor.demo", "Put (ingress) on demo/wrench", may=False)
    assert causes(line(text), line(text)) == []


def test_threads_are_parsed_separately() -> None:
    """A refusal belongs to its thread, whatever lines of other threads come between."""
    bad = decision(MONITOR, "monitor.demo", "Put (ingress) on demo/wrench", may=False)
    good = decision(ARBITER, "arbiter.demo", "Put (ingress) on demo/robot/command", may=True)
    output = causes(line(bad, thread=8), line(good, thread=9), intercepted(thread=8))
    assert output == [("forbidden", "monitor.demo may not: Put on demo/wrench")]


def test_a_cached_decision_is_reported_by_name() -> None:
    """Zenoh's later lines have only the session: an earlier line had its name."""
    first = decision(MONITOR, "monitor.demo", "Query (ingress) on demo", may=False)
    cached = f"Using cached result: {MONITOR} is unauthorized to Put (ingress) on demo/wrench"
    assert causes(line(first), line(cached), intercepted()) == [
        ("forbidden", "monitor.demo may not: Put on demo/wrench")
    ]


def test_an_allowed_message_that_was_refused_was_too_long() -> None:
    """After access control only the size of a message is checked."""
    text = decision(ARBITER, "arbiter.demo", "Put (ingress) on demo/robot/command", may=True)
    assert causes(line(text), intercepted()) == [
        ("too_long", "arbiter.demo: a message on demo/robot/command")
    ]


def test_a_message_above_its_rate_is_reported_by_name() -> None:
    """The line of the rate limit has the beginning of the session's number."""
    first = decision(ARBITER, "arbiter.demo", "Put (ingress) on demo/arbiter/health", may=True)
    dropped = (
        "Message dropped by the downsampling interceptor: Push(demo/arbiter/health) "
        "from:south:0:client/43e72ad7:2"
    )
    assert causes(line(first), line(dropped), intercepted()) == [
        ("too_often", "arbiter.demo publishes demo/arbiter/health above its rate limit")
    ]


def test_failed_handshakes_have_a_cause_each() -> None:
    """No certificate, a foreign or expired one, no TLS; an end of connection is no cause."""
    code_of = {
        "peer sent no certificates": "no_certificate",
        "invalid peer certificate: UnknownIssuer": "foreign_certificate",
        "invalid peer certificate: Expired": "expired_certificate",
        "received corrupt message of type InvalidContentType": "not_encrypted",
        "something new": "handshake",
        "tls handshake eof": "",
    }
    for text, code in code_of.items():
        warning = line(f"{text}. Hint: increase the system open file limit.",
                       module="zenoh_link_tls::unicast", level="WARN")  # fmt: skip
        assert [cause for cause, _ in causes(warning)] == ([code] if code else [])


def test_an_unknown_name_is_reported_and_a_known_one_is_not() -> None:
    """The name in a certificate of this authority must be a known one."""
    for name, known in (("arbiter.demo", True), ("other.demo", False)):
        text = f"Accepted TLS connection on 127.0.0.1:1: 10.0.0.9:53. Common Name: {name}."
        found = causes(line(text, module="zenoh_link_tls::unicast", level="DEBUG"))
        assert found == (
            [] if known else [("unknown_name", f"{name} from 10.0.0.9:53: unknown name")]
        )


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_no_bytes_in_the_log_break_the_hub(lines: list[bytes]) -> None:
    """Keys and names come from other hosts: no content raises an error."""
    causes(*lines, *(line("x")[:60] + data for data in lines), intercepted())


PROGRAM = """
import os, sys
from services.hub.refusals import Refusals
refusals = Refusals()
refusals.capture(frozenset())
for now in range(3):
    os.write(1, sys.stdin.buffer.readline() * {times})
    refusals.step(now * {step_ns})
sys.stderr.write(str(dict(refusals.counts)))
"""


def run(lines: bytes, times: int, *, step_ns: int) -> str:
    """Let a process refuse each of three lines so many times; return its output."""
    program = PROGRAM.format(times=times, step_ns=step_ns)
    done = subprocess.run(
        [sys.executable, "-c", program], input=lines, capture_output=True, cwd=ROOT, check=True
    )
    assert done.stdout == b""
    return done.stderr.decode()


def test_refusals_are_counted_and_reported_once_a_second() -> None:
    """A hundred of a kind are one line with their number; standard output is empty."""
    warning = line("peer sent no certificates.", module="zenoh_link_tls", level="WARN") + b"\n"
    output = run(warning * 3, times=100, step_ns=REPORT_PERIOD_NS)
    assert output.count("no_certificate: a client without a certificate (100 times)") == 3
    assert output.endswith("{'no_certificate': 300}")


def test_only_the_beginning_of_a_flood_is_read() -> None:
    """One step reads a bounded amount, and lines after the flood are read at once."""
    warning = line("peer sent no certificates.", module="zenoh_link_tls", level="WARN") + b"\n"
    limit = MOST_AT_ONCE_B // len(warning)
    output = run(warning * 3, times=3 * limit, step_ns=REPORT_PERIOD_NS // 20)
    counted = int(output.rpartition(":")[2].strip(" }"))
    assert 3 * (limit - 1) <= counted <= 3 * limit


def test_a_foreign_name_is_one_plain_line() -> None:
    """Control characters and length of a foreign name do not reach the terminal."""
    output: list[str] = []
    refusals = Refusals(write=output.append)
    name = "hostile\x1b[2J\r" + "x" * 500
    text = f"Accepted TLS connection on a:1: b:2. Common Name: {name}."
    before, log = os.dup(1), b""
    try:
        refusals.capture(KNOWN)
        log = line(text, module="zenoh_link_tls::unicast", level="DEBUG") + b"\n"
        os.write(1, log)
    finally:
        os.dup2(before, 1)
        os.close(before)
    refusals.step(REPORT_PERIOD_NS)
    assert len(output) == 1
    assert output[0].rstrip("\n").isprintable()
    assert len(output[0]) < 300
