"""Calibration wizard in a whole virtual cell: a complete run, and every early end."""

from typing import Any

import numpy as np
import pytest

from cli.calibration.by_arm import drive
from cli.calibration.wizard import CalibrationWizard
from cli.context import INTERRUPTED
from common.config.load import load_cell
from common.config.payload import Payload
from common.motion.frames import R_from_quaternion
from common.motion.weight import predict
from forcemesh import topics
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest
from identification.dwells import dwells_of_purpose
from identification.evidence import evidence_of, findings_of
from identification.excitation.plan import CalibrationPlan
from identification.verification import VerificationBounds
from tests.fakes.bench import DEMO
from tests.fakes.calibration import HOME_RAD, QUICK, CalibrationLab, demo_cell

TRUTH = Payload(
    mass_kg=1.0,
    com_m=(0.012, -0.008, 0.055),
    bias_force_N=(1.5, -2.0, 3.0),
    bias_torque_Nm=(0.05, -0.04, 0.03),
)  # of the sim
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


def mean_residual(payload: Payload, count: int = 200) -> tuple[float, float]:
    """Return the mean error of a payload over random attitudes, from the simulated truth."""
    rng = np.random.default_rng(7)
    R = np.array([R_from_quaternion(q) for q in rng.normal(size=(count, 4))])
    apart = [
        found - true for found, true in zip(predict(payload, R), predict(TRUTH, R), strict=True)
    ]
    force, torque = (float(np.linalg.norm(error, axis=1).mean()) for error in apart)
    return force, torque


def test_a_complete_run_identifies_the_payload_and_returns_to_its_start(tmp_path):
    """Ten poses with sensor noise leave 0.02 N and 1 mN m; state and pose are the initial ones."""
    lab = CalibrationLab()
    wizard = lab.wizard(lab.plan(poses=10, verify_poses=2, dwell_s=0.5))
    wizard.run()

    evidence = evidence_of("arm", wizard.dwells, source=tmp_path / "a.csv")
    found = findings_of(lab.cell, evidence, VerificationBounds())
    force_N, torque_Nm = mean_residual(found.section.payload)
    assert force_N <= 0.02
    assert torque_Nm <= 0.001
    assert found.verdict.passed
    assert found.section.fit.poses == 10
    assert found.section.verified is not None
    assert found.section.verified.poses == 2
    assert found.report["rejected"] == []
    assert lab.world.arm.q == pytest.approx(HOME_RAD, abs=1e-3)
    assert status_of(lab).state == "IDLE"
    assert lab.notes.shares == sorted(lab.notes.shares)
    assert lab.notes.shares[-1] > 0.95
    assert lab.notes.lines == [
        "armed for jog: moves may begin, force feedback may not (lease 1)",
        "the arm has returned to its start",
    ]


@pytest.mark.long
def test_a_cell_that_was_armed_stays_armed():
    """The wizard keeps an existing arming; a payload of zeros is accepted."""
    lab = CalibrationLab(demo_cell(**QUICK, payload={"mass_kg": 0.0, "com_m": [0, 0, 0]}))
    assert lab.bus.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
    _, ended = driven(lab, lab.plan(**FEW))
    assert ended is None
    assert status_of(lab).state == "ARMED"


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


def test_contact_at_one_pose_is_left_out_of_the_fit(tmp_path):
    """A force of 2 N at one pose of eight: that pose is rejected, the others are valid."""
    lab = CalibrationLab()
    arm = lab.world.arm

    def push(force_N: float) -> None:
        arm.data.xfrc_applied[arm.model.body("tool").id][:3] = [force_N, 0.0, force_N]

    lab.notes.at("pose 4 of 8: waiting", lambda: push(2.0))
    lab.notes.at("pose 5 of 8: moving", lambda: push(0.0))
    wizard, ended = driven(lab, lab.plan(poses=8, verify_poses=1))
    assert ended is None
    evidence = evidence_of("arm", wizard.dwells, source=tmp_path / "a.csv")
    found = findings_of(lab.cell, evidence, VerificationBounds())
    assert [rows["reason"] for rows in found.report["rejected"]] == ["in contact, or touched"]
    assert found.section.fit.poses == 7
    assert found.verdict.passed


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


@pytest.mark.long
def test_a_pose_that_the_controller_refuses_is_replaced():
    """Over the gateway: the controller's joint limit is narrower than that of the cell file."""
    cell = load_cell(DEMO.with_name("demo-tcp.yaml"))
    lab = CalibrationLab(cell)
    lab.world.advance(0.8)  # the gateway greets the controller first
    plan = lab.plan(**FEW, speed_m_s=0.25)
    farthest = max(plan.fit, key=lambda place: abs(plan.q[place][5]))
    arm = lab.world.arm.kinematics
    arm.lower_rad[5], arm.upper_rad[5] = np.array([-1.0, 1.0]) * (abs(plan.q[farthest][5]) - 1e-3)
    wizard, ended = driven(lab, plan)
    assert ended is None, lab.notes.lines
    assert len(dwells_of_purpose(wizard.dwells, "fit")) == 6
    assert farthest in wizard.plan.refused
    assert any("the controller refused the target" in line for line in lab.notes.lines)
