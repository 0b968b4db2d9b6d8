"""Calibration wizard in a whole virtual cell: a complete run, and every early end."""

from typing import Any

import pytest

from cli.calibration.by_arm import drive
from cli.calibration.wizard import CalibrationWizard
from cli.context import INTERRUPTED
from forcemesh import topics
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest
from identification.excitation.plan import CalibrationPlan
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

    def interrupt() -> None:
        raise KeyboardInterrupt

    lab.notes.at("pose 2 of 6: moving", interrupt)
    wizard, ended = driven(lab)
    assert ended == INTERRUPTED
    assert len(wizard.dwells) == 1
    assert (
        "interrupted: the arm holds, the arbiter is HOLDING: the calibration was interrupted"
        in lab.notes.lines[-1]
    )
    assert status_of(lab).state == "HOLDING"
    assert_rests(lab)


def test_a_cell_without_sensor_readings_is_refused_before_anything_moves():
    """Without a sensor nothing is armed, so no hold is needed."""
    lab = CalibrationLab()
    plan = lab.plan(**FEW)
    lab.world.arm.ft_sensor.disturb = lambda sample: None
    lab.world.advance(0.5)
    _, ended = driven(lab, plan)
    assert ended == 1
    assert lab.notes.lines == ["no reading within 2 s: sensor/wrench missing; nothing was moved"]
    assert status_of(lab).state == "IDLE"
    assert lab.world.arm.q == pytest.approx(HOME_RAD, abs=1e-3)


def test_an_arm_in_use_by_another_client_is_not_moved():
    """Neither a hold nor force feedback is replaced by a calibration."""
    lab = CalibrationLab()
    plan = lab.plan(**FEW)
    lab.bus.ask(topics.HOLD, HoldRequest(reason="the visitor is inside"))
    lab.world.advance(0.2)
    _, ended = driven(lab, plan)
    assert ended == 3
    assert "the arbiter is HOLDING: the visitor is inside" in lab.notes.lines[-1]
    for request, message in (
        (topics.CLEAR, Empty()),
        (topics.TARE, Empty()),
        (topics.ARM, ArmRequest()),
        (topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=10.0)),
    ):
        assert lab.bus.ask(request, message).accepted
        lab.world.advance(0.2)
    _, ended = driven(lab, plan)
    assert ended == 3
    assert lab.notes.lines[-1] == "the regulator commands the arm: stop that first"
    assert status_of(lab).commander == "regulator"
