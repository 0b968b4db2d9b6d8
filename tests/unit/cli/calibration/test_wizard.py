"""Calibration wizard in a whole virtual cell: early ends, and reading at rest."""

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from cli.calibration.by_arm import drive
from cli.calibration.gather import STILL_WITHIN_S, Gatherer
from cli.calibration.wizard import CalibrationWizard
from cli.context import INTERRUPTED, REFUSED
from forcemesh import topics
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, MoveRequest
from identification.errors import CalibrationError
from identification.excitation.plan import CalibrationPlan
from sim.robot.ft_sensor import FtSample
from tests.fakes.calibration import HOME_RAD, QUICK, CalibrationLab, demo_cell

FEW = {"poses": 6, "verify_poses": 1}


def status_of(lab: CalibrationLab) -> ArbiterStatus:
    """Return the present status of the arbiter."""
    reader = lab.bus.reader(topics.ARBITER_STATUS)
    lab.world.advance(0.2)
    status: Any = reader.read(lab.world.clock.now_ns()).message
    assert isinstance(status, ArbiterStatus)
    return status


def driven(
    lab: CalibrationLab, plan: CalibrationPlan | None = None
) -> tuple[CalibrationWizard, int | None]:
    """Run the wizard to its end; return it with its exit code."""
    return drive(lab.client, plan or lab.plan(**FEW), lab.notes)


def test_without_a_calibration_contact_is_detected_by_lifting():
    """Without a calibration weight and contact look alike; lifting without rotation decides."""
    lab = CalibrationLab(demo_cell(**QUICK, payload={"mass_kg": 0.0, "com_m": [0, 0, 0]}))
    arm = lab.world.arm

    def push(force_N: float) -> None:
        arm.data.xfrc_applied[arm.model.body("tool").id][2] = force_N

    push(10.0)
    lab.world.advance(0.5)
    lab.notes.at("to the hub: moving", lambda: push(0.0))
    wizard, ended = driven(lab)
    assert ended == 1
    assert wizard.dwells == []
    assert "the tool was in contact at the start: 10." in lab.notes.lines[-1]
    assert "it stays above" in lab.notes.lines[-1]
    assert status_of(lab).state == "IDLE"
    lift_m = (
        arm.kinematics.flange_pose(arm.q).translation[2]
        - (arm.kinematics.flange_pose(HOME_RAD).translation[2])
    )
    assert lift_m == pytest.approx(0.1, abs=2e-3)


@pytest.mark.parametrize("stage", ["moving", "reading"])
def test_a_hold_during_a_run_ends_it_with_the_reason_of_the_arbiter(stage):
    """After a hold by another client nothing moves, and the poses so far are kept."""
    lab = CalibrationLab()
    hold = HoldRequest(reason="the visitor is inside")
    lab.notes.at(f"pose 3 of 6: {stage}", lambda: lab.bus.ask(topics.HOLD, hold))
    wizard, ended = driven(lab)
    assert ended == 1
    assert len(wizard.dwells) == 2
    assert "the arbiter is HOLDING: the visitor is inside" in lab.notes.lines[-1]
    assert_rests(lab)
    assert status_of(lab).trips[-1].text == "the visitor is inside"


def assert_rests(lab: CalibrationLab) -> None:
    """Check that the arm has stopped and stays at rest."""
    lab.world.advance(0.5)
    q = lab.world.arm.q_command
    lab.world.advance(0.5)
    assert lab.world.arm.q_command == pytest.approx(q, abs=1e-9)


def test_ctrl_c_holds_the_arm_and_keeps_the_rows():
    """An interruption during a move: the arm brakes, and earlier readings are kept."""
    lab = CalibrationLab()
    lab.notes.at("pose 2 of 6: moving", Mock(side_effect=KeyboardInterrupt))
    wizard, ended = driven(lab)
    assert (ended, len(wizard.dwells)) == (INTERRUPTED, 1)
    why = "interrupted: the arm holds, the arbiter is HOLDING: the calibration was interrupted"
    assert why in lab.notes.lines[-1]
    assert_rests(lab)


def test_force_feedback_is_not_replaced_by_a_calibration():
    """The client that presses keeps the arm."""
    lab = CalibrationLab()
    plan = lab.plan(**FEW)
    for reply in (
        lab.bus.ask(topics.TARE, Empty()),
        lab.bus.ask(topics.ARM, ArmRequest()),
        lab.bus.ask(topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=10.0)),
    ):
        assert reply.accepted, reply.text
    lab.world.advance(0.2)
    assert driven(lab, plan)[1] == REFUSED
    assert lab.notes.lines[-1] == "the regulator commands the arm: stop that first"
    assert status_of(lab).commander == "regulator"


