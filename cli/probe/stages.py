"""Stages of the probe: the commands to controller/fmprobe.as in their order.

The program has the primitives and their limits; the order and the search are here.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import median

from cli.probe.link import ProbeError, ProbeLink
from cli.probe.readings import ProbeReadings, trace_of

ROUND_TRIPS = 20
UNREAD_S = 3.5  # a PC that does not read: more than the time-out of TCP_SEND, 1 s
FLOOD_WITHIN_S = 40.0
SETTLE_S = 0.5  # until the program has seen the end of a connection
MOTION_WITHIN_S = 60.0
OWN_ERROR = -30108

TRAVEL_MM, SPEED_MM_S, SAMPLE_S = 5.0, 10.0, 0.005
PARTS = 12  # segments of a series
LONGEST_S, SHORTEST_S, FALL = 0.1, 0.005, 1.3
HALVINGS = 3  # of the interval in which E1117 begins: 3 % of it remain
PROCESS_TIME_OVER = -31117
JOINT_DEG, JOINT_S, JOINT_MM_S = 2.0, 2.0, 10.0
PERCENTS = 1.0
SLOW_TRAVEL_MM, SLOW_MM_S = 0.4, 0.2
CLEARLY_SLOWER = 0.67  # monitor speed, as a fraction
LINE = f"line {TRAVEL_MM:g} {SPEED_MM_S:g} 100 {SAMPLE_S}"
MOTIONS = (  # name of the result, command
    ("line", LINE),
    ("line ramp", f"line {TRAVEL_MM:g} {SPEED_MM_S:g} 10 {2 * SAMPLE_S}"),
    ("line fast", f"line {TRAVEL_MM:g} {2 * SPEED_MM_S:g} 100 {SAMPLE_S}"),
    ("line fast ramp", f"line {TRAVEL_MM:g} {2 * SPEED_MM_S:g} 10 {2 * SAMPLE_S}"),
    ("line slow", f"line {SLOW_TRAVEL_MM:g} {SLOW_MM_S:g} 100 {4 * SAMPLE_S}"),
    ("ahead", "ahead"),
    ("joint s", f"joint {JOINT_DEG:g} {JOINT_S:g} 2"),
    ("joint % 1", f"joint {JOINT_DEG:g} {PERCENTS:g} 0"),
    ("joint % 2", f"joint {2 * JOINT_DEG:g} {PERCENTS:g} 0"),
    ("joint mm/s 1", f"joint {JOINT_DEG:g} {JOINT_MM_S:g} 1"),
    ("joint mm/s 2", f"joint {2 * JOINT_DEG:g} {JOINT_MM_S:g} 1"),
    ("turn mm/s", f"turn {JOINT_DEG:g} {JOINT_MM_S:g} 1"),
    ("turn s", f"turn {JOINT_DEG:g} {JOINT_S:g} 2"),
    ("brake", "brake"),
    ("hold", "hold"),
)

Report = Callable[[str], None]
Ask = Callable[[str], bool]


@dataclass(slots=True)
class Found:
    """Everything that was measured, by stage."""

    stages: list[str] = field(default_factory=list)
    still: ProbeReadings = field(default_factory=ProbeReadings)  # stage a
    wire: ProbeReadings = field(default_factory=ProbeReadings)  # stage b
    round_trips_s: list[float] = field(default_factory=list)
    motion: dict[str, ProbeReadings] = field(default_factory=dict)  # stage c, by command
    segments: list[tuple[float, int, float]] = field(default_factory=list)  # asked, code, took
    follows: bool | None = None  # MM/S follows the monitor speed
    scale: float = 1.0  # actual speed over program speed in MM/S


# --- stage a --------------------------------------------------------------------------------------


def stage_a(link: ProbeLink, found: Found) -> None:
    """Read the results that the program has had before a client connected.

    Raises:
        ProbeError: The program reports another version, or has not finished.
    """
    found.still = link.command("list")
    if found.still.get("probe") != 1.0:
        raise ProbeError("the program does not report `probe 1`: load this version's fmprobe.as")
    if found.still.get("stage.a") is None:
        raise ProbeError("stage a has not finished: wait for `stage.a 1` on the terminal")
    found.stages.append("a")


# --- stage b --------------------------------------------------------------------------------------


def stage_b(link: ProbeLink, found: Found, *, unplug: Ask | None = None) -> None:
    """Measure the socket: round trip, parts, time-outs, ends, and what errors do.

    Args:
        link: The dialogue.
        found: Receives the results.
        unplug: Asks a person to do something with the cable; without it that is not measured.
    """
    for _ in range(ROUND_TRIPS):
        began_s = link.wire.now_s()
        link.command("echo")
        found.round_trips_s.append(link.wire.now_s() - began_s)
    replies = [_in_parts(link), link.command("idle", 12.0)]
    _end(link, 1, link.wire.close)
    _end(link, 2, link.wire.reset)
    if unplug is not None:
        _unplugged(link, unplug)
    _flood(link)
    replies.append(link.command("error", 12.0))
    replies.append(link.command("list"))
    found.wire = _merged(replies)
    found.stages.append("b")


def _in_parts(link: ProbeLink) -> ProbeReadings:
    """Send one command in three pieces; the reply counts the receives that it took."""
    for part in (b"e", b"c"):
        link.send(part)
        link.wire.wait(0.1)
    return link.command("echo", rest="ho")


def _end(link: ProbeLink, kind: int, end: Callable[[], None]) -> None:
    """End the connection in an announced manner, and connect again."""
    link.command(f"end {kind}")
    end()
    link.wire.wait(SETTLE_S)
    link.reopen()


def _unplugged(link: ProbeLink, ask: Ask) -> None:
    link.command("end 3")
    if not (ask("unplug the controller's network cable") and ask("wait 10 s and plug it in")):
        return
    try:
        link.command("echo")
    except ProbeError:
        link.reopen()


def _flood(link: ProbeLink) -> None:
    """Leave what the program sends unread, then read it; the program closes the connection."""
    link.send(b"flood\n")
    link.wire.wait(UNREAD_S)
    end_s = link.wire.now_s() + FLOOD_WITHIN_S
    try:
        while link.wire.now_s() < end_s:
            link.wire.receive(1.0)
    except OSError:
        pass
    link.wire.close()
    link.reopen()


def _merged(replies: list[ProbeReadings]) -> ProbeReadings:
    merged = ProbeReadings()
    for reply in replies:
        for name, values in reply.numbers.items():
            merged.numbers[name] = values
        merged.failed |= reply.failed
    return merged


# --- stage c --------------------------------------------------------------------------------------


def stage_c(link: ProbeLink, found: Found, report: Report) -> None:
    """Move the arm by up to 5 mm and measure it.

    Raises:
        ProbeError: fp.ok is not 1 on the controller, or the arm is in no place for it.
    """
    refuse_without_go(link.command("go"))
    try:
        found.motion["first"] = _moved(link, "first", report)
        found.scale = _scale(found, _traced(link, LINE, report))
        link.command(f"scale {found.scale}")
        for name, text in MOTIONS:
            follow = _traced if name.startswith("line") else _moved
            found.motion[name] = follow(link, text, report)
        _search(link, found, report)
    finally:
        with suppress(ProbeError):  # the loss of the connection has ended stage c by itself
            link.command("stay")
    found.stages.append("c")


def refuse_without_go(reply: ProbeReadings) -> None:
    """Raise ProbeError unless stage c may move."""
    went = reply.get("go")
    if went == 0.0:
        raise ProbeError(
            "stage c: the person at the emergency stop must type fp.ok=1 on the controller's "
            "terminal first; nothing has moved"
        )
    if went != 1.0:
        raise ProbeError(
            "stage c: 5 mm above the present pose is out of reach: jog the arm lower and start "
            "again; nothing has moved"
        )


def _moved(link: ProbeLink, text: str, report: Report) -> ProbeReadings:
    """Execute one command of stage c. Raises ProbeError if nothing has moved."""
    report(text)
    reply = link.command(text, MOTION_WITHIN_S)
    if "moved_away" in reply.numbers:
        raise ProbeError(f"stage c ended at `{text}`: the arm is not where stage c began")
    if not (reply.numbers or reply.failed):
        raise ProbeError(f"stage c ended at `{text}`: it is not permitted any more; begin it again")
    return reply


def _traced(link: ProbeLink, text: str, report: Report) -> ProbeReadings:
    """Execute one command of stage c, and read the samples of its motion."""
    reply = _moved(link, text, report)
    reply.samples = link.command("trace", MOTION_WITHIN_S).samples
    return reply


def _scale(found: Found, first: ProbeReadings) -> float:
    """Return actual speed over program speed in MM/S, from the speed of the first motion.

    Above 67 % monitor speed the two cases are too near, and the switch ABS.SPEED decides.
    """
    fraction = (found.still.get("mspeed") or 100.0) / 100.0
    trace = trace_of(first.samples, TRAVEL_MM)
    if trace is not None and fraction <= CLEARLY_SLOWER:
        found.follows = trace.speed_mm_s < SPEED_MM_S * fraction**0.5
        return fraction if found.follows else 1.0
    return 1.0 if found.still.get("switch.abs.speed") else fraction


def _search(link: ProbeLink, found: Found, report: Report) -> None:
    """Shorten the segments until E1117, then halve the interval in which it begins."""
    asked_s, longest_bad_s = LONGEST_S, 0.0
    while asked_s >= SHORTEST_S and not longest_bad_s:
        if _series(link, found, asked_s, report):
            longest_bad_s = asked_s
        elif found.segments[-1][2] > 2.0 * asked_s:
            return  # the program itself is slower: shorter ones would show nothing
        asked_s /= FALL
    if not longest_bad_s or len(found.segments) < 2:
        return
    shortest_good_s = found.segments[-2][0]
    for _ in range(HALVINGS):
        middle_s = (longest_bad_s * shortest_good_s) ** 0.5
        if _series(link, found, middle_s, report):
            longest_bad_s = middle_s
        else:
            shortest_good_s = middle_s


def _series(link: ProbeLink, found: Found, asked_s: float, report: Report) -> bool:
    """Execute a series of segments of that duration; return whether it ended with E1117."""
    length_mm = asked_s * SPEED_MM_S
    report(f"segments of {length_mm:.3f} mm in {1e3 * asked_s:.1f} ms")
    reply = link.command(f"segs {length_mm:.5f} {SPEED_MM_S:g} {PARTS}", MOTION_WITHIN_S)
    stopped = reply.get("stopped")
    code = reply.get("segs.code") if stopped is None else stopped
    if code is None:
        raise ProbeError("stage c ended at `segs`: the program gave no result")
    found.segments.append((asked_s, int(code), reply.get("segs.each_s") or 0.0))
    return int(code) == PROCESS_TIME_OVER


def middle_round_trip_s(found: Found) -> float | None:
    """Return the median of the round trips [s]."""
    return median(found.round_trips_s) if found.round_trips_s else None
