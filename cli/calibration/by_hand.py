"""Manual calibration: the user moves the arm, the wizard records poses and recommends the next."""

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot

import numpy as np

from cli.calibration.finish import Job, conclude, refuse_wrong_axes, save_readings
from cli.calibration.gather import READINGS_POLL_S, Gatherer, ReadingLostError
from cli.context import INTERRUPTED, NOT_WELL
from cli.terminal import ProgressOutput, screen
from common.bus.configured_cell import ConfiguredCell
from common.motion.frames import Array
from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError, ForcemeshError
from identification.dwells import Dwell, Purpose, dwells_of_purpose, samples_of
from identification.errors import CalibrationError
from identification.evidence import evidence_of
from identification.identify import identify_payload
from identification.payload_fit import conditioning
from identification.static_poses import LEAST_POSES, WORST_CONDITIONING, angle

NEW_RAD = np.radians(15.0)  # least distance to earlier attitudes for automatic capture
STILL_S = 1.0  # time at rest before automatic capture
CHECK_EVERY_NS = 50_000_000
ADVISED_POSES = 6
KEYS = "Enter records a pose, u removes the last one, q continues"
HINT = "tilt the tool by 60 degrees or more from the earlier poses, each time about another axis"


TypedLine = Callable[[], str | None]  # returns a typed line, None when there is none


@dataclass(frozen=True, slots=True)
class HandOptions:
    """Number of poses, duration of a dwell, and whether capture is automatic."""

    poses: int = 10
    verify_poses: int = 4
    dwell_s: float = 0.5
    auto: bool = False


