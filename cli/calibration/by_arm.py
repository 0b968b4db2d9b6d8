"""Automatic calibration: check the arm model, plan, confirm, move; or verification only."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from typer import echo

from cli.calibration.drive import Drive, refuse_loaded_tool
from cli.calibration.finish import Job, conclude, refuse_wrong_axes, save_readings
from cli.calibration.wizard import BOTH, CalibrationWizard, expected_s
from cli.context import INTERRUPTED, NOT_WELL, OK, answers_yes, exit_code_of, print_note
from cli.doctor.pose import check_pose
from cli.terminal import ProgressOutput, ignore_sigint, interrupt_on_signals, screen
from common.bus.configured_cell import ConfiguredCell
from common.config.arm import UNKNOWN_ARM
from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.kinematics import ArmKinematics
from forcemesh.errors import ArmStoppedError, ForcemeshError
from forcemesh.messages import RobotState
from identification.dwells import Purpose
from identification.errors import CalibrationError, InContactError, NotBegunError
from identification.evidence import Evidence, evidence_of
from identification.excitation.plan import CalibrationPlan, PlanOptions, make_plan, spread_deg
from identification.verification import active_residual, judge_residual

MANUAL_REMEDY = "calibrate with --manual, which needs no arm model"


@dataclass(frozen=True, slots=True)
class ArmOptions:
    """Options of an automatic calibration, and whether motion is confirmed already."""

    plan: PlanOptions
    yes: bool = False
    free: bool = False  # the tool is in free space, whatever force is measured


def calibrate(job: Job, options: ArmOptions, cell: ConfiguredCell) -> int:
    """Plan, confirm, move, fit, verify, write, put into use, return. Returns the exit code."""
    if not options.free:
        refuse_loaded_tool(cell)
    wizard, ended = confirm_and_drive(cell, options, returns=False)
    return finish(job, wizard, ended, lambda: conclude(job, evidence(job, wizard), cell))


def evidence(job: Job, wizard: CalibrationWizard) -> Evidence:
    """Return the wizard's readings and their fit. Raises ForcemeshError when they are invalid."""
    installation = refuse_wrong_axes(job, wizard.dwells)
    count = len(wizard.plan.refused)
    skipped = (f"{count} poses were refused by the arm and replaced",) if count else ()
    return evidence_of(
        "arm",
        wizard.dwells,
        source=job.files.readings,
        down_in_base=job.cell.gravity_direction_in_base,
        serial=wizard.gatherer.serial,
        notes=(*wizard.plan.warnings, *skipped),
        installation=installation,
    )


def finish(
    job: Job,
    wizard: CalibrationWizard,
    ended: int | None,
    conclusion: Callable[[], int],
    *,
    open_output: Callable[[], AbstractContextManager[ProgressOutput]] = screen,
) -> int:
    """Save the readings, conclude in free space, then return. Returns the exit code.

    The cell checks a new calibration by the measured force: the last pose is in free space, the
    start may not be. The arm returns whatever the result.
    """
    save_readings(job, wizard.dwells)
    if ended is not None:
        return ended
    failure: ForcemeshError | None = None
    code = NOT_WELL
    try:
        with interrupt_on_signals():
            code = conclusion()
    except KeyboardInterrupt:
        with open_output() as output:
            return _report_interruption(wizard, output)
    except ForcemeshError as error:
        failure = error
    with open_output() as output:
        wizard.output = output
        ended = _run_guarded(wizard, wizard.return_to_start)
    if failure is not None:
        raise failure
    return code if ended is None else ended


def verify(job: Job, options: ArmOptions, cell: ConfiguredCell) -> int:
    """Visit fresh poses and judge the running cell's residuals. Returns the exit code."""
    wizard, ended = confirm_and_drive(cell, options, purposes=("verify",))
    if ended is not None:
        return ended
    verdict = judge_residual(active_residual(wizard.dwells), job.bounds)
    echo(f"calibration in use: {wizard.gatherer.active_calibration or 'not reported'}")
    echo(verdict.text)
    return OK if verdict.passed else NOT_WELL


def calibration_plan(cell: ConfiguredCell, options: ArmOptions) -> CalibrationPlan:
    """Return the plan from the present pose. Raises CalibrationError with the remedy."""
    arm = Drive(cell, options.plan.speed_m_s)
    arm.refuse_unless_free()
    state, config = arm.at_rest(), cell.config
    return make_plan(config, _model(config, state), np.array(state.joint_rad), options.plan)


