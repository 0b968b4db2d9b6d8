"""Who may move the arm, as one table: {state: {event: state}}. An event not listed changes nothing.

Rule 1: every change of state is a row here; nothing else writes the state.
Rule 2: only a person's `arm` leads towards motion, and no other event leads out of a latch.
"""

from common.messages import ArbiterState

# fmt: off
TABLE: dict[ArbiterState, dict[str, ArbiterState]] = {
    "BOOT":    {"ready": "IDLE"},
    "IDLE":    {"arm": "ARMED", "hold": "HOLDING"},
    "ARMED":   {"begin": "ACTIVE", "hold": "HOLDING", "fault": "FAULT"},
    "ACTIVE":  {"end": "ARMED",    "hold": "HOLDING", "fault": "FAULT"},
    "HOLDING": {"clear": "IDLE",   "arm": "ARMED",    "fault": "FAULT"},
    "FAULT":   {"clear": "IDLE"},
}
CLEARS: dict[ArbiterState, str] = {
    "BOOT":    "wait until robot, sensor, wrench and regulator are heard",
    "IDLE":    "arm",
    "ARMED":   "",
    "ACTIVE":  "",
    "HOLDING": "arm goes on; clear goes back to IDLE",
    "FAULT":   "mend the cause, then clear, then arm",
}
# fmt: on
MAY_MOVE = ("ARMED", "ACTIVE")


def after(state: ArbiterState, event: str) -> ArbiterState:
    """Return the state after an event."""
    return TABLE[state].get(event, state)
