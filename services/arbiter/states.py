"""Who may move the arm, as one table: {state: {event: state}}. An event not listed changes nothing.

Rule 1: every change of state is a row here; nothing else writes the state.
Rule 2: only a person's `arm` and `back_off` lead towards motion, and no other event leads out of a
        latch; the one goal of `back_off` is the arbiter's own, and ends in a latch again.
Rule 3: whoever takes the arm begins when it is at rest: from ARMED, or by way of SETTLING.
"""

from forcemesh.messages import ArbiterState

# fmt: off
TABLE: dict[ArbiterState, dict[str, ArbiterState]] = {
    "BOOT":     {"ready": "IDLE",    "back_off": "ARMED"},
    "IDLE":     {"arm": "ARMED",     "back_off": "ARMED", "hold": "HOLDING"},
    "ARMED":    {"take": "SETTLING", "begin": "ACTIVE",   "hold": "HOLDING", "fault": "FAULT"},
    "SETTLING": {"end": "ARMED",     "begin": "ACTIVE",   "hold": "HOLDING", "fault": "FAULT"},
    "ACTIVE":   {"end": "ARMED",     "take": "SETTLING",  "soften": "STOPPING",
                 "hold": "HOLDING",  "fault": "FAULT"},
    "STOPPING": {"hold": "HOLDING",  "fault": "FAULT"},
    "HOLDING":  {"clear": "IDLE",    "arm": "ARMED",      "back_off": "ARMED"},
    "FAULT":    {"clear": "IDLE",    "back_off": "ARMED"},
}
MEANS: dict[ArbiterState, str] = {
    "BOOT":     "not every input has been heard yet",
    "IDLE":     "at rest, nobody may move the arm",
    "ARMED":    "a person has armed; the arm waits for somebody to command it",
    "SETTLING": "somebody has taken the arm and begins when it is at rest",
    "ACTIVE":   "somebody commands the arm",
    "STOPPING": "a limit was met: the set points come to rest, or go back a little, and then hold",
    "HOLDING":  "braked and held, latched",
    "FAULT":    "braked and held, latched until the cause is mended",
}
CLEARS: dict[ArbiterState, str] = {
    "BOOT":     "wait until robot, sensor, wrench and regulator are heard",
    "IDLE":     "arm",
    "ARMED":    "",
    "SETTLING": "",
    "ACTIVE":   "",
    "STOPPING": "",
    "HOLDING":  "arm goes on; clear goes back to IDLE",
    "FAULT":    "mend the cause, then clear, then arm",
}
# fmt: on


def after(state: ArbiterState, event: str) -> ArbiterState:
    """Return the state after an event."""
    return TABLE[state].get(event, state)
