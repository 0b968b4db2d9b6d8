"""A whole cell in one process: the arm holds when a process dies, freezes, restarts or is cut.

A process that is cut receives nothing: a one-way partition, or a stall of TCP.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from forcemesh import topics
from forcemesh.bus import Reader
from forcemesh.messages import MAY_MOVE, RobotCommand
from forcemesh.requests import Empty
from services.arbiter.service import ArbiterService
from services.regulator.service import Regulator
from services.wrench.service import WrenchService
from tests.fakes.bench import CELL, cell_with
from tests.fakes.lab import BRAKE_S, FOUND_S, PRESS_N, Lab

TOUCH_N, SILENT_N = 0.5, 5.0
LATE_S = 0.03  # one period of each service in the chain, beyond the deadline
# The topic whose absence reveals each role's death, and that the trip must name.
MISSING_TOPIC: dict[str, topics.Topic[Any]] = {
    "robot": topics.SENSOR_WRENCH,  # simulated, it is the sensor as well, whose deadline is shorter
    "wrench": topics.WRENCH,
    "regulator": topics.REGULATOR_TARGET,
    "hub": topics.HEALTH["hub"],
}
ROLES = [*MISSING_TOPIC, "arbiter"]


def rise(lab: Lab) -> None:
    """Press until half of the force is there."""
    lab.approach()
    lab.seconds_until(lambda: lab.force_N > 0.5 * PRESS_N, FOUND_S)


MOTIONS: dict[str, Callable[[Lab], None]] = {
    "approach": Lab.approach,
    "press": rise,
    "goal": Lab.lift,
}
FROZEN = [(role, "goal") for role in ROLES] + [(role, "approach") for role in ROLES[1:3]]


# --- death ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", ["press", "goal"])
@pytest.mark.parametrize("role", ROLES)
def test_the_arm_holds_in_time_and_stays_held_when_a_process_dies(role: str, motion: str) -> None:
    """Each role in each motion: the hold comes within the deadline and names the input."""
    lab = Lab(CELL)
    MOTIONS[motion](lab)
    topic = MISSING_TOPIC.get(role, topics.ROBOT_COMMAND)
    before = lab.q_command()
    lab.cell.advance(0.02)
    assert np.abs(lab.q_command() - before).max() > 1e-8, "the arm must be moving for this test"
    lab.cell.kill(role)

    def permission_is_gone() -> bool:
        if role == "arbiter":
            return bool(lab.state.hold_reason)
        command: RobotCommand = lab.now(lab.command)
        return command.permission is None

    in_time_s = CELL.stale_after_s(topic) + LATE_S
    assert lab.seconds_until(permission_is_gone, in_time_s) > 0.5 * CELL.stale_after_s(topic)
    lab.cell.advance(0.02)
    if role == "arbiter":
        assert topic.key in lab.state.hold_reason
    else:
        assert lab.status.state == "FAULT"
        assert f"{topic.key} stale" in lab.status.trips[0].text
        assert role == "robot" or topic.key in lab.state.hold_reason
    lab.cell.advance(BRAKE_S)
    lab.assert_still(0.5)
    if role not in {"arbiter", "hub"}:
        assert not lab.ask(topics.CLEAR, Empty()).accepted
    if role != "arbiter":
        assert not lab.ask(topics.ARM, Empty()).accepted
        lab.assert_still(0.2)


# --- freeze ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("role", "motion"), FROZEN)
def test_a_process_that_resumes_after_a_freeze_moves_nothing(role: str, motion: str) -> None:
    """A debugger or swapping causes such a freeze; then a person clears, arms and starts."""
    lab = Lab()
    MOTIONS[motion](lab)
    frozen = lab.cell.runners.pop(role)
    lab.cell.advance(1.3 if role in ("hub", "arbiter") else 0.7)
    lab.cell.runners[role] = frozen
    lab.cell.advance(BRAKE_S)
    lab.assert_still(1.2)
    assert lab.status.state in {"HOLDING", "FAULT"}
    assert lab.status.trips
    assert (role == "arbiter") == any("itself stalled" in t.text for t in lab.status.trips)
    assert lab.state.hold_reason

    assert lab.ask(topics.CLEAR, Empty()).accepted
    assert lab.ask(topics.ARM, Empty()).accepted
    lab.assert_still(0.3)
    before = lab.q_command()
    MOTIONS[motion](lab)
    assert np.abs(lab.q_command() - before).max() > 1e-6


@pytest.mark.parametrize("law", ["plain", "adaptive"])
@pytest.mark.parametrize("deadline_s", [0.02, 0.04, 0.2])
def test_a_longer_deadline_costs_no_force_when_the_sensor_falls_silent(
    law: Any, deadline_s: float
) -> None:
    """At the first touch: the regulator rests after three periods, the arbiter at the deadline.

    The preflight reckons with the arbiter alone.
    """
    cell = cell_with(deadlines__sensor_s=deadline_s, deadlines__command_s=max(0.04, deadline_s))
    lab = Lab(cell)
    pressed_N = list[float]()

    def note() -> bool:
        pressed_N.append(float(np.linalg.norm(lab.cell.arm.true_wrench().force_N)))
        return False

    lab.approach(law)
    lab.cell.advance(FOUND_S, lambda: note() or pressed_N[-1] > TOUCH_N)
    assert pressed_N[-1] > TOUCH_N
    lab.cell.arm.ft_sensor.disturb = lambda _: None
    lab.cell.advance(deadline_s + LATE_S + BRAKE_S, note)
    assert lab.status.state == "FAULT"
    assert max(pressed_N) < SILENT_N


# --- a cut ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("role", [role for role in ROLES if role != "hub"])
def test_the_arm_holds_in_time_when_a_process_receives_nothing(role: str) -> None:
    """It still publishes; when its messages arrive again, all at once, nothing resumes."""
    lab = Lab()
    MOTIONS["approach"](lab)
    sources: list[Any] = [reader._source for reader in readers(lab, role)]
    for source in sources:
        source.waiting = deque(maxlen=0)
    # Of the slowest input, and one period of each service down to the arm's last set point.
    slowest = topics.ROBOT_COMMAND if role == "robot" else topics.ROBOT_STATE
    lab.cell.advance(lab.cell.cell.stale_after_s(slowest) + LATE_S + BRAKE_S)
    lab.assert_still(0.3)
    for source in sources:
        source.waiting = deque(maxlen=1)
    lab.assert_still(0.5)
    assert lab.state.hold_reason
    assert lab.status.state not in MAY_MOVE


def readers(lab: Lab, role: str) -> list[Reader[Any]]:
    """Return the readers of a process."""
    values = vars(lab.cell.runners[role].service).values()
    nested = [each for value in values if isinstance(value, dict) for each in value.values()]
    return [each for each in (*values, *nested) if isinstance(each, Reader)]


# --- a restart ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("role", "make"),
    [("arbiter", ArbiterService), ("regulator", Regulator), ("wrench", WrenchService)],
)
def test_a_process_that_restarts_within_its_deadline_moves_nothing(role: str, make: Any) -> None:
    """A new process has no lease and no session; before the next arming the arm stays."""
    lab = Lab()
    MOTIONS["approach"](lab)
    lab.cell.kill(role)
    bus = lab.cell._bus(role)
    lab.cell._add(role, make(bus, lab.cell.cell), bus)
    lab.cell.advance(BRAKE_S)
    lab.assert_still(1.2)
    assert lab.status.state not in MAY_MOVE
    assert lab.status.trips[0].code in {"writer", "two_writers"}
