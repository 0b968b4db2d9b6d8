"""Calibration by the arm itself: check the model, plan, ask, drive; and verification alone."""

import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import FrameType

import numpy as np
import typer

from cli.calibration.contact import refuse_loaded_tool
from cli.calibration.drive import Drive
from cli.calibration.finish import Job, conclude, keep_readings
from cli.calibration.installed import refuse_wrong_axes
from cli.calibration.screen import screen
from cli.calibration.tell import Teller
from cli.calibration.wizard import BOTH, Pace, Wizard, expected_s
from cli.context import INTERRUPTED, NOT_WELL, OK, answers_yes, exit_code_of
from cli.doctor.pose import Frames, check_pose, model_of
from common.config.cell import Cell
from common.motion.convert import pose_of
from common.motion.kinematics import ArmKinematics
from forcemesh.bus import Bus
from forcemesh.errors import ForcemeshError
from forcemesh.messages import RobotState
from identification.errors import CalibrationError, InContactError, NotBegunError, StoppedError
from identification.evidence import Evidence, evidence_of
from identification.excitation.plan import Options, Plan, make_plan, spread_deg
from identification.verification import judge, left_in_use
from services.gateway.scales import Scales
from services.gateway.service import scales_of

BY_HAND = "calibrate with --manual, which needs no model of the arm"


@dataclass(frozen=True, slots=True)
class Wish:
    """How the arm is to go, and whether the person has said yes already."""

    options: Options
    pace: Pace
    yes: bool = False
    free: bool = False  # the tool hangs free, whatever force is shown


def calibrate(job: Job, wish: Wish, bus: Bus) -> int:
    """Plan, ask, drive, fit, verify, write, put into use, come back. Returns the exit code."""
    if not wish.free:
        refuse_loaded_tool(bus, job.cell)
    plan = planned(job.cell, bus, wish)
    ask_person(explained(job.cell, plan, wish.pace), yes=wish.yes)
    with screen() as teller:
        wizard, ended = measure(job.cell, bus, plan, wish.pace, teller=teller)
    return finish(job, wizard, ended, lambda: conclude(job, evidence(job, wizard), bus))


def evidence(job: Job, wizard: Wizard) -> Evidence:
    """Return what the wizard has recorded, and its fit. Raises ForcemeshError when it is bad."""
    refuse_wrong_axes(job, wizard.dwells)
    count = len(wizard.plan.refused)
    skipped = (f"{count} poses were refused by the arm and others taken",) if count else ()
    return evidence_of(
        "arm",
        wizard.dwells,
        source=job.places.readings,
        serial=wizard.serial,
        notes=(*wizard.plan.warnings, *skipped),
    )


def finish(
    job: Job,
    wizard: Wizard,
    ended: int | None,
    conclusion: Callable[[], int],
    *,
    tellers: Callable[[], AbstractContextManager[Teller]] = screen,
) -> int:
    """Keep the readings, conclude while the tool is free, then come back. Returns the exit code.

    The cell judges a calibration by the force that it sees: at the last pose nothing is touched,
    whatever is where the arm began. However the conclusion ends, the arm comes back.
    """
    keep_readings(job, wizard.dwells)
    if ended is not None:
        return ended
    failure: ForcemeshError | None = None
    code = NOT_WELL
    try:
        with _ended_like_ctrl_c():
            code = conclusion()
    except KeyboardInterrupt:
        with tellers() as teller:
            return _interrupted(wizard, teller)
    except ForcemeshError as error:
        failure = error
    with tellers() as teller:
        wizard.teller = teller
        ended = _guarded(wizard, wizard.come_back)
    if failure is not None:
        raise failure
    return code if ended is None else ended


def verify(job: Job, wish: Wish, bus: Bus) -> int:
    """Drive to fresh poses and judge what the running cell leaves there. Returns the exit code."""
    plan = planned(job.cell, bus, wish)
    ask_person(explained(job.cell, plan, wish.pace, fitting=False), yes=wish.yes)
    with screen() as teller:
        wizard, ended = drive(job.cell, bus, plan, wish.pace, teller=teller, fitting=False)
    if ended is not None:
        return ended
    verdict = judge(left_in_use(wizard.dwells), job.bounds)
    typer.echo(f"calibration in use: {wizard.in_use or 'not said'}")
    typer.echo(verdict.text)
    return OK if verdict.passed else NOT_WELL


def planned(cell: Cell, bus: Bus, wish: Wish) -> Plan:
    """Return the plan from where the arm is now. Raises CalibrationError with what to do."""
    arm = Drive(bus, wish.pace.speed_m_s)
    arm.refuse_unless_free()
    state = arm.at_rest()
    return make_plan(cell, _model(cell, state), np.array(state.joint_rad), wish.options)