@pytest.fixture
def lab() -> CalibrationLab:
    """A cell at home that is not armed."""
    return CalibrationLab()


@pytest.fixture
def gatherer(lab: CalibrationLab) -> Gatherer:
    """A client of that cell that has received messages."""
    found = Gatherer(lab.client)
    found.until_received()
    return found


def no_watch(_what: str) -> None:
    """Ignore the progress."""


def test_a_dwell_holds_each_good_reading_once(lab: CalibrationLab, gatherer: Gatherer) -> None:
    """Half a second at 250 Hz, at the place of the sensor; the wrench is moved to its origin."""
    tool = lab.world.arm.model.body("tool").id
    lab.world.arm.data.xfrc_applied[tool][0] = 5.0
    lab.world.advance(0.5)
    dwell = gatherer.dwell("fit", 0.5, no_watch)
    assert len(dwell) == 125
    assert np.diff(dwell.time_s) == pytest.approx(np.full(124, 0.004))
    assert len(np.unique(dwell.force_N, axis=0)) > 100
    T_sensor = lab.world.arm.T_base_flange * lab.cell.sensor.T_flange_sensor.pose
    T_tcp = lab.world.arm.T_base_tcp
    assert dwell.position_m[0] == pytest.approx(T_sensor.translation, abs=1e-6)
    assert dwell.attitude == pytest.approx(T_sensor.rotation, abs=1e-6)
    wrench = lab.bus.reader(topics.WRENCH)
    lab.world.advance(0.1)
    at_tcp = wrench.read(lab.world.clock.now_ns()).message
    assert at_tcp is not None
    lever = np.cross(T_tcp.translation - T_sensor.translation, at_tcp.force_N)
    assert np.linalg.norm(lever) > 0.5
    assert dwell.residual_N == pytest.approx(np.array(at_tcp.force_N), abs=0.2)
    assert dwell.residual_Nm == pytest.approx(at_tcp.torque_Nm + lever, abs=0.05)
    assert gatherer.active_calibration == at_tcp.calibration


def test_a_dwell_begins_when_arm_and_force_are_still(
    lab: CalibrationLab, gatherer: Gatherer
) -> None:
    """After the end of the motion and the settling of the force; else one sentence says why."""
    arm = lab.world.arm
    assert lab.bus.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
    move = MoveRequest(kind="by", joint_rad=(0.2, 0.0, 0.0, 0.0, 0.0, 0.0), speed_m_s=0.3)
    assert lab.bus.ask(topics.MOVE, move).accepted
    waits: list[str] = []
    gatherer.dwell("fit", 0.3, waits.append)
    assert any("the arm to rest" in text for text in waits)
    assert waits[-1] == "reading"
    assert arm.q[0] == pytest.approx(0.2, abs=1e-3)
    rising_N = np.array([0.0, 0.0, 4.0])

    def disturb(sample: FtSample) -> FtSample:
        return replace(sample, force_N=sample.force_N + arm.time_s * rising_N)

    arm.ft_sensor.disturb = disturb
    began_s = arm.time_s
    with pytest.raises(CalibrationError, match="waiting for a steady force"):
        gatherer.dwell("fit", 0.3, no_watch)
    assert arm.time_s - began_s == pytest.approx(STILL_WITHIN_S, abs=0.2)


def test_a_fault_while_reading_is_read_again(lab: CalibrationLab, gatherer: Gatherer) -> None:
    """After a short fault the whole dwell is repeated, once; the error has the sensor's reason."""
    arm, began_s = lab.world.arm, lab.world.arm.time_s
    lost_s, found_s = began_s + 0.7, began_s + 0.9  # longer than deadlines.sensor_s
    arm.ft_sensor.disturb = lambda x: None if lost_s < arm.time_s < found_s else x
    assert len(gatherer.dwell("fit", 0.5, no_watch)) == 125
    assert arm.time_s > found_s + 0.5
    arm.ft_sensor.disturb = lambda x: None if arm.time_s % 0.8 > 0.6 else x
    with pytest.raises(CalibrationError, match=r"failed twice: .*sensor/wrench stale"):
        gatherer.dwell("fit", 1.0, no_watch)
