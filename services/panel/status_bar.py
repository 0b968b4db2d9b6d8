"""What the bar at the top of the page says: state, who commands, each service's rate. Pure."""

from typing import Any

from common.config.cell import Cell
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.messages import ArbiterStatus
from services.panel.sessions import Rights
from services.panel.watch import Snapshot, age_text

LOOKS = {  # of the chip with the arbiter's state
    "ARMED": "go",
    "SETTLING": "go",
    "ACTIVE": "go",
    "STOPPING": "bad",
    "HOLDING": "bad",
    "FAULT": "bad",
}
STREAMS = {  # role: the topic by whose age it is judged; its health comes only some times a second
    "robot": "robot",
    "sensor": "sensor",
    "wrench": "wrench",
    "regulator": "target",
    "arbiter": "command",
}


def mode_of(cell: Cell) -> str:
    """Return what is at the end of the wire: never leave a person in doubt."""
    return "SIMULATION" if cell.sim is not None else "REAL"


def may_stop(cell: Cell, rights: Rights) -> bool:
    """Tell whether a page may ask for a hold: one that only looks as a monitor may."""
    return rights == "operate" or cell.bus.monitor_may_hold


def strip(cell: Cell, heard: Snapshot, rights: Rights) -> dict[str, Any]:
    """Return everything that the bar shows."""
    state, look, why = state_of(heard)
    return {
        "cell": cell.cell,
        "mode": mode_of(cell),
        "rights": rights,
        "may_stop": may_stop(cell, rights),
        "state": state,
        "held": held_as(heard),
        "look": look,
        "why": why,
        "who": who(heard.arbiter.fresh),
        "services": [] if heard.hub_fault else services(heard),
    }


ALONE = {"jog": " for jog", "back_off": " to back off"}


def state_of(heard: Snapshot) -> tuple[str, str, str]:
    """Return the state in a word, how it looks, and why it is so."""
    if heard.hub_fault:
        return "cell not reached", "lost", heard.hub_fault
    status = heard.arbiter.fresh
    if status is None:
        return "arbiter not heard", "lost", heard.arbiter.fault
    what = ALONE.get(status.armed_for, "") if status.goes_on else ""
    return f"{status.state}{what}", LOOKS.get(status.state, ""), why(status)


def held_as(heard: Snapshot) -> str:
    """Return the state in which the arm is held, empty while it may move or is not known."""
    status = None if heard.hub_fault else heard.arbiter.fresh
    return "" if status is None or status.may_move else status.state


def why(status: ArbiterStatus) -> str:
    """Return what stopped the arm and what clears it, or what arming would be refused for."""
    if status.trips:
        text = "; ".join(trip.text for trip in status.trips)
        return f"{text}: {status.clears}" if status.clears else text
    return "; ".join(status.not_ready)


def who(status: ArbiterStatus | None) -> str:
    """Return who commands the arm."""
    if status is None or status.commander == "none":
        return "nobody commands"
    return f"the {status.commander} commands"


def services(heard: Snapshot) -> list[dict[str, str]]:
    """Return each role with its rate, the age of what it says last, and its fault.

    A helper is shown from when it was first heard: a cell without a recorder lacks nothing.
    """
    rows = []
    heard_helpers = [name for name in topics.HELPERS if has_spoken(heard.health.get(name))]
    for role in (*topics.ROLES, *heard_helpers):
        reading: Reading[Any] | None = heard.health.get(role)
        stream: Reading[Any] | None = getattr(heard, STREAMS[role]) if role in STREAMS else None
        newest = stream if stream is not None and stream.message is not None else reading
        age = "never heard" if newest is None else age_text(newest)
        rows.append(
            {"name": role, "text": f"{rate_text(reading)} · {age}", "fault": fault_of(reading)}
        )
    return rows


def has_spoken(reading: Reading[Any] | None) -> bool:
    """Tell whether anything was ever heard."""
    return reading is not None and reading.message is not None


def rate_text(reading: Reading[Any] | None) -> str:
    """Return the rate of a role's loop."""
    rate_hz = getattr(reading.message, "rate_hz", None) if reading is not None else None
    return "–" if rate_hz is None else f"{rate_hz:.0f} Hz"  # a sensor of somebody else's says none


def fault_of(reading: Reading[Any] | None) -> str:
    """Return what is wrong with a role, empty when nothing is: silence, or its own word."""
    if reading is None:
        return "never heard"
    return reading.fault or str(getattr(reading.message, "fault", ""))