def _model(cell: Cell, state: RobotState) -> ArmKinematics:
    """Return the model of the arm, when the arm agrees with it."""
    arm = model_of(cell.robot.joint_min_deg, cell.robot.joint_max_deg)
    if arm is None:
        text = (
            "the joint limits of the cell file are not those of the RS007L, the arm that is known"
        )
        raise CalibrationError(f"{text}: {BY_HAND}")
    section = cell.gateway if cell.roles.robot == "gateway" else None
    line = check_pose(
        pose_of(state),
        np.array(state.joint_rad),
        scales=Scales() if section is None else scales_of(section),
        frames=Frames(cell.tool.T_flange_tcp.pose, cell.sensor.T_flange_sensor.pose),
        arm=arm,
    )
    if line.word == "FAIL":
        text = f"the pose that the arm reports does not agree with its joints: {line.found}"
        raise CalibrationError(f"{text}; {line.remedy}; or {BY_HAND}")
    return arm


def explained(cell: Cell, plan: Plan, pace: Pace, *, fitting: bool = True) -> str:
    """Return what a person must know before the arm moves."""
    low, high = (
        [1e3 * v for v in corner]
        for corner in (cell.limits.workspace_min_m, cell.limits.workspace_max_m)
    )
    box = ", ".join(
        f"{axis} {a:.0f} .. {b:.0f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    floor_mm = 1e3 * plan.route.near_start.floor_m
    walls = f" and {len(cell.limits.planes)} plane(s)" if cell.limits.planes else ""
    count = f"{len(plan.fit)} poses and {len(plan.verify)} to verify" if fitting else ""
    count = count or f"{len(plan.verify)} poses"
    seconds = expected_s(plan, pace, BOTH if fitting else ("verify",))
    lines = [*plan.warnings]
    lines.append(
        f"{count}, about {seconds:.0f} s at {1e3 * pace.speed_m_s:.0f} mm/s; gravity turns by "
        f"{spread_deg(plan):.0f} degrees in the sensor, expected condition number "
        f"{plan.conditioning:.1f}"
    )
    lines.append(
        f"flange, sensor and TCP stay inside the box {box} mm (base axes){walls}, and above "
        f"z = {floor_mm:.0f} mm; the arm goes up first and comes back to where it is now"
    )
    lines.append(
        "nothing else is known: look that the box is free of things and people, that arm, tool and "
        "cables may turn there, that the tool hangs free, and keep a hand at the emergency stop"
    )
    return "\n".join(lines)


def ask_person(explanation: str, *, yes: bool) -> None:
    """Say what is going to move, and ask. Raises CalibrationError without a yes."""
    typer.echo(explanation, err=True)
    if not yes and not answers_yes("is the box free, and may the arm move?"):
        raise CalibrationError("nothing was moved")


def measure(
    cell: Cell, bus: Bus, plan: Plan, pace: Pace, *, teller: Teller
) -> tuple[Wizard, int | None]:
    """Visit every pose and stay at the last; the exit code comes with it when it ended early."""
    wizard = Wizard(bus, cell, plan, pace=pace, teller=teller)
    return wizard, _guarded(wizard, wizard.measure)


def drive(
    cell: Cell, bus: Bus, plan: Plan, pace: Pace, *, teller: Teller, fitting: bool = True
) -> tuple[Wizard, int | None]:
    """Visit every pose and come back; the exit code comes with it when it ended early."""
    wizard = Wizard(bus, cell, plan, pace=pace, teller=teller)
    return wizard, _guarded(wizard, lambda: wizard.run(BOTH if fitting else ("verify",)))


def _guarded(wizard: Wizard, action: Callable[[], None]) -> int | None:
    """Do it; Ctrl-C and every error end in a hold, and what was recorded is kept."""
    try:
        with _ended_like_ctrl_c():
            action()
    except KeyboardInterrupt:
        return _interrupted(wizard, wizard.teller)
    except (StoppedError, InContactError, NotBegunError) as error:
        wizard.teller.note(str(error))
        return exit_code_of(error)
    except ForcemeshError as error:
        wizard.teller.note(f"{error}; {wizard.abandon('the calibration failed')}")
        return exit_code_of(error)
    return None


def _interrupted(wizard: Wizard, teller: Teller) -> int:
    with _deaf():
        teller.note(f"interrupted: {wizard.abandon('the calibration was interrupted')}")
    return INTERRUPTED


@contextmanager
def _ended_like_ctrl_c() -> Iterator[None]:
    """Let a closed terminal, and a process that is told to end, stop the arm as Ctrl-C does."""

    def interrupt(_signal: int, _frame: FrameType | None) -> None:
        """Do as Ctrl-C does."""
        raise KeyboardInterrupt

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _deaf() -> Iterator[None]:
    """Let no second Ctrl-C get between a person and the hold that the first one asked for."""

    def nothing(_signal: int, _frame: FrameType | None) -> None:
        """Ignore it."""

    before = signal.signal(signal.SIGINT, nothing)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
