"""Extreme requests: none ends a service or moves the arm beyond the limits of the cell file.

Every request model, every field at its extremes, in every state, against the cores of a whole cell
on a virtual clock. An unhandled error of a core is raised here and fails the test.
"""

import json
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from common.bus.memory_bus import MemoryCall
from common.config.calibration import CalibrationSection
from common.motion.limits import Limits
from forcemesh import topics
from forcemesh.codec import SCHEMA_VERSION, decode_record, encode_record, pack
from forcemesh.messages import OPERATIONAL
from forcemesh.requests import CalibrationRequest, Empty, HoldRequest, Reply
from tests.fakes.bench import CELL
from tests.fakes.extremes import hostile
from tests.fakes.lab import BRAKE_S, Lab
from tests.fakes.long import long
from tests.unit.common.config.test_calibration import calibration

EVERY_S = 0.004  # one request in each control period
SAMPLE = 30  # of about 3000, for each state, in a quick run
LIMITS = Limits.of(CELL)
SPEED_M_S = 1.2 * CELL.limits.speed_m_s + 0.02  # of the simulated arm, with servo lag
FORCE_N = 1.3 * CELL.limits.force_N
LONGEST_SENTENCE = 400  # characters: no number is written out with 300 digits


def idle(lab: Lab) -> None:
    """Bring the arm to IDLE: held and cleared."""
    held(lab)
    assert lab.ask(topics.CLEAR, Empty()).accepted


def armed(_lab: Lab) -> None:
    """Keep the arm armed, as a lab is."""


def held(lab: Lab) -> None:
    """Hold the arm by request."""
    assert lab.ask(topics.HOLD, HoldRequest()).accepted
    lab.cell.advance(BRAKE_S)


def faulty(lab: Lab) -> None:
    """Kill a process, so that the arbiter reports FAULT."""
    lab.cell.kill("wrench")
    lab.cell.advance(0.3)
    assert lab.status.state == "FAULT"


STATES: dict[str, Callable[[Lab], None]] = {
    "IDLE": idle,
    "ARMED": armed,
    "moving": Lab.lift,
    "pressing": Lab.press,
    "HOLDING": held,
    "FAULT": faulty,
}


def send(lab: Lab, key: str, data: bytes) -> MemoryCall:
    """Queue the bytes of a request for its server."""
    call = MemoryCall(data)
    lab.cell.transport.serve(f"{CELL.cell}/{key}").waiting.append(call)
    return call


def send_all(lab: Lab, requests: list[tuple[str, bytes]]) -> None:
    """Send requests in sequence; check the simulated arm after each."""
    before_m = lab.p_m()
    for key, data in requests:
        send(lab, key, data)
        lab.cell.advance(EVERY_S)
        p_m, q = lab.p_m(), lab.q_command()
        assert np.isfinite(q).all(), (key, data)
        speed_m_s = float(np.linalg.norm(p_m - before_m)) / EVERY_S
        assert speed_m_s < SPEED_M_S, (key, data)
        tcp_m = (lab.cell.arm.T_base_flange * CELL.tool.T_flange_tcp.pose).translation
        assert (tcp_m > LIMITS.workspace_min_m - 0.01).all(), (key, data)
        assert (tcp_m < LIMITS.workspace_max_m + 0.01).all(), (key, data)
        assert abs(lab.force_N) < FORCE_N, (key, data)
        before_m = p_m


def assert_hold_works(lab: Lab) -> None:
    """Check that a hold is executed: the arm comes to rest and stays there."""
    call = send(lab, topics.HOLD.key, b"")
    lab.cell.advance(2 * EVERY_S)
    assert call.reply is not None
    assert decode_record(call.reply, Reply).accepted
    assert lab.status.state not in OPERATIONAL
    lab.cell.advance(BRAKE_S)
    lab.assert_still(0.1)


@pytest.mark.parametrize("share", ["some", long("all")])
@pytest.mark.parametrize("state", STATES)
def test_no_request_ends_a_service_or_breaks_a_limit(state: str, share: str) -> None:
    """In every state, for any request: the arm keeps its limits, and a hold works."""
    requests = hostile()
    if share == "some":
        requests = random.Random(state).sample(requests, SAMPLE)
    lab = Lab(CELL)  # a request in each of its control periods
    STATES[state](lab)
    send_all(lab, requests)
    assert_hold_works(lab)


