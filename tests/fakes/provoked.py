"""How to bring about each fault in front of the arbiter's process, on a virtual clock."""

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
    unfit,
)
from tests.fakes.cellmates import Cellmates

Provoke = Callable[[Cellmates], None]
# fmt: off
# Found in another process, whose words the arbiter passes on with their code:
WRENCH_CODES = (
    "sensor_silent", "sensor_fault", "sensor_saturated", "sensor_frozen", "sensor_jump",
    "not_finite", "sensor_stalled", "sensor_restarted", "sensor_stolen", "sensor_lossy",
    "sensor_copies", "sensor_disorder", "sensor_stranger", "sensor_calibration",
)
STATE_CODES = ("robot_link", "link_slow")
HOLD_CODES = (
    "tracking", "unsendable", "robot_refuses", "acceleration", "rate", "joint_speed", "no_stream",
    "feedback",
)
# fmt: on
OVER = 1.001


def says(name: str, **changes: Any) -> Provoke:
    """Let one role say something else."""
    return lambda cell: cell.change(name, **changes)


def invalid(name: str, code: str) -> Provoke:
    """Let one role say that it cannot answer, and why."""
    return says(name, valid=False, reason="as the test wishes", code=code)


def holds(code: str) -> Provoke:
    """Let the robot hold by itself, and say why."""
    return says("robot", hold=tripped(code, "as the test wishes"))


def behind(cell: Cellmates, topic: topics.Topic[Any], data: bytes) -> None:
    """Let bytes come on a topic right behind each good message."""
    put = cell.transport.publish(f"{CELL.cell}/{topic.key}", "stream")
    speak = cell.before_step

    def speak_then_disturb() -> None:
        speak()
        put(data)

    cell.before_step = speak_then_disturb


def replay(cell: Cellmates) -> None:
    """Play one packet of the robot again and again."""
    heard = cell.transport.subscribe(f"{CELL.cell}/{topics.ROBOT_STATE.key}")
    cell.step()
    behind(cell, topics.ROBOT_STATE, heard.take() or b"")


def work(cell: Cellmates, **changes: Any) -> None:
    """Let the regulator command, then go on otherwise."""
    cell.messages["target"] = RegulatorTarget(mode="position", pose=shifted())
    cell.step(3)
    cell.messages["target"] = RegulatorTarget(mode="position", pose=shifted(), **changes)


def pursue(cell: Cellmates) -> None:
    """Let the operator command, and the robot refuse it."""
    assert cell.ask(topics.MOVE, MOVE_DOWN).accepted
    cell.step(100)
    goal = cell.said().goal
    assert goal is not None
    cell.change("robot", goal=GoalReport(id=goal.id, state="refused", reason="out of reach"))


def rely_no_more(cell: Cellmates) -> None:
    """Let the regulator command by a force whose calibration is another one meanwhile."""
    work(cell)
    cell.change("wrench", calibration="another")


def place(x_m: float) -> Provoke:
    """Put the flange somewhere along base x."""
    record = record_of(pin.SE3(T_START.rotation, T_START.translation + np.array([x_m, 0.0, 0.0])))
    return says("robot", **record.model_dump())


# fmt: off
IN_MOTION: dict[str, Provoke] = {
    "invalid":       invalid("robot", ""),
    "undecodable":   lambda cell: behind(cell, topics.WRENCH, b"\xc1"),
    "two_writers":   lambda cell: cell.add_rival("wrench"),
    "overrun":       says("regulator/health", overruns=4),
    "bad_messages":  replay,
    "internal":      says("wrench/health", valid=False, code="internal", reason="an error"),
    **{code: invalid("wrench", code) for code in WRENCH_CODES},
    "misaligned":    lambda cell: setattr(cell, "sample_age_s", 0.08),
    **{code: invalid("robot", code) for code in STATE_CODES},
    **{code: says("robot", status=unfit(code)) for code in ROBOT_FAULTS},
    "joint_count":   says("robot", joint_rad=(0.0,) * 7),
    "robot_holds":   says("robot", hold=tripped("robot_holds", "something of its own")),
    **{code: holds(code) for code in HOLD_CODES},
    "goal_refused":  pursue,
    "workspace":     place(0.41),
    "force":         says("wrench", force_N=(0.0, 0.0, CELL.limits.force_N * OVER)),
    "torque":        says("wrench", torque_Nm=(0.0, CELL.limits.torque_Nm * OVER, 0.0)),
    "hold":          lambda cell: cell.ask_at_once((topics.HOLD, HoldRequest())),
    "calibration":   rely_no_more,
    "regulator":     lambda cell: work(cell, valid=False, reason="as the test wishes"),
}
# fmt: on
