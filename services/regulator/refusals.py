"""Why a start of force feedback, or a path, is refused. Pure."""

from typing import Any

from common.cell import Cell
from common.endpoints import Reading
from common.faults import refusal
from common.messages import ArbiterStatus
from common.requests import ForceStartRequest, PathRequest, Reply
from services.regulator.route import MOST_POINTS
from services.regulator.session import Session, mover


def refused_start(
    wanted: ForceStartRequest, cell: Cell, arbiter: ArbiterStatus | None, worse: Reading[Any]
) -> Reply | None:
    """Return why force feedback cannot start, None when it can; `worse`: of two inputs."""
    largest_N = cell.force.setpoint_max_N
    if wanted.host not in cell.robot.hosts:
        text = (
            f"host {wanted.host} needs a cell with a controller that can run force feedback; "
            f"this cell offers {', '.join(cell.robot.hosts)}"
        )
        return refusal("host", text)
    if wanted.host == "controller" and not all(wanted.axes):
        return refusal("host", "axes: the controller cannot hold axes of its own, the PC can")
    if wanted.host == "controller" and wanted.law == "guide":
        return refusal("host", "law guide: the controller cannot give way to a hand, the PC can")
    if wanted.law == "guide" and wanted.setpoint_N > 0.0:
        text = "law guide gives way to a hand: its set point is 0"
        return refusal("setpoint", text, value=wanted.setpoint_N, limit=0.0)
    if wanted.setpoint_N > largest_N:
        text = "set point above force.setpoint_max_N"
        return refusal("setpoint", text, value=wanted.setpoint_N, limit=largest_N)
    if arbiter is None or not arbiter.goes_on:
        state = "silent" if arbiter is None else arbiter.state
        return refusal("not_armed", f"the arbiter is {state}: arm first")
    if arbiter.armed_for == "jog":
        return refusal("not_armed", "armed for jog alone: hold, then arm for all")
    if who := mover(arbiter):
        text = f"the {who} commands the arm: wait for the move to end, or hold"
        return refusal("busy", text)
    return refusal(worse.code, worse.fault) if worse.fault else None


def refused_path(wanted: PathRequest, session: Session | None, cell: Cell) -> Reply | None:
    """Return why points cannot be gone along, None when they can."""
    if session is None or session.failure is not None:
        return refusal("not_armed", "no force feedback is running: start it first")
    if session.wanted.host != "pc":
        return refusal("host", "the controller cannot follow points, the PC can")
    if wanted.points_m and session.memory is not None and _gives_way_across(session.wanted):
        text = (
            "the adaptive law would take the way for a push and go back: start force feedback "
            "in frame tool, with axes that leave out x and y"
        )
        return refusal("axes", text)
    if wanted.speed_m_s > cell.force.speed_max_m_s:
        most_m_s = cell.force.speed_max_m_s
        text = "the path is faster than force.speed_max_m_s"
        return refusal("setpoint", text, value=wanted.speed_m_s, limit=most_m_s)
    ahead = len(session.route.points) if wanted.append and session.route else 0
    count = ahead + len(wanted.points_m)
    if count > MOST_POINTS:
        return refusal("busy", "too many points ahead", value=count, limit=MOST_POINTS)
    return None


def _gives_way_across(wanted: ForceStartRequest) -> bool:
    """Return whether force feedback may move the tool across its axis, where a path goes."""
    return wanted.mode != "orientation" and (wanted.frame != "tool" or any(wanted.axes[:2]))