def calibration_json(path: tuple[str, ...], value: Any) -> str:
    """Return a calibration of the cell with one value replaced; its revision is left out."""
    fields: dict[str, Any] = {
        "payload": CELL.payload,
        "T_flange_tcp": CELL.tool.T_flange_tcp,
        "T_flange_sensor": CELL.sensor.T_flange_sensor,
    }
    tree = json.loads(calibration(**fields).model_dump_json())
    tree["revision"] = ""
    part = tree
    for name in path[:-1]:
        part = part[name]
    part[path[-1]] = value
    return json.dumps(tree)


EXTREME_CALIBRATIONS: list[tuple[tuple[str, ...], Any]] = [
    (("payload", "gravity_direction_in_base"), [0.0, 0.0, -2.0]),
    (("payload", "gravity_direction_in_base"), [0.0, 0.0, 0.0]),
    (("payload", "gravity_direction_in_base"), [1e200, 0.0, 0.0]),
    (("payload", "mounting_rotation_rad"), [1e300, 0.0, 0.0]),
    (("payload", "mass_kg"), 1e308),
    (("payload", "com_m"), [1e200, 1e200, 0.0]),
    (("payload", "bias_force_N"), [1e308, 1e308, 1e308]),
    (("payload", "bias_torque_Nm"), [-1e308, 0.0, 0.0]),
    (("T_flange_tcp", "position_m"), [1e200, 0.0, 0.0]),
    (("T_flange_tcp", "oat_deg"), [1e308, 0.0, 0.0]),
    (("T_flange_sensor", "oat_deg"), [1e16, -1e16, 0.0]),
]


@pytest.fixture(scope="module")
def held_lab() -> Lab:
    """A held cell, which no refused calibration changes."""
    lab = Lab()
    held(lab)
    return lab


@pytest.mark.parametrize(("path", "value"), EXTREME_CALIBRATIONS, ids=str)
def test_an_impossible_calibration_is_refused(
    path: tuple[str, ...], value: Any, held_lab: Lab
) -> None:
    """The reply names the value; the wrench stays valid."""
    lab = held_lab
    text = calibration_json(path, value)
    with pytest.raises(ValidationError) as refused:  # a file with this value is refused too
        CalibrationSection.model_validate_json(text)
    assert {str(mistake["loc"][0]) for mistake in refused.value.errors()} == {path[0]}
    reply = lab.ask(topics.CALIBRATE, CalibrationRequest(calibration_json=text))
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert all(name in reply.text for name in path)
    assert len(reply.text) < LONGEST_SENTENCE
    lab.cell.advance(0.05)
    assert lab.now(lab.wrench).valid


@pytest.mark.parametrize("w", [0.0, 1e-310, 2.0])
def test_a_task_frame_whose_quaternion_is_no_rotation_is_refused(w: float) -> None:
    """Zero, denormal, twice too long: `malformed` names the field, and nothing starts to press."""
    lab = Lab()
    pose = {"position_m": (0.0, 0.5, 0.3), "orientation_xyzw": (0.0, 0.0, 0.0, w)}
    axes: tuple[dict[str, Any], ...] = ({}, {}, {"control": "force", "setpoint": 20.0}, {}, {}, {})
    task = {"frame": "pose", "pose": pose, "axes": axes}
    call = send(lab, topics.FORCE_START.key, pack({"v": SCHEMA_VERSION, "task": task}))
    lab.cell.advance(2 * EVERY_S)
    assert call.reply is not None
    reply = decode_record(call.reply, Reply)
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert "ForceStartRequest.task.pose.orientation_xyzw: the quaternion" in reply.text
    lab.assert_still(0.1)


def test_a_hold_is_served_while_every_inbox_is_full() -> None:
    """With invalid requests in every inbox the hold is executed within two periods."""
    lab = Lab()
    lab.lift()
    for row in topics.REQUESTS:
        for _ in range(16):
            send(lab, row.key, encode_record(Empty()) if row is topics.CLEAR else b"\xc1")
    lab.cell.advance(EVERY_S * 2)
    assert lab.status.state not in OPERATIONAL
    lab.cell.advance(EVERY_S * 8)  # until the queued requests are answered: a few in each period
    assert_hold_works(lab)
