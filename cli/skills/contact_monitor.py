"""What the tool feels while force feedback works, sample by sample, and how a skill ends."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

import numpy as np
import pinocchio as pin

from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import pose_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.client.ask import stopped
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ArmStoppedError, ForcemeshError, LostError, NotReachedError
from forcemesh.messages import RegulatorTarget

POLL_S = 0.001
SILENCE_S = 1.0
STARTED_WITHIN_S = 0.5  # so long the regulator may take to name the mode that was asked for

Tell = Callable[[float, float, str], None]  # done, of so much, what is going on


@dataclass(frozen=True, slots=True)
class Felt:
    """One wrench, and where the tool was."""

    t_s: float  # since the feeler was made
    press_N: float  # along the tool's axis, positive: the tool presses
    force_N: Array  # of the environment on the tool, base axes
    torque_Nm: Array  # about the TCP
    T_base_tcp: pin.SE3  # measured
    contact: str
    left_m: float | None  # of the path


class Feeler:
    """Feels with the tool of a cell from now on."""

    def __init__(self, cell: ConfiguredCell) -> None:
        """Subscribe."""
        self._cell, self._clock = cell, cell.session.clock
        self._T_flange_tcp = cell.config.tool.T_flange_tcp.pose
        self._wrench = cell.session.bus.reader(topics.WRENCH)
        self._start_ns = self._clock.now_ns()

    @property
    def t_s(self) -> float:
        """Time since it was made [s]."""
        return (self._clock.now_ns() - self._start_ns) / NS_PER_S

    def here(self) -> pin.SE3:
        """Return where the TCP is, in base. Raises LostError, NotValidError."""
        return pose_of(self._cell.state()) * self._T_flange_tcp

    def next(self) -> Felt:
        """Wait for the next wrench.

        Raises:
            ArmStoppedError: The arm was stopped.
            NotReachedError: Force feedback was stopped by somebody else.
            LostError, NotValidError: Who should say it says nothing, or nothing good.
        """
        give_up_s = self.t_s + SILENCE_S
        while not self._wrench.poll():
            if self.t_s > give_up_s:
                self._raise_when_stopped()  # whoever is silent has stopped the arm long before
                raise LostError(f"nothing on {topics.WRENCH.key} for {SILENCE_S:g} s", ("wrench",))
            self._clock.sleep_s(POLL_S)
        self._raise_when_stopped()
        target = self._cell.target.reading().message
        if target is not None and target.mode is None and self.t_s > STARTED_WITHIN_S:
            raise NotReachedError(f"force feedback ended: {target.reason}")
        return self.now()

    def now(self) -> Felt:
        """Return the newest wrench. Raises LostError and NotValidError as `next`."""
        target = self._cell.target.reading().message
        wrench = self._wrench.read(self._clock.now_ns()).fresh or self._cell.wrench()
        T, force_N = self.here(), np.array(wrench.force_N)
        return Felt(
            t_s=self.t_s,
            press_N=-float(force_N @ T.rotation[:, 2]),
            force_N=force_N,
            torque_Nm=np.array(wrench.torque_Nm),
            T_base_tcp=T,
            contact="free" if target is None else target.contact,
            left_m=None if target is None else target.path_left_m,
        )

    def peak_N(self, duration_s: float) -> float:
        """Return the most that the tool presses with during a while [N], whatever moves it.

        Raises ArmStoppedError when the arm was stopped in it, else as `now`.
        """
        end_s, most_N = self.t_s + duration_s, -np.inf
        while self.t_s < end_s:
            most_N = max(most_N, self.now().press_N)
            self._raise_when_stopped()
            self._clock.sleep_s(POLL_S)
        return float(most_N)

    def _raise_when_stopped(self) -> None:
        status = self._cell.status()
        if not status.goes_on:
            raise stopped(status, "the arm was stopped")

    def until(
        self, done: Callable[[Felt], bool], *, within_s: float, what: str, tell: Tell
    ) -> list[Felt]:
        """Return all that is felt until something is so. Raises as `next`, and when it is late."""
        felt: list[Felt] = []
        end_s = self.t_s + within_s
        while True:
            felt.append(self.next())
            tell(felt[-1].t_s, end_s, f"{what}: {felt[-1].press_N:.1f} N")
            if done(felt[-1]):
                return felt
            if felt[-1].t_s > end_s:
                raise NotReachedError(f"{what}: not within {within_s:g} s")


class Steady:
    """Tells when something has been so without a break for a while."""

    def __init__(self, so: Callable[[Felt], bool], steady_s: float) -> None:
        """Begin with nothing seen."""
        self._so, self._steady_s = so, steady_s
        self.since_s: float | None = None

    def __call__(self, felt: Felt) -> bool:
        """Take one more sample."""
        if not self._so(felt):
            self.since_s = None
            return False
        self.since_s = felt.t_s if self.since_s is None else self.since_s
        return felt.t_s - self.since_s >= self._steady_s


@contextmanager
def force_ends(cell: ConfiguredCell) -> Iterator[None]:
    """Stop force feedback at the end in any case; an interruption, or any accident, holds the arm.

    Whoever has stopped the arm meanwhile is not talked over.
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
        with deaf(), suppress(ForcemeshError):
            cell.hold("a skill was interrupted")
        raise
    cell.force.stop()


@contextmanager
def like_ctrl_c() -> Iterator[None]:
    """Let a closed terminal, and a process that is told to end, stop the arm as Ctrl-C does."""

    def interrupt(_signal: int, _frame: FrameType | None) -> None:
        """Do as Ctrl-C does."""
        raise KeyboardInterrupt

    with _signals(interrupt, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)):
        yield


@contextmanager
def deaf() -> Iterator[None]:
    """Let no second Ctrl-C get between a person and the hold that the first one asked for."""

    def nothing(_signal: int, _frame: FrameType | None) -> None:
        """Ignore it."""

    with _signals(nothing, (signal.SIGINT,)):
        yield


@contextmanager
def _signals(
    handler: Callable[[int, FrameType | None], None], numbers: tuple[signal.Signals, ...]
) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def is_running(target: RegulatorTarget | None) -> bool:
    """Tell whether the regulator works."""
    return target is not None and target.mode is not None


def silent(_done: float, _total: float, _text: str) -> None:
    """Tell nobody."""