def _model(cell: CellConfig, state: RobotState) -> ArmKinematics:
    """Return the arm model. Raises CalibrationError when the arm does not agree with it."""
    if cell.robot.model == UNKNOWN_ARM:
        text = f"robot.model is {UNKNOWN_ARM}, an arm without a model"
        raise CalibrationError(f"{text}: {MANUAL_REMEDY}")
    arm = ArmKinematics(cell.robot.model)
    line = check_pose(cell, pose_of(state), state.joint_rad, arm)
    if line.result == "FAIL":
        text = f"the pose that the arm reports does not agree with its joints: {line.found}"
        raise CalibrationError(f"{text}; {line.remedy}; or {MANUAL_REMEDY}")
    return arm


def motion_description(
    cell: CellConfig, plan: CalibrationPlan, purposes: tuple[Purpose, ...] = BOTH
) -> str:
    """Return the description of the motion, for confirmation."""
    low, high = (
        [1e3 * v for v in corner]
        for corner in (cell.limits.workspace_min_m, cell.limits.workspace_max_m)
    )
    box = ", ".join(
        f"{axis} {a:.0f} .. {b:.0f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    floor_mm = 1e3 * plan.route.near_start.floor_m
    walls = f" and {len(cell.limits.planes)} plane(s)" if cell.limits.planes else ""
    count = f"{len(plan.verify)} poses"
    if purposes == BOTH:
        count = f"{len(plan.fit)} poses and {len(plan.verify)} to verify"
    seconds = expected_s(plan, purposes)
    lines = [*plan.warnings]
    lines.append(
        f"{count}, about {seconds:.0f} s at {1e3 * plan.options.speed_m_s:.0f} mm/s; gravity "
        f"varies by {spread_deg(plan):.0f} degrees in sensor axes, expected condition number "
        f"{plan.conditioning:.1f}"
    )
    lines.append(
        f"flange, sensor and TCP stay inside the box {box} mm (base axes){walls}, and above "
        f"z = {floor_mm:.0f} mm; the arm moves up first and returns to its present pose"
    )
    lines.append(
        "other obstacles are unknown: check that the box is free of objects and people, that arm, "
        "tool and cables can turn there, that the tool is in free space, and keep a hand at the "
        "emergency stop"
    )
    return "\n".join(lines)


def confirm_and_drive(
    cell: ConfiguredCell,
    options: ArmOptions,
    *,
    question: str = "is the box free, and may the arm move?",
    purposes: tuple[Purpose, ...] = BOTH,
    returns: bool = True,
) -> tuple[CalibrationWizard, int | None]:
    """Plan, print the motion, ask for confirmation, then `drive`.

    Raises CalibrationError when the motion is not confirmed.
    """
    plan = calibration_plan(cell, options)
    print_note(motion_description(cell.config, plan, purposes))
    if not options.yes and not answers_yes(question):
        raise CalibrationError("nothing was moved")
    with screen() as output:
        return drive(cell, plan, output, purposes=purposes, returns=returns)


def drive(
    cell: ConfiguredCell,
    plan: CalibrationPlan,
    output: ProgressOutput,
    *,
    purposes: tuple[Purpose, ...] = BOTH,
    returns: bool = True,
) -> tuple[CalibrationWizard, int | None]:
    """Visit every pose, and return if so requested; return the exit code too if it ended early."""
    wizard = CalibrationWizard(cell, plan, output)
    action = wizard.run if returns else wizard.measure
    return wizard, _run_guarded(wizard, lambda: action(purposes))


def _run_guarded(wizard: CalibrationWizard, action: Callable[[], None]) -> int | None:
    """Execute an action; Ctrl-C and every error end in a hold, the readings are kept."""
    try:
        with interrupt_on_signals():
            action()
    except KeyboardInterrupt:
        return _report_interruption(wizard, wizard.output)
    except (ArmStoppedError, InContactError, NotBegunError) as error:
        wizard.output.note(str(error))
        return exit_code_of(error)
    except ForcemeshError as error:
        wizard.output.note(f"{error}; {wizard.abandon('the calibration failed')}")
        return exit_code_of(error)
    return None


def _report_interruption(wizard: CalibrationWizard, output: ProgressOutput) -> int:
    with ignore_sigint():
        output.note(f"interrupted: {wizard.abandon('the calibration was interrupted')}")
    return INTERRUPTED
