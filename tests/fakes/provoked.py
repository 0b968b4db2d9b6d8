"""Procedures that cause each fault in front of the arbiter's process, on a virtual clock."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from common.motion.convert import record_of
from forcemesh import topics
from forcemesh.faults import tripped
from forcemesh.messages import (
    GoalReport,
    RegulatorTarget,
)
from forcemesh.requests import HoldRequest
from tests.fakes.arbiter_world import (
    CELL,
    MOVE_DOWN,
    ROBOT_FAULTS,
    T_START,
    shifted,
    with_fault,
)
from tests.fakes.cellmates import Cellmates

Provoke = Callable[[Cellmates], None]
# fmt: off
# Detected in another process, whose text the arbiter passes on with their code:
WRENCH_CODES = (
    "sensor_silent", "sensor_fault", "sensor_saturated", "sensor_frozen", "sensor_jump",
    "not_finite", "sensor_stalled", "sensor_restarted", "sensor_stolen", "sensor_lossy",
    "sensor_copies", "sensor_disorder", "sensor_stranger", "sensor_calibration",
)
STATE_CODES = ("robot_link", "link_slow")
HOLD_CODES = (
    "tracking", "unsendable", "robot_refuses", "acceleration", "rate", "joint_speed", "no_stream",
    "feedback", "unexplained_motion",
)
# fmt: on
OVER = 1.001


def change_message(name: str, **changes: Any) -> Provoke:
    """Change fields of one role's message."""
    return lambda cell: cell.change(name, **changes)


def invalid(name: str, code: str) -> Provoke:
    """Publish a role's message as invalid, with a reason."""
    return change_message(name, valid=False, reason="set by the test", code=code)


def holds(code: str) -> Provoke:
    """Let the robot hold by itself, with a reason."""
    return change_message("robot", hold=tripped(code, "set by the test"))


def follow_with_bytes(cell: Cellmates, topic: topics.Topic[Any], data: bytes) -> None:
    """Publish bytes on a topic right behind each good message."""
    put = cell.transport.publish(f"{CELL.cell}/{topic.key}", "stream")
    before = cell.before_step

    def before_then_disturb() -> None:
        before()
        put(data)

    cell.before_step = before_then_disturb


def replay(cell: Cellmates) -> None:
    """Replay one packet of the robot repeatedly."""
    received = cell.transport.subscribe(f"{CELL.cell}/{topics.ROBOT_STATE.key}")
    cell.step()
    follow_with_bytes(cell, topics.ROBOT_STATE, received.take() or b"")


def work(cell: Cellmates, **changes: Any) -> None:
    """Let the regulator command, then change its target."""
    cell.messages["target"] = RegulatorTarget(mode="position", pose=shifted())
    cell.step(3)
    cell.messages["target"] = RegulatorTarget(mode="position", pose=shifted(), **changes)


def pursue(cell: Cellmates) -> None:
    """Let the operator command, and the robot refuse it."""
    assert cell.ask(topics.MOVE, MOVE_DOWN).accepted
    cell.step(100)
    goal = cell.published().goal
    assert goal is not None
    cell.change("robot", goal=GoalReport(id=goal.id, state="refused", reason="out of reach"))


def change_calibration(cell: Cellmates) -> None:
    """Let the regulator command by a force whose calibration changes meanwhile."""
    work(cell)
    cell.change("wrench", calibration="another")


def place(x_m: float) -> Provoke:
    """Set the flange's position along base x."""
    record = record_of(pin.SE3(T_START.rotation, T_START.translation + np.array([x_m, 0.0, 0.0])))
    return change_message("robot", **record.as_dict())


# fmt: off
IN_MOTION: dict[str, Provoke] = {
    "invalid":       invalid("robot", ""),
    "undecodable":   lambda cell: follow_with_bytes(cell, topics.WRENCH, b"\xc1"),
    "two_writers":   lambda cell: cell.add_rival("wrench"),
    "overrun":       change_message("regulator/health", overruns=4),
    "bad_messages":  replay,
    "internal":      change_message("wrench/health", valid=False, code="internal", reason="error"),
    **{code: invalid("wrench", code) for code in WRENCH_CODES},
    "misaligned":    lambda cell: setattr(cell, "sample_age_s", 0.08),
    **{code: invalid("robot", code) for code in STATE_CODES},
    **{code: change_message("robot", status=with_fault(code)) for code in ROBOT_FAULTS},
    "joint_count":   change_message("robot", joint_rad=(0.0,) * 7),
    "robot_holds":   change_message("robot", hold=tripped("robot_holds", "something of its own")),
    **{code: holds(code) for code in HOLD_CODES},
    "goal_refused":  pursue,
    "workspace":     place(0.41),
    "force":         change_message("wrench", force_N=(0.0, 0.0, CELL.limits.force_N * OVER)),
    "torque":        change_message("wrench", torque_Nm=(0.0, CELL.limits.torque_Nm * OVER, 0.0)),
    "hold":          lambda cell: cell.ask_at_once((topics.HOLD, HoldRequest())),
    "calibration":   change_calibration,
    "regulator":     lambda cell: work(cell, valid=False, reason="set by the test"),
}
# fmt: on