class PoseRecorder:
    """Recorder of poses to which the user moves the arm; it moves nothing itself."""

    def __init__(
        self,
        cell: ConfiguredCell,
        options: HandOptions,
        *,
        typed_line: TypedLine,
        output: ProgressOutput,
    ) -> None:
        """Subscribe."""
        self.dwells: list[Dwell] = []
        self._clock, self._options = cell.session.clock, options
        self._typed_line, self._output = typed_line, output
        self.gatherer = Gatherer(cell)
        self._down = cell.config.gravity_direction_in_base
        self._requested = False  # a pose was requested; it is recorded once everything is at rest
        self._still_since_ns: int | None = None

    def run(self) -> None:
        """Record poses to fit, then poses to verify. Raises CalibrationError without any."""
        self.gatherer.until_received()
        self._output.note(f"move the arm with the pendant or `forcemesh move`; {KEYS}")
        self._output.note(f"next: {HINT}")
        self._record_poses("fit", self._options.poses)
        if not dwells_of_purpose(self.dwells, "fit"):
            raise CalibrationError("no pose was recorded")
        if self._options.verify_poses:
            self._output.note(f"now {self._options.verify_poses} fresh poses to verify; {KEYS}")
            self._record_poses("verify", self._options.verify_poses)

    def _record_poses(self, purpose: Purpose, count: int) -> None:
        checked_ns = 0
        while len(dwells_of_purpose(self.dwells, purpose)) < count:
            self._clock.sleep_s(READINGS_POLL_S)
            fault = ""
            try:
                self.gatherer.take()
            except ReadingLostError as error:
                fault = str(error)
            if self._clock.now_ns() - checked_ns < CHECK_EVERY_NS:
                continue
            checked_ns = self._clock.now_ns()
            waits_for = fault or self.gatherer.stillness.pending_condition()
            if waits_for:
                self._still_since_ns = None
            elif self._still_since_ns is None:
                self._still_since_ns = checked_ns
            key = self._typed_line()
            if key in {"q", "done"} and self._may_end(purpose):
                return
            if key == "u":
                self._remove_last_pose(purpose)
            self._requested |= key == ""
            self._show_progress(purpose, count, waits_for)
            if not waits_for and (self._requested or self._is_new_attitude()):
                self._record_pose(purpose)

    def _is_new_attitude(self) -> bool:
        """Return whether to capture this pose automatically: at rest, far from the others."""
        if not self._options.auto or self._still_since_ns is None:
            return False
        if self._clock.now_ns() - self._still_since_ns < STILL_S * NS_PER_S:
            return False
        return bool(self._nearest_rad() > NEW_RAD)

    def _nearest_rad(self) -> float:
        newest = self.gatherer.stillness.newest
        if newest is None or not self.dwells:
            return np.inf
        return float(angle(newest.R_base_sensor, _attitudes(self.dwells)).min())

    def _record_pose(self, purpose: Purpose) -> None:
        self._requested, self._still_since_ns = False, None
        try:
            dwell = self.gatherer.dwell(purpose, self._options.dwell_s, lambda _text: None)
        except CalibrationError as error:
            self._output.note(f"not recorded: {error}")
            return
        nearest_deg = np.degrees(self._nearest_rad())
        self.dwells.append(dwell)
        self._output.note(
            f"pose {len(dwells_of_purpose(self.dwells, purpose))} recorded{self._advice(purpose)}"
        )
        if nearest_deg < np.degrees(NEW_RAD):
            self._output.note(
                f"it is only {nearest_deg:.0f} degrees from an earlier one: u removes it"
            )

    def _remove_last_pose(self, purpose: Purpose) -> None:
        if not dwells_of_purpose(self.dwells, purpose):
            self._output.note("there is no pose to remove")
            return
        self.dwells.pop()
        self._output.note(f"removed: {len(dwells_of_purpose(self.dwells, purpose))} poses remain")

    def _may_end(self, purpose: Purpose) -> bool:
        count = len(dwells_of_purpose(self.dwells, purpose))
        if purpose == "verify" or count == 0:
            return True
        found = self._conditioning()
        if count < LEAST_POSES or found > WORST_CONDITIONING:
            self._output.note(
                f"{count} poses with condition number {found:.0f} do not determine a fit (at most "
                f"{WORST_CONDITIONING:.0f}, better {ADVISED_POSES} poses or more): {HINT}"
            )
            return False
        return True

    def _advice(self, purpose: Purpose) -> str:
        """Return the conditioning of the poses so far and the recommended next pose."""
        if purpose == "verify":
            return "; next: any new attitude"
        recorded = dwells_of_purpose(self.dwells, "fit")
        if len(recorded) < LEAST_POSES:
            return f"; next: {HINT}"
        try:
            x, y, z = identify_payload(samples_of(recorded), self._down).next_pose.down_in_sensor
        except DataError as error:
            return f"; no fit yet: {error}"
        return (
            f", condition number {self._conditioning():.1f}; next: gravity along "
            f"({x:.1f}, {y:.1f}, {z:.1f}) in sensor axes, as shown below"
        )

    def _show_progress(self, purpose: Purpose, count: int, waits_for: str) -> None:
        newest = self.gatherer.stillness.newest
        recorded = len(dwells_of_purpose(self.dwells, purpose))
        if newest is None:
            self._output.progress(recorded, count, waits_for)
            return
        x, y, z = self._down @ newest.R_base_sensor
        force_N = hypot(*newest.reading[:3])
        state = f"waiting for {waits_for}" if waits_for else "at rest"
        gravity = f"gravity ({x:.1f}, {y:.1f}, {z:.1f})"
        text = f"{recorded} of {count} poses | {gravity} | {force_N:.1f} N | {state}"
        self._output.progress(recorded, count, text)

    def _conditioning(self) -> float:
        """Return the condition number of the poses so far."""
        R = _attitudes(dwells_of_purpose(self.dwells, "fit"))
        return conditioning(R, np.array(self._down))


def _attitudes(dwells: list[Dwell]) -> Array:
    return np.array([dwell.attitude for dwell in dwells])


def calibrate(job: Job, options: HandOptions, typed_line: TypedLine, cell: ConfiguredCell) -> int:
    """Record poses, save the readings, fit, verify, write, send. Returns the exit code."""
    with screen(with_time=False) as output:
        recorder = PoseRecorder(cell, options, typed_line=typed_line, output=output)
        ended = record_poses(recorder, output)
    save_readings(job, recorder.dwells)
    if ended is not None:
        return ended
    installation = refuse_wrong_axes(job, recorder.dwells)
    evidence = evidence_of(
        "manual",
        recorder.dwells,
        source=job.files.readings,
        down_in_base=job.cell.gravity_direction_in_base,
        serial=recorder.gatherer.serial,
        installation=installation,
    )
    return conclude(job, evidence, cell)


def record_poses(recorder: PoseRecorder, output: ProgressOutput) -> int | None:
    """Record poses; return the exit code when it ended early, else None."""
    try:
        recorder.run()
    except KeyboardInterrupt:
        output.note("interrupted; the wizard moves nothing")
        return INTERRUPTED
    except ForcemeshError as error:
        output.note(str(error))
        return NOT_WELL
    return None
