"""Why the hub refused something: causes from Zenoh's own lines, told once a second."""

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
MOST_AT_ONCE_B, TELL_EVERY_NS = 256_000, 1_000_000_000
KNOWN = frozenset({"arbiter.demo", "monitor.demo"})


def line(text: str, *, thread: int = 8, module: str = ACL, level: str = "TRACE") -> bytes:
    """Return a line as Zenoh writes it."""
    return (
        f"2026-11-22T04:45:03.421Z {level:>5}  rx-0 ThreadId({thread:02}) {module}: {text}"
    ).encode()


def judged(session: str, name: str, what: str, *, may: bool) -> str:
    """Return the text of a judgement."""
    word = "authorized" if may else "unauthorized"
    subject = f"Interface(lo)+CertCommonName({name})+Transport(Tls)+{session}"
    return f"{session} on {subject} is {word} to {what}"


def intercepted(thread: int = 8) -> bytes:
    """Return the line of a refusal."""
    module = "zenoh::net::routing::interceptor"
    return line("Msg intercepted!", thread=thread, module=module)


def causes(*lines: bytes) -> list[tuple[str, str]]:
    """Return what a fresh judge makes of lines."""
    return RefusalParser(KNOWN).causes(lines)


def test_a_forbidden_message_is_told_with_name_and_key() -> None:
    """The line before the refusal on the same thread says who and what."""
    text = judged(MONITOR, "monitor.demo", "Put (ingress) on demo/robot/command", may=False)
    assert causes(line(text), intercepted()) == [
        ("forbidden", "monitor.demo may not: Put on demo/robot/command")
    ]


def test_what_is_only_looked_up_is_no_refusal() -> None:
    """Zenoh judges every action on a key when it is declared: that alone refuses nothing."""
    text = judged(MONITOR, "monitor.demo", "Put (ingress) on demo/wrench", may=False)
    assert causes(line(text), line(text)) == []


def test_threads_are_not_mixed_up() -> None:
    """A refusal belongs to the thread that it happened on, whatever the others say between."""
    bad = judged(MONITOR, "monitor.demo", "Put (ingress) on demo/wrench", may=False)
    good = judged(ARBITER, "arbiter.demo", "Put (ingress) on demo/robot/command", may=True)
    said = causes(line(bad, thread=8), line(good, thread=9), intercepted(thread=8))
    assert said == [("forbidden", "monitor.demo may not: Put on demo/wrench")]


def test_a_remembered_judgement_is_told_by_name() -> None:
    """Zenoh's later lines carry only the session: its name was told before."""
    first = judged(MONITOR, "monitor.demo", "Query (ingress) on demo", may=False)
    cached = f"Using cached result: {MONITOR} is unauthorized to Put (ingress) on demo/wrench"
    assert causes(line(first), line(cached), intercepted()) == [
        ("forbidden", "monitor.demo may not: Put on demo/wrench")
    ]


def test_what_was_allowed_and_still_refused_was_too_long() -> None:
    """Behind access control only the size of a message is looked at."""
    text = judged(ARBITER, "arbiter.demo", "Put (ingress) on demo/robot/command", may=True)
    assert causes(line(text), intercepted()) == [
        ("too_long", "arbiter.demo: a message on demo/robot/command")
    ]


def test_what_comes_too_often_is_told_by_name() -> None:
    """The line of the rate limit carries the beginning of the session's number."""
    first = judged(ARBITER, "arbiter.demo", "Put (ingress) on demo/arbiter/health", may=True)
    dropped = (
        "Message dropped by the downsampling interceptor: Push(demo/arbiter/health) "
        "from:south:0:client/43e72ad7:2"
    )
    assert causes(line(first), line(dropped), intercepted()) == [
        ("too_often", "arbiter.demo publishes demo/arbiter/health above its rate limit")
    ]


def test_handshakes_that_fail_have_a_cause_each() -> None:
    """No certificate, a foreign or old one, no TLS at all; a hang-up says nothing new."""
    told = {
        "peer sent no certificates": "no_certificate",
        "invalid peer certificate: UnknownIssuer": "foreign_certificate",
        "invalid peer certificate: Expired": "expired_certificate",
        "received corrupt message of type InvalidContentType": "not_encrypted",
        "something new": "handshake",
        "tls handshake eof": "",
    }
    for text, code in told.items():
        warning = line(f"{text}. Hint: increase the system open file limit.",
                       module="zenoh_link_tls::unicast", level="WARN")  # fmt: skip
        assert [cause for cause, _ in causes(warning)] == ([code] if code else [])


def test_a_name_that_nobody_has_is_told_and_a_known_one_is_not() -> None:
    """Whoever comes in with a certificate of this authority is looked up by name."""
    for name, known in (("arbiter.demo", True), ("stranger.demo", False)):
        text = f"Accepted TLS connection on 127.0.0.1:1: 10.0.0.9:53. Common Name: {name}."
        found = causes(line(text, module="zenoh_link_tls::unicast", level="DEBUG"))
        assert found == (
            [] if known else [("unknown_name", f"{name} from 10.0.0.9:53: unknown name")]
        )


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_no_bytes_in_the_log_break_the_hub(lines: list[bytes]) -> None:
    """Keys and names come from strangers: whatever they hold, nothing is raised."""
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
    """Let a process refuse each of three lines so many times; return what it says."""
    program = PROGRAM.format(times=times, step_ns=step_ns)
    done = subprocess.run(
        [sys.executable, "-c", program], input=lines, capture_output=True, cwd=ROOT, check=True
    )
    assert done.stdout == b""
    return done.stderr.decode()


def test_refusals_are_counted_and_told_once_a_second() -> None:
    """A hundred of a kind are one line with their number; standard output stays silent."""
    warning = line("peer sent no certificates.", module="zenoh_link_tls", level="WARN") + b"\n"
    said = run(warning * 3, times=100, step_ns=TELL_EVERY_NS)
    assert said.count("no_certificate: a client without a certificate (100 times)") == 3
    assert said.endswith("{'no_certificate': 300}")


def test_of_a_flood_only_the_beginning_is_read() -> None:
    """What one step reads is bounded, and what comes after the flood is heard at once."""
    warning = line("peer sent no certificates.", module="zenoh_link_tls", level="WARN") + b"\n"
    most = MOST_AT_ONCE_B // len(warning)
    said = run(warning * 3, times=3 * most, step_ns=TELL_EVERY_NS // 20)
    counted = int(said.rpartition(":")[2].strip(" }"))
    assert 3 * (most - 1) <= counted <= 3 * most


def test_words_of_a_stranger_are_one_plain_line() -> None:
    """Control characters and length of a foreign name do not reach the terminal."""
    said: list[str] = []
    refusals = Refusals(say=said.append)
    name = "evil\x1b[2J\r" + "x" * 500
    text = f"Accepted TLS connection on a:1: b:2. Common Name: {name}."
    before, log = os.dup(1), b""
    try:
        refusals.capture(KNOWN)
        log = line(text, module="zenoh_link_tls::unicast", level="DEBUG") + b"\n"
        os.write(1, log)
    finally:
        os.dup2(before, 1)
        os.close(before)
    refusals.step(TELL_EVERY_NS)
    assert len(said) == 1
    assert said[0].rstrip("\n").isprintable()
    assert len(said[0]) < 300
