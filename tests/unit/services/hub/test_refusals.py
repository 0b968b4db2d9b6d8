"""Causes of the hub's refusals, parsed from Zenoh's log and reported once a second."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.hub import refusals
from services.hub.refusals import LONGEST_LOGGED_TEXT, REPORT_EVERY_NS, RefusalParser
from tools.tree import ROOT

INTERCEPTOR = "zenoh::net::routing::interceptor"
TLS = "zenoh_link_tls::unicast"
ARBITER, MONITOR = "43e72ad703c02988df40ff33891b35c0", "2f1f30b60fc3a1a27ed41943e007d019"
KNOWN = frozenset({"arbiter.demo", "monitor.demo"})


def line(text: str, *, thread: int = 8, module: str = INTERCEPTOR, level: str = "TRACE") -> bytes:
    """Return a line as Zenoh writes it."""
    head = f"2026-11-22T04:45:03.421Z {level:>5}  rx-0 ThreadId({thread:02}) {module}: "
    return (head + text).encode()


def decision(session: str, name: str, action: str, *, may: bool, thread: int = 8) -> bytes:
    """Return the line of an access decision."""
    verdict = "authorized" if may else "unauthorized"
    subject = f"Interface(lo)+CertCommonName({name})+Transport(Tls)+{session}"
    text = f"{session} on {subject} is {verdict} to {action}"
    return line(text, thread=thread, module=f"{INTERCEPTOR}::access_control")


def causes(*lines: bytes) -> list[tuple[str, str]]:
    """Return the causes that a new parser finds in lines."""
    return RefusalParser(KNOWN).causes(lines)


REFUSED = line("Msg intercepted!")
COMMAND = "Put (ingress) on demo/robot/command"
FORBIDDEN = decision(MONITOR, "monitor.demo", "Put (ingress) on demo/wrench", may=False)
ALLOWED = decision(ARBITER, "arbiter.demo", COMMAND, may=True)
MAY_NOT = ("forbidden", "monitor.demo may not: Put on demo/wrench")
ELSEWHERE = decision(ARBITER, "arbiter.demo", COMMAND, may=True, thread=9)
NAMED = decision(MONITOR, "monitor.demo", "Query (ingress) on demo", may=False)
CACHED = line(f"Using cached result: {MONITOR} is unauthorized to Put (ingress) on demo/wrench")
DROPPED = line(
    "Message dropped by the downsampling interceptor: Push(demo/arbiter/health) "
    "from:south:0:client/43e72ad7:2"
)


@pytest.mark.parametrize(
    ("lines", "cause"),
    [
        ([FORBIDDEN, REFUSED], MAY_NOT),
        # Zenoh checks every action on a key at its declaration: this refuses nothing.
        ([FORBIDDEN, FORBIDDEN], None),
        # A refusal belongs to its thread, whatever lines of other threads come between.
        ([FORBIDDEN, ELSEWHERE, REFUSED], MAY_NOT),
        # Later lines have only the session: an earlier line had its name.
        ([NAMED, CACHED, REFUSED], MAY_NOT),
        # After access control only the size of a message is checked.
        ([ALLOWED, REFUSED], ("too_long", "arbiter.demo: a message on demo/robot/command")),
        # The line of the rate limit has the beginning of the session's number.
        (
            [ALLOWED, DROPPED, REFUSED],
            ("too_often", "arbiter.demo publishes demo/arbiter/health above its rate limit"),
        ),
    ],
)
def test_a_refused_message_is_reported_with_name_and_key(
    lines: list[bytes], cause: tuple[str, str] | None
) -> None:
    """The line before the refusal on the same thread has the cause."""
    assert causes(*lines) == ([] if cause is None else [cause])


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("peer sent no certificates", "no_certificate"),
        ("invalid peer certificate: UnknownIssuer", "foreign_certificate"),
        ("invalid peer certificate: Expired", "expired_certificate"),
        ("received corrupt message of type InvalidContentType", "not_encrypted"),
        ("something new", "handshake"),
        ("tls handshake eof", ""),
    ],
)
def test_a_failed_handshake_has_its_cause(text: str, code: str) -> None:
    """No certificate, a foreign or expired one, no TLS; an end of connection is no cause."""
    hint = "Hint: increase the system open file limit."
    warning = line(f"{text}. {hint}", module=TLS, level="WARN")
    assert [cause for cause, _ in causes(warning)] == ([code] if code else [])


def accepted(name: str) -> bytes:
    """Return the line of a client's connection."""
    text = f"Accepted TLS connection on 127.0.0.1:1: 10.0.0.9:53. Common Name: {name}."
    return line(text, module=TLS, level="DEBUG")


def test_an_unknown_name_is_reported_and_a_known_one_is_not() -> None:
    """The name in a certificate of this authority must be a known one."""
    assert causes(accepted("arbiter.demo")) == []
    text = "other.demo from 10.0.0.9:53: unknown name"
    assert causes(accepted("other.demo")) == [("unknown_name", text)]


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_no_bytes_in_the_log_break_the_hub(lines: list[bytes]) -> None:
    """Keys and names come from other hosts: no content raises an error."""
    causes(*lines, *(line("x")[:60] + data for data in lines), REFUSED)


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
WARNING = line("peer sent no certificates.", module=TLS, level="WARN") + b"\n"


def run(lines: bytes, times: int, *, step_ns: int = REPORT_EVERY_NS) -> str:
    """Let a process refuse each of three lines so many times; return its output."""
    program = PROGRAM.format(times=times, step_ns=step_ns)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, input=lines, capture_output=True, cwd=ROOT, check=True)
    assert done.stdout == b""
    return done.stderr.decode()


def test_refusals_are_counted_and_reported_once_a_second() -> None:
    """A hundred of a kind are one line with their number; a foreign name is one plain line."""
    output = run(WARNING * 3, times=100)
    assert output.count("no_certificate: a client without a certificate (100 times)") == 3
    assert output.endswith("{'no_certificate': 300}")
    report, _ = run(accepted("hostile\x1b[2J\r" + "x" * 500) + b"\n", times=1).split("\n")
    assert report.startswith("hub: refused unknown_name: hostile")
    assert report.isprintable()
    assert len(report) < LONGEST_LOGGED_TEXT + 100


def test_only_the_beginning_of_a_flood_is_read() -> None:
    """One step reads a bounded amount, and lines after the flood are read at once."""
    limit = refusals.MOST_AT_ONCE_B // len(WARNING)
    output = run(WARNING * 3, times=3 * limit, step_ns=REPORT_EVERY_NS // 20)
    counted = int(output.rpartition(":")[2].strip(" }"))
    assert 3 * (limit - 1) <= counted <= 3 * limit
