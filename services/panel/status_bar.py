"""Contents of the status bar: state and cause, force, commander, services; reply to a stop."""

from math import hypot
from typing import Any

from common.config.cell import CellConfig
from common.config.info import cell_info
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.client.force import press_force_N
from forcemesh.faults import trip_text
from forcemesh.messages import TOUCHING, ArbiterStatus, ContactEvent, RegulatorTarget
from services.panel.sessions import Rights
from services.panel.state_colours import NO_STATE, STATE_COLOURS, StateColour
from services.panel.viewer import RequestOutcome
from services.panel.watch import Snapshot, age_text

STREAMS = {  # role: topic whose age is shown; its health topic is published at a low rate
    "robot": "robot",
    "sensor": "sensor",
    "wrench": "wrench",
    "regulator": "target",
    "arbiter": "command",
}
ALONE = {"jog": " for jog", "back_off": " to back off"}
UNANSWERED = "NO ANSWER"
NOT_RECEIVED: Reading[Any] = Reading(None, None, 0.0, "no message", silent=True)


def may_stop(cell: CellConfig, rights: Rights) -> bool:
    """Return whether a page may request a hold; a view-only page has a monitor's rights."""
    return rights == "operate" or cell.bus.monitor_may_hold


def strip(cell: CellConfig, snapshot: Snapshot, rights: Rights) -> dict[str, Any]:
    """Return the contents of the status bar."""
    state, colour = state_of(snapshot)
    why, remedy = cause_of(snapshot)
    return {
        "cell": cell.cell,
        "mode": "SIMULATION" if cell.sim is not None else "REAL",
        "rights": rights,
        "may_stop": may_stop(cell, rights),
        "state": state,
        "held": held_as(snapshot),
        "colour": colour._asdict(),
        "why": why,
        "remedy": remedy,
        "force": force_display(cell, snapshot),
        "who": who(snapshot.arbiter.fresh),
        "contact": contact_text(snapshot.contact.fresh),
        "services": [] if snapshot.hub_fault else services(snapshot),
    }


def state_of(snapshot: Snapshot) -> tuple[str, StateColour]:
    """Return the state and its colours."""
    if snapshot.hub_fault:
        return "cell not reached", NO_STATE
    status = snapshot.arbiter.fresh
    if status is None:
        return "no arbiter status", NO_STATE
    what = ALONE.get(status.armed_for, "") if status.operational else ""
    return f"{status.state}{what}", STATE_COLOURS[status.state]


def held_as(snapshot: Snapshot) -> str:
    """Return the state in which the arm is held, empty while it may move or is unknown."""
    status = None if snapshot.hub_fault else snapshot.arbiter.fresh
    return "" if status is None or status.may_move else status.state


def cause_of(snapshot: Snapshot) -> tuple[str, str]:
    """Return why the arm does not move, or what prevents arming; and the remedy."""
    status = snapshot.arbiter.fresh
    if snapshot.hub_fault or status is None:
        return snapshot.hub_fault or snapshot.arbiter.fault, ""
    if status.trips:
        return "; ".join(trip_text(trip) for trip in status.trips), status.clears
    not_ready = "; ".join(status.not_ready)
    return (f"not ready: {not_ready}" if not_ready else ""), ""


def who(status: ArbiterStatus | None) -> str:
    """Return the commander of the arm, and the next one; empty while it is unknown."""
    if status is None:
        return ""
    following = "" if status.next_commander == "none" else f", next: {status.next_commander}"
    return f"commander: {status.commander}{following}"


def services(snapshot: Snapshot) -> list[dict[str, str]]:
    """Return each role with its rate, the age of its last message, and its fault.

    A helper is shown once its first message was received: a recorder is optional.
    """
    rows = []
    for role in (*topics.ROLES, *topics.HELPERS):
        received: Reading[Any] | None = snapshot.health.get(role)
        reading = received or NOT_RECEIVED
        if role in topics.HELPERS and reading.message is None:
            continue
        stream: Reading[Any] = getattr(snapshot, STREAMS[role]) if role in STREAMS else reading
        newest = reading if stream.message is None else stream
        rate_hz = getattr(reading.message, "rate_hz", None)
        rate = "–" if rate_hz is None else f"{rate_hz:.0f} Hz"  # an external sensor may report none
        fault = reading.fault or str(getattr(reading.message, "fault", ""))
        rows.append({"name": role, "text": f"{rate} · {age_text(newest)}", "fault": fault})
    return rows


def force_display(cell: CellConfig, snapshot: Snapshot) -> dict[str, str]:
    """Return caption and value of the force [N] and its set point [N].

    While force feedback presses, the force is the one along the tool's z axis, else |F|. Without a
    fresh wrench the value is empty, and `lost` gives the reason: no data must not look like 0 N.
    """
    wrench, robot, target = snapshot.wrench.fresh, snapshot.robot.fresh, snapshot.target.fresh
    if snapshot.hub_fault or wrench is None:
        return {"caption": "force", "value": "", "setpoint": "", "lost": lost(snapshot)}
    note = "" if wrench.calibrated else ", not calibrated"
    caption, force_N, setpoint = "force |F|", hypot(*wrench.force_N), ""
    presses = target is not None and target.mode in {"position", "both"}
    if robot is not None and target is not None and presses and not is_guided(target):
        caption = "normal force"
        force_N = press_force_N(robot, wrench, cell_info(cell).T_flange_tcp)
        setpoint = "" if target.setpoint_N is None else f"{target.setpoint_N:.1f}"
    note += lowered_text(target)
    return {
        "caption": f"{caption}{note}",
        "value": f"{force_N:z.1f}",
        "setpoint": setpoint,
        "lost": "",
    }


def is_guided(target: RegulatorTarget) -> bool:
    """Return whether a task has compliant axes alone: a hand guides the tool."""
    return bool(target.axes) and all(axis.control != "force" for axis in target.axes)


def contact_text(event: ContactEvent | None) -> str:
    """Return state of the contact, its duration and its peak force; empty while it is unknown."""
    if event is None:
        return ""
    text = f"contact: {event.state} {event.duration_s:.1f} s"
    return f"{text}, peak {event.peak_N:.1f} N" if event.state in TOUCHING else text


def lowered_text(target: RegulatorTarget | None) -> str:
    """Return by how much the gains are lowered and the loop's delay, empty at full gains."""
    if target is None or target.gain_share == 1.0:
        return ""
    text = f", gains at {100.0 * target.gain_share:.0f} %"
    if target.round_trip_s is None or target.modelled_round_trip_s is None:
        return text
    trips_ms = 1e3 * target.round_trip_s, 1e3 * target.modelled_round_trip_s
    return "{}: loop delay {:.0f} ms, model {:.0f} ms".format(text, *trips_ms)


def lost(snapshot: Snapshot) -> str:
    """Return in a few words why there is no force."""
    reading: Reading[Any] = snapshot.wrench
    if snapshot.hub_fault or reading.message is None:
        return "no data"
    return f"no data for {age_text(reading)}" if reading.silent else "not valid"


def stop_text(answer: RequestOutcome, snapshot: Snapshot) -> str:
    """Return the reply to Stop motion, from the reply and the state received after it.

    A reply can be lost or late although the request was executed: the page must not show HOLDING
    and NO ANSWER at the same time.
    """
    if answer.word == "done":
        return answer.text
    if answer.word != "no answer":
        return f"{answer.word}: {answer.text}"
    if state := held_as(snapshot):
        return f"the arm is held (state {state}); the reply was lost"
    why = f"({answer.text}). Use the emergency stop or the pendant."
    return f"{UNANSWERED} from the cell {why}"
