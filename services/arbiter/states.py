"""State machine of the arbiter: {state: {event: state}}. An event not listed changes nothing.

Rule 1: every change of state is a row here; nothing else writes the state.
Rule 2: only a person's `arm` and `back_off` lead towards motion, and no other event leaves a
        latched state; the one goal of `back_off` is the arbiter's own, and ends in a latch again.
Rule 3: a new owner begins when the arm is at rest: from ARMED, or through SETTLING.
"""

from forcemesh.messages import ArbiterState, ArmPurpose

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


def after(state: ArbiterState, event: str) -> ArbiterState:
    """Return the state after an event."""
    return TABLE[state].get(event, state)
