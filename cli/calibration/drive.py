"""Motion client of the wizard: joint moves, hold, and the checks that the tool is free."""

from math import hypot

from cli.calibration.gather import Watch
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.client.ask import stopped_error
from forcemesh.clock import wait_until
from forcemesh.errors import BusError, NotReachedError, RefusedError
from forcemesh.messages import RobotState
from forcemesh.requests import ArmRequest, MoveRequest
from identification.errors import CalibrationError, InContactError, NotBegunError, PoseRefusedError

STATE_WITHIN_S = 2.0
REST_WITHIN_S, REST_POLL_S = 2.0, 0.01
READY_WITHIN_S = 5.0  # the preflight needs a second of good inputs and rest
CONTACT_WITHIN_S = 1.0
SLOWEST = 4.0  # timeout of a move: multiple of the expected duration, plus SLOWEST_S
SLOWEST_S = 15.0
POSE_REFUSALS = ("joint", "workspace", "tether", "goal_refused")  # refusals of this pose only


class Drive:
    """Motion of one arm by joint goals."""

    def __init__(self, cell: ConfiguredCell, speed_m_s: float) -> None:
        """Prepare; nothing moves before `arm`."""
        self._cell, self._speed_m_s = cell, speed_m_s
        self._armed_by_us = False

    def state(self) -> RobotState:
        """Return the state of the arm. Raises CalibrationError when none is received."""
        reading = self._cell.state.wait(STATE_WITHIN_S)
        if reading.fresh is None:
            raise CalibrationError(f"no robot state: {reading.fault}")
        return reading.fresh

    def at_rest(self) -> RobotState:
        """Return the state of the arm at rest. Raises CalibrationError when it keeps moving."""
        if not wait_until(
            self._cell.session.clock,
            lambda: not self.state().status.moving,
            within_s=REST_WITHIN_S,
            poll_s=REST_POLL_S,
        ):
            raise CalibrationError("the arm is moving: wait until it is at rest")
        return self.state()

    def refuse_unless_free(self) -> None:
        """Raise NotBegunError when another commander moves the arm, or when it is stopped."""
        reading = self._cell.status.wait(STATE_WITHIN_S)
        status = reading.fresh
        if status is None:
            raise CalibrationError(f"no arbiter status: {reading.fault}")
        if status.state in {"ACTIVE", "SETTLING"}:
            text = f"the {status.commander} commands the arm: stop that first"
            raise NotBegunError("busy", text)
        if status.state not in {"IDLE", "ARMED"}:
            causes = "; ".join(trip.text for trip in status.trips) or "no cause given"
            clears = f"; {status.clears}" if status.clears else ""
            text = f"the arbiter is {status.state}: {causes}{clears}"
            raise NotBegunError("held", f"{text}; the wizard starts from IDLE or ARMED")

    def arm(self) -> str:
        """Arm for moves only; return the text of the reply.

        Raises RefusedError when refused, NotBegunError when the arm is not free.
        """
        self.refuse_unless_free()
        request = ArmRequest(purpose="jog")
        reply = self._cell.ask(topics.ARM, request, within_s=READY_WITHIN_S)
        self._armed_by_us = reply.code != "already"
        return reply.text

    def hold(self, reason: str) -> str:
        """Request a hold; return the text of the reply, or the error."""
        try:
            return self._cell.hold(reason).text
        except BusError as error:
            return f"no reply to the hold request: {error}"

    def release(self) -> None:
        """Disarm the arm when this calibration has armed it."""
        if self._armed_by_us:
            self.hold("the calibration has ended")
            self._cell.clear()

    def move_joints(self, q: Array, length_m: float, watch: Watch) -> None:
        """Move the joints to angles [rad], shape (6,), and wait until they are reached.

        Raises PoseRefusedError when only this goal is not possible, ArmStoppedError when the arm
        was stopped, RefusedError when no motion is allowed.
        """
        request = MoveRequest(kind="joints", joint_rad=tuple(q.tolist()), speed_m_s=self._speed_m_s)
        timeout_s = SLOWEST * length_m / self._speed_m_s + SLOWEST_S
        try:
            self._cell.move.begin(request).wait(timeout_s, lambda _state: watch("moving"))
        except RefusedError as error:
            if error.code in POSE_REFUSALS:
                raise PoseRefusedError(error.text) from None
            raise
        except NotReachedError as error:
            if self.state().goal.state == "refused":
                raise PoseRefusedError(str(error)) from None
            raise

    def check(self) -> None:
        """Raise ArmStoppedError with the arbiter's reason when the arm was stopped."""
        reading = self._cell.status.reading()
        if reading.fresh is not None and not reading.fresh.operational:
            raise stopped_error(reading.fresh, "the arm was stopped")
        if reading.silent and reading.message is not None:
            raise CalibrationError(f"no arbiter status: {reading.fault}")


def refuse_loaded_tool(cell: ConfiguredCell) -> None:
    """Raise NotBegunError when the compensated wrench shows a force on the tool.

    Without a calibration the wrench contains the tool's weight: then nothing is checked here, and
    `refuse_relieved` checks after the tool was lifted.
    """
    cell.wrench.wait(CONTACT_WITHIN_S)  # a missing topic is reported where it is needed
    force_N = cell.load_N()
    if force_N is None:
        return
    raise NotBegunError(
        "contact",
        f"the tool is loaded: {force_N:.1f} N measured, limit {cell.config.force.touch_N:g} N in "
        "free space (force.touch_N); nothing was moved. In contact: `forcemesh arm --jog`, then "
        "move it away. In free space: `forcemesh tare`; --free when another tool than the "
        "calibrated one is mounted; `forcemesh check axes` when the sensor is new",
    )


def refuse_relieved(before_N: Array, after_N: Array, lifted_m: float, cell: CellConfig) -> None:
    """Raise InContactError when the force has changed while the tool was lifted.

    Args:
        before_N: Mean force at the start, sensor axes. Shape (3,).
        after_N: Mean force straight above, in the same attitude.
        lifted_m: Height of the lift [m].
        cell: Cell file with the contact threshold force.touch_N.
    """
    change_N, limit_N = hypot(*after_N - before_N), cell.force.touch_N
    if change_N > limit_N:
        raise InContactError(
            f"the tool was in contact at the start: {change_N:.1f} N change while it was lifted by "
            f"{1e3 * lifted_m:.0f} mm without rotation (limit {limit_N:g} N, force.touch_N); it "
            "stays above the start: check that it is free now, and calibrate again from there"
        )
