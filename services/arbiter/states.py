"""State machine of the arbiter: {state: {event: state}}, and the texts of its status. Pure.

An event not listed changes nothing.

Rule 1: every change of state is a row here; nothing else writes the state.
Rule 2: only a person's `arm` and `back_off` lead towards motion, and no other event leaves a
        latched state; the one goal of `back_off` is the arbiter's own, and ends in a latch again.
Rule 3: a new owner begins when the arm is at rest: from ARMED, or through SETTLING.
"""

from forcemesh.faults import FAULTS, clipped
from forcemesh.messages import MAY_MOVE, ArbiterState, ArmPurpose, Purpose, Trip

# fmt: off
TABLE: dict[ArbiterState, dict[str, ArbiterState]] = {
    "BOOT":     {"ready": "IDLE",    "back_off": "ARMED"},
    "IDLE":     {"arm": "ARMED",     "back_off": "ARMED", "hold": "HOLDING"},
    "ARMED":    {"take": "SETTLING", "begin": "ACTIVE",   "hold": "HOLDING", "fault": "FAULT"},
    "SETTLING": {"end": "ARMED",     "begin": "ACTIVE",   "hold": "HOLDING", "fault": "FAULT"},
    "ACTIVE":   {"end": "ARMED",     "take": "SETTLING",  "soften": "STOPPING",
                 "hold": "HOLDING",  "fault": "FAULT"},
    "STOPPING": {"hold": "HOLDING",  "fault": "FAULT"},
    "HOLDING":  {"clear": "IDLE",    "arm": "ARMED",      "back_off": "ARMED", "fault": "FAULT"},
    "FAULT":    {"clear": "IDLE",    "back_off": "ARMED"},
}
MEANS: dict[ArbiterState, str] = {
    "BOOT":     "not every input has been received yet",
    "IDLE":     "at rest, the arm may not move",
    "ARMED":    "a person has armed; the arm waits for a commander",
    "SETTLING": "a commander has taken the arm and begins when it is at rest",
    "ACTIVE":   "a commander moves the arm",
    "STOPPING": "a limit was reached: the set points come to rest or retract a little, then hold",
    "HOLDING":  "braked and held, latched",
    "FAULT":    "braked and held, latched until the cause is fixed",
}
CLEARS: dict[ArbiterState, str] = {
    "BOOT":     "wait until robot, sensor, wrench and regulator are received",
    "IDLE":     "arm",
    "ARMED":    "",
    "SETTLING": "",
    "ACTIVE":   "",
    "STOPPING": "",
    "HOLDING":  "arm to continue; clear to return to IDLE",
    "FAULT":    "fix the cause, then clear, then arm",
}
# fmt: on
ARMED_TEXTS: dict[ArmPurpose, str] = {
    "all": "armed: moves and force feedback may begin",
    "jog": "armed for jog: moves may begin, force feedback may not",
}

MOST_TRIPS = 4
MOST_LINES = 12
LINE_BYTES = 120
MORE = " …"
ALONE: dict[Purpose, str] = {
    "jog": "armed for jog alone; for force feedback hold, then arm",
    "back_off": "the arm backs off by itself, then holds",
}


def after(state: ArbiterState, event: str) -> ArbiterState:
    """Return the state after an event."""
    return TABLE[state].get(event, state)


# --- texts, cut to the size of their message ------------------------------------------------------


def recent(trips: tuple[Trip, ...]) -> tuple[Trip, ...]:
    """Return the first cause and the latest ones."""
    return trips if len(trips) <= MOST_TRIPS else (trips[0], *trips[1 - MOST_TRIPS :])


def lines(texts: list[str]) -> tuple[str, ...]:
    """Return the first lines, each cut to its largest length."""
    return tuple(_cut(text) for text in texts[:MOST_LINES])


def _cut(text: str) -> str:
    """Cut a line between words, with a mark at the cut."""
    if len(text.encode()) <= LINE_BYTES:
        return text
    beginning = clipped(text, LINE_BYTES - len(MORE.encode()))
    return (beginning.rpartition(" ")[0] or beginning) + MORE


def what_next(state: ArbiterState, not_ready: list[Trip], armed_for: Purpose = "all") -> str:
    """Return the next step for a person: the remedy if arming would be refused."""
    if state in MAY_MOVE and armed_for in ALONE:
        return ALONE[armed_for]
    if not_ready and "arm" in TABLE[state]:
        return f"{FAULTS[not_ready[0].code].remedy}; then arm"
    return CLEARS[state]
