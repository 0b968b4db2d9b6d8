"""Manual calibration: the user moves the arm, the wizard records poses and recommends the next."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cli.calibration.finish import Job, conclude, keep_readings
from cli.calibration.gather import READINGS_POLL_S, Gatherer, ReadingLostError
from cli.calibration.installed import refuse_wrong_axes
from cli.calibration.screen import screen
from cli.calibration.tell import Teller
from cli.context import INTERRUPTED, NOT_WELL
from common.config.cell import CellConfig
from common.motion.frames import Array
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError, ForcemeshError
from identification.dwells import Dwell, Purpose, of_purpose, samples_of
from identification.errors import CalibrationError
from identification.evidence import evidence_of
from identification.excitation.pose_choice import conditioning
from identification.identify import identify
from identification.static_poses import LEAST_POSES, WORST_CONDITIONING, angle

NEW_RAD = np.radians(15.0)  # least distance to earlier attitudes for automatic capture
STILL_S = 1.0  # time at rest before automatic capture
LOOK_EVERY_NS = 50_000_000
ENOUGH = 6
KEYS = "Enter records a pose, u removes the last one, q continues"
HINT = "tilt the tool by 60 degrees or more from the earlier poses, each time about another axis"


class Keys(Protocol):
    """Source of typed lines."""

    def poll(self) -> str | None:
        """Return a typed line, None when there is none."""


@dataclass(frozen=True, slots=True)
class HandOptions:
    """Number of poses, duration of a dwell, and whether capture is automatic."""

    poses: int = 10
    verify_poses: int = 4
    dwell_s: float = 0.5
    auto: bool = False


class Watcher:
    """Recorder of poses to which the user moves the arm; it moves nothing itself."""

    def __init__(
        self, bus: Bus, cell: CellConfig, wish: HandOptions, *, keys: Keys, teller: Teller
    ) -> None:
        """Subscribe."""
        self.dwells: list[Dwell] = []
        self._clock, self._wish = bus.clock, wish
        self._keys, self._teller = keys, teller
        self._gatherer = Gatherer(bus, cell)
        self._wanted = False  # a pose was requested; it is recorded once everything is at rest
        self._still_since_ns: int | None = None

    @property
    def serial(self) -> str:
        """Serial number of the sensor, empty when it reports none."""
        return self._gatherer.serial

    def run(self) -> None:
        """Record poses to fit, then poses to verify. Raises CalibrationError without any."""
        self._gatherer.until_heard()
        self._teller.note(f"move the arm with the pendant or `forcemesh move`; {KEYS}")
        self._teller.note(f"next: {HINT}")
        self._take_poses("fit", self._wish.poses)
        if not of_purpose(self.dwells, "fit"):
            raise CalibrationError("no pose was recorded")
        if self._wish.verify_poses:
            self._teller.note(f"now {self._wish.verify_poses} fresh poses to verify; {KEYS}")
            self._take_poses("verify", self._wish.verify_poses)

    def _take_poses(self, purpose: Purpose, count: int) -> None:
        looked_ns = 0
        while len(self._taken(purpose)) < count:
            self._clock.sleep_s(READINGS_POLL_S)
            fault = self._look()
            if self._clock.now_ns() - looked_ns < LOOK_EVERY_NS:
                continue
            looked_ns = self._clock.now_ns()
            waits_for = fault or self._gatherer.stillness.complaint()
            self._note_stillness(waits_for)
            key = self._keys.poll()
            if key in {"q", "done"} and self._may_end(purpose):
                return
            if key == "u":
                self._undo(purpose)
            self._wanted |= key == ""
            self._show(purpose, count, waits_for)
            if not waits_for and (self._wanted or self._is_new()):
                self._take(purpose)

    def _taken(self, purpose: Purpose) -> list[Dwell]:
        return of_purpose(self.dwells, purpose)

    def _look(self) -> str:
        """Read the sensor; return its fault, empty when there is none."""
        try:
            self._gatherer.take()
        except ReadingLostError as error:
            return str(error)
        return ""

    def _note_stillness(self, waits_for: str) -> None:
        if waits_for:
            self._still_since_ns = None
        elif self._still_since_ns is None:
            self._still_since_ns = self._clock.now_ns()

    def _is_new(self) -> bool:
        """Return whether to capture this pose automatically: at rest, far from the others."""
        if not self._wish.auto or self._still_since_ns is None:
            return False
        if self._clock.now_ns() - self._still_since_ns < STILL_S * NS_PER_S:
            return False
        return bool(self._apart_rad() > NEW_RAD)

    def _apart_rad(self) -> float:
        here = self._gatherer.stillness.newest
        if here is None or not self.dwells:
            return np.inf
        return float(angle(here.R_base_sensor, _attitudes(self.dwells)).min())

    def _take(self, purpose: Purpose) -> None:
        self._wanted, self._still_since_ns = False, None
        try:
            dwell = self._gatherer.dwell(purpose, self._wish.dwell_s, lambda _what: None)
        except CalibrationError as error:
            self._teller.note(f"not recorded: {error}")
            return
        apart_deg = np.degrees(self._apart_rad())
        self.dwells.append(dwell)
        self._teller.note(f"pose {len(self._taken(purpose))} recorded{self._advice(purpose)}")
        if apart_deg < np.degrees(NEW_RAD):
            self._teller.note(
                f"it is only {apart_deg:.0f} degrees from an earlier one: u removes it"
            )

    def _undo(self, purpose: Purpose) -> None:
        if not self._taken(purpose):
            self._teller.note("there is no pose to remove")
            return
        self.dwells.pop()
        self._teller.note(f"removed: {len(self._taken(purpose))} poses remain")

    def _may_end(self, purpose: Purpose) -> bool:
        count = len(self._taken(purpose))
        if purpose == "verify" or count == 0:
            return True
        found = conditioning(_attitudes(self._taken("fit")))
        if count < LEAST_POSES or found > WORST_CONDITIONING:
            self._teller.note(
                f"{count} poses with condition number {found:.0f} do not determine a fit (at most "
                f"{WORST_CONDITIONING:.0f}, better {ENOUGH} poses or more): {HINT}"
            )
            return False
        return True

    def _advice(self, purpose: Purpose) -> str:
        """Return the conditioning of the poses so far and the recommended next pose."""
        taken = self._taken("fit")
        if purpose == "verify":
            return "; next: any new attitude"
        if len(taken) < LEAST_POSES:
            return f"; next: {HINT}"
        found = conditioning(_attitudes(taken))
        try:
            advised = identify(samples_of(taken)).next_pose
        except DataError as error:
            return f"; not enough yet: {error}"
        x, y, z = advised.down_in_sensor
        return (
            f", condition number {found:.1f}; next: gravity along ({x:.1f}, {y:.1f}, {z:.1f}) in "
            "sensor axes, as shown below"
        )

    def _show(self, purpose: Purpose, count: int, waits_for: str) -> None:
        here, taken = self._gatherer.stillness.newest, len(self._taken(purpose))
        if here is None:
            self._teller.progress(taken, count, waits_for)
            return
        x, y, z = -here.R_base_sensor[2, :]
        force_N = float(np.linalg.norm(here.reading[:3]))
        state = f"waiting for {waits_for}" if waits_for else "at rest"
        gravity = f"gravity ({x:.1f}, {y:.1f}, {z:.1f})"
        text = f"{taken} of {count} poses | {gravity} | {force_N:.1f} N | {state}"
        self._teller.progress(taken, count, text)


def _attitudes(dwells: list[Dwell]) -> Array:
    return np.array([dwell.attitude for dwell in dwells])


def watch(watcher: Watcher, teller: Teller) -> int | None:
    """Record poses; return the exit code when it ended early, else None."""
    try:
        watcher.run()
    except KeyboardInterrupt:
        teller.note("interrupted; the wizard moves nothing")
        return INTERRUPTED
    except ForcemeshError as error:
        teller.note(str(error))
        return NOT_WELL
    return None


def calibrate(job: Job, wish: HandOptions, bus: Bus, keys: Keys) -> int:
    """Record poses, save the readings, fit, verify, write, send. Returns the exit code."""
    with screen(with_time=False) as teller:
        watcher = Watcher(bus, job.cell, wish, keys=keys, teller=teller)
        ended = watch(watcher, teller)
    keep_readings(job, watcher.dwells)
    if ended is not None:
        return ended
    refuse_wrong_axes(job, watcher.dwells)
    evidence = evidence_of(
        "manual", watcher.dwells, source=job.places.readings, serial=watcher.serial
    )
    return conclude(job, evidence, bus)
