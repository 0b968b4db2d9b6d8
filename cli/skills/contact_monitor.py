"""Contact monitor: measured force and pose during force feedback, and the end of a skill."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cli.terminal import ignore_sigint
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import pose_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.client.ask import stopped_error
from forcemesh.clock import NS_PER_S, wait_until
from forcemesh.errors import ArmStoppedError, ForcemeshError, LostError, NotReachedError

CONTACT_POLL_S = 0.001
CONTACT_SILENCE_S = 1.0
STARTED_WITHIN_S = 0.5  # by then the regulator must report the requested mode

ReportProgress = Callable[[float, float, str], None]  # completed, total, description


@dataclass(frozen=True, slots=True)
class ContactSample:
    """Wrench at the TCP with the pose measured at that time."""

    t_s: float  # since the monitor was created
    press_N: float  # along the tool's axis, positive: the tool presses
    force_N: Array  # of the environment on the tool, base axes
    torque_Nm: Array  # about the TCP
    T_base_tcp: pin.SE3  # measured
    contact: str
    path_left_m: float | None  # remaining path
    path_missed_m: float | None


class ContactMonitor:
    """Monitor of the contact force and TCP pose of a cell."""

    def __init__(self, cell: ConfiguredCell, progress: ReportProgress) -> None:
        """Subscribe; `progress` receives the progress of `until`."""
        self._cell, self._clock = cell, cell.session.clock
        self.progress = progress
        self._T_flange_tcp = cell.config.tool.T_flange_tcp.pose
        self._wrench = cell.session.bus.reader(topics.WRENCH)
        self._start_ns = self._clock.now_ns()

    @property
    def t_s(self) -> float:
        """Time since creation [s]."""
        return (self._clock.now_ns() - self._start_ns) / NS_PER_S

    def tcp_pose(self) -> pin.SE3:
        """Return the pose of the TCP in base. Raises LostError, NotValidError."""
        return pose_of(self._cell.state()) * self._T_flange_tcp

    def next(self) -> ContactSample:
        """Wait for the next wrench.

        Raises:
            ArmStoppedError: The arm was stopped.
            NotReachedError: Force feedback was stopped by another client.
            LostError, NotValidError: A publisher is silent, or its message is not valid.
        """
        is_received = wait_until(
            self._clock, self._wrench.poll, within_s=CONTACT_SILENCE_S, poll_s=CONTACT_POLL_S
        )
        self._raise_when_stopped()  # a silent publisher has stopped the arm before
        if not is_received:
            raise LostError(
                f"no message on {topics.WRENCH.key} for {CONTACT_SILENCE_S:g} s", ("wrench",)
            )
        target = self._cell.target.reading().message
        if target is not None and target.mode is None and self.t_s > STARTED_WITHIN_S:
            raise NotReachedError(f"force feedback ended: {target.reason}")
        return self.now()

    def now(self) -> ContactSample:
        """Return the newest wrench. Raises LostError and NotValidError as `next`."""
        target = self._cell.target.reading().message
        wrench = self._wrench.read(self._clock.now_ns()).fresh or self._cell.wrench()
        T, force_N = self.tcp_pose(), np.array(wrench.force_N)
        return ContactSample(
            t_s=self.t_s,
            press_N=-float(force_N @ T.rotation[:, 2]),
            force_N=force_N,
            torque_Nm=np.array(wrench.torque_Nm),
            T_base_tcp=T,
            contact="free" if target is None else target.contact,
            path_left_m=None if target is None else target.path_left_m,
            path_missed_m=None if target is None else target.path_missed_m,
        )

    def peak_N(self, duration_s: float) -> float:
        """Return the largest press force during a period [N], also without force feedback.

        Raises ArmStoppedError when the arm was stopped in it, else as `now`.
        """
        end_s, largest_N = self.t_s + duration_s, -np.inf
        while self.t_s < end_s:
            largest_N = max(largest_N, self.now().press_N)
            self._raise_when_stopped()
            self._clock.sleep_s(CONTACT_POLL_S)
        return float(largest_N)

    def _raise_when_stopped(self) -> None:
        status = self._cell.status()
        if not status.operational:
            raise stopped_error(status, "the arm was stopped")

    def until(
        self, done: Callable[[ContactSample], bool], *, within_s: float, label: str
    ) -> list[ContactSample]:
        """Return all samples until a condition holds. Raises as `next`, and after the timeout."""
        samples: list[ContactSample] = []
        end_s = self.t_s + within_s
        while True:
            samples.append(self.next())
            self.progress(samples[-1].t_s, end_s, f"{label}: {samples[-1].press_N:.1f} N")
            if done(samples[-1]):
                return samples
            if samples[-1].t_s > end_s:
                raise NotReachedError(f"{label}: target not reached within {within_s:g} s")


class Debounce:
    """Debounce: true when a condition has held without a break for a given time."""

    def __init__(self, condition: Callable[[ContactSample], bool], steady_s: float) -> None:
        """Start without samples."""
        self._condition, self._steady_s = condition, steady_s
        self.since_s: float | None = None

    def __call__(self, sample: ContactSample) -> bool:
        """Evaluate one more sample."""
        if not self._condition(sample):
            self.since_s = None
            return False
        self.since_s = sample.t_s if self.since_s is None else self.since_s
        return sample.t_s - self.since_s >= self._steady_s


@contextmanager
def stop_force_at_end(cell: ConfiguredCell) -> Iterator[None]:
    """Stop force feedback at the end; hold the arm after an interruption or an unexpected error.

    No request is sent when the arm has already been stopped.
    """
    try:
        yield
    except ArmStoppedError:
        raise
    except ForcemeshError:
        with suppress(ForcemeshError):
            cell.force.stop()
        raise
    except BaseException:
        with ignore_sigint(), suppress(ForcemeshError):
            cell.hold("a skill was interrupted")
        raise
    cell.force.stop()


def no_progress(_done: float, _total: float, _text: str) -> None:
    """Discard the progress."""
