"""Parser of Zenoh's log for refused connections and messages, reported once a second by cause.

Zenoh does not report refusals to a program and logs their causes at its most verbose level only,
one line per message. Its standard output is therefore redirected to a file in memory, which the
hub's loop reads and truncates: no writer ever blocks, and of a flood only the beginning is read.
"""

import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from forcemesh.clock import NS_PER_S
from forcemesh.topics import SELF_TEST

MOST_AT_ONCE_B = (
    256_000  # of Zenoh's lines in one step, twice the log output of a busy cell; the rest is lost
)
REPORT_EVERY_NS = NS_PER_S
LONGEST_LOGGED_TEXT = 200
MOST_NAMES = 1024  # remembered by name
MOST_KINDS = 256  # causes between two reports

# `TIME LEVEL thread ThreadId(08) module: text`
LINE = re.compile(rb"^\S+ +([A-Z]+) +(?:\S+ +)?(ThreadId\(\d+\)) ([\w:]+): (.*)$")
ACCEPTED = re.compile(r"Accepted TLS connection on \S+ (\S+)\. Common Name: (.*)\.$")
SUBJECT = re.compile(r"^([0-9a-f]+) on .*CertCommonName\((.*?)\)")
JUDGED = re.compile(r"([0-9a-f]{8,}) .*?is (un)?authorized to (.+) \((in|e)gress\) on (.*)$")
DROPPED = re.compile(r"dropped by the downsampling interceptor: \w+\((.*?)\) from:.*/([0-9a-f]+):")
HANDSHAKES = (
    ("peer sent no certificates", "no_certificate", "a client without a certificate"),
    ("UnknownIssuer", "foreign_certificate", "a certificate from another authority"),
    ("BadSignature", "foreign_certificate", "a certificate from another authority"),
    ("Expired", "expired_certificate", "an expired certificate"),
    (
        "NotValidYet",
        "expired_certificate",
        "a certificate that is not valid yet: check the clocks",
    ),
    ("InvalidContentType", "not_encrypted", "a client without TLS"),
    ("received corrupt message", "not_encrypted", "a client without TLS"),
)
HUNG_UP = ("handshake eof", "Connection reset", "Broken pipe")  # consequences of a refusal


@dataclass(slots=True)
class RefusalParser:
    """Parser of Zenoh's log lines.

    A refusal is the line `Msg intercepted!`; the line before it on the same thread has its cause.
    """

    known: frozenset[str]  # certificate names with access
    names: dict[str, str] = field(default_factory=dict)  # of sessions
    before: dict[bytes, str] = field(default_factory=dict)  # the last line of each thread

    def causes(self, lines: Iterable[bytes]) -> list[tuple[str, str]]:
        """Return (code, text) of each refusal in lines of Zenoh's log."""
        found = (self._cause(match) for line in lines if (match := LINE.match(line)))
        return [cause for cause in found if cause is not None]

    def _cause(self, match: re.Match[bytes]) -> tuple[str, str] | None:
        level, thread, module, raw = match.groups()
        if raw == b"Msg intercepted!":
            return self._intercepted(self.before.pop(thread, ""))
        text = raw.decode(errors="replace")
        if module.startswith(b"zenoh_link"):
            return self._link(level, text)
        if module.startswith(b"zenoh::net::routing::interceptor"):
            self.before[thread] = text
            if b"CertCommonName" in raw and (subject := SUBJECT.match(text)):
                if len(self.names) > MOST_NAMES:
                    self.names.clear()
                self.names[subject[1]] = subject[2]
        elif level in {b"WARN", b"ERROR"}:
            return "zenoh", text
        return None

    def _link(self, level: bytes, text: str) -> tuple[str, str] | None:
        if accepted := ACCEPTED.search(text):
            where, name = accepted.groups()
            if name in self.known:
                return None
            return "unknown_name", f"{name} from {where}: unknown name"
        for sign, code, words in HANDSHAKES:
            if sign in text:
                return code, words
        if level not in {b"WARN", b"ERROR"} or any(sign in text for sign in HUNG_UP):
            return None
        return "handshake", text.removesuffix(" Hint: increase the system open file limit.")

    def _intercepted(self, why: str) -> tuple[str, str]:
        if dropped := DROPPED.search(why):
            key, session = dropped.groups()
            return "too_often", f"{self._name(session)} publishes {key} above its rate limit"
        if not (judged := JUDGED.search(why)):
            return "refused", "a message, Zenoh reports no cause"
        session, no, what, direction, key = judged.groups()
        if no is None:
            return "too_long", f"{self._name(session)}: a message on {key}"
        verb = "may not" if direction == "in" else "may not be sent"
        return "forbidden", f"{self._name(session)} {verb}: {what} on {key}"

    def _name(self, session: str) -> str:
        if session in self.names:
            return self.names[session]
        return next((n for whole, n in self.names.items() if whole.startswith(session)), session)


class Refusals:
    """Counters of refusals by cause, with a report on standard error."""

    def __init__(self, write: Callable[[str], object] = sys.stderr.write) -> None:
        """Start without a log to read."""
        self.counts: Counter[str] = Counter()
        self._write = write
        self._judge = RefusalParser(frozenset())
        self._waiting: Counter[tuple[str, str]] = Counter()
        self._file = -1
        self._rest = b""
        self._reported_ns = 0

    def capture(self, known: frozenset[str]) -> None:
        """Redirect this process's standard output, Zenoh's log, to a file in memory."""
        self._judge = RefusalParser(known)
        self._file = os.memfd_create("zenoh-log", os.MFD_CLOEXEC)
        # Append mode: the file can be truncated between two writes.
        appending = os.open(f"/proc/self/fd/{self._file}", os.O_WRONLY | os.O_APPEND)
        os.dup2(appending, 1)
        os.close(appending)

    def step(self, now_ns: int) -> None:
        """Read the new log lines, and report the causes when a report is due."""
        if self._file < 0:
            return
        self._read()
        if self._waiting and now_ns >= self._reported_ns:
            self._reported_ns = now_ns + REPORT_EVERY_NS
            for (code, words), times in self._waiting.items():
                often = f" ({times} times)" if times > 1 else ""
                self._write(f"hub: refused {code}: {_clean(words)}{often}\n")
            self._waiting.clear()

    def _read(self) -> None:
        size = os.fstat(self._file).st_size
        if size == 0:
            return
        data = self._rest + os.pread(self._file, MOST_AT_ONCE_B, 0)
        os.ftruncate(self._file, 0)  # loses a line written since the read, which is rare
        whole, _, self._rest = data.rpartition(b"\n")
        if size > MOST_AT_ONCE_B:
            self._rest = b""  # the rest of this line was not read
        for cause in self._judge.causes(whole.split(b"\n")):
            if cause[1].endswith(f"/{SELF_TEST}"):  # each process's self-test at its start
                continue
            self.counts[cause[0]] += 1
            if cause in self._waiting or len(self._waiting) < MOST_KINDS:
                self._waiting[cause] += 1


def _clean(words: str) -> str:
    """Return text from an untrusted client as one line of printable characters."""
    return "".join(c if c.isprintable() else "?" for c in words)[:LONGEST_LOGGED_TEXT]
