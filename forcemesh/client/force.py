"""Force feedback of a client: start, stop, set point, gains, and pressing until settled."""

from collections.abc import Callable
from dataclasses import dataclass

from forcemesh import topics
from forcemesh.client import rotations as turning
from forcemesh.client.ask import stopped_error
from forcemesh.client.session import ClientSession
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ForcemeshError, NotReachedError
from forcemesh.force_task import GUIDED, parse_task
from forcemesh.messages import (
    Gain3,
    Gains,
    Host,
    Law,
    Mode,
    PoseRecord,
    Preset,
    RobotState,
    TaskFrame,
    Vec3,
    WrenchAtTcp,
)
from forcemesh.requests import Empty, ForceStartRequest, ForceTask, GainsRequest, PathRequest, Reply

POLL_S = 0.01
TORQUE_LEVER_M = 0.1  # band of a torque over that of a force
STARTED_WITHIN_S = 0.5  # after that, the mode that the regulator reports is the requested one
NOT_STARTED = "force feedback was not started by this client: use start"
ALL: tuple[bool, bool, bool, bool, bool, bool] = (True, True, True, True, True, True)

Progress = Callable[[float], None]  # force [N]


@dataclass(frozen=True, slots=True)
class PressResult:
    """Result of pressing."""

    force_N: float  # along the tool's axis, positive: the tool presses
    took_s: float  # until the force was settled within its band


class Force:
    """`cell.force`. Arguments omitted in a start take their defaults, not their previous values.

    Only gains keep the values set last, also by a preset. The client that starts force feedback
    owns it until it ends: another one may stop it, and only a higher rank may change it (`busy`).
    """

    def __init__(self, session: ClientSession) -> None:
        """Start without force feedback."""
        self._session = session
        self._last_request: ForceStartRequest | None = None  # last start request of this client

    def start(
        self,
        setpoint_N: float = 0.0,
        *,
        mode: Mode = "position",
        host: Host = "pc",
        law: Law | None = None,
        preset: Preset | None = None,
        axes: tuple[bool, bool, bool, bool, bool, bool] = ALL,
    ) -> Reply:
        """Start or change force feedback; `ForceStartRequest` describes the arguments.

        Raises RefusedError and LostError, as every method here. For single axes: `start_task`.
        """
        request = ForceStartRequest(
            mode=mode, host=host, setpoint_N=setpoint_N, law=law, preset=preset, axes=axes
        )
        return self.begin(request)

    def start_task(
        self,
        task: ForceTask | str,
        *,
        frame: TaskFrame = "tool",
        host: Host = "pc",
        law: Law | None = None,
        preset: Preset | None = None,
    ) -> Reply:
        """Start or change force feedback along and about each axis of a task frame.

        Args:
            task: Task, or the text of its axes: `z=force:15 rx=torque:0`, the others held.
            frame: Of the axes of a text.
            host: Host of the control loop; the controller refuses what its commands cannot do.
            law: Of the axes with set points.
            preset: Initial gains.

        Raises:
            ForcemeshError: The text names an axis or a control that does not exist.
        """
        if isinstance(task, str):
            task = parse_task(task, frame)
        return self.begin(ForceStartRequest(task=task, host=host, law=law, preset=preset))

    def guide(self, mode: Mode = "position") -> Reply:
        """Let a hand guide the tool: it yields to a push, and stays where it is released.

        Args:
            mode: Whether the hand moves it, turns it, or both.
        """
        return self.start_task(GUIDED[mode], law="plain")

    def begin(self, request: ForceStartRequest) -> Reply:
        """Start force feedback with a complete request."""
        start_request = request.replaced(commander=self._session.commander)
        reply = self._session.ask(topics.FORCE_START, start_request)
        self._last_request = start_request
        return reply

    def set(self, setpoint_N: float) -> Reply:
        """Change the set point [N] of the force feedback of this client; the force follows a ramp.

        Of a task with several axes, `start_task` changes the set points. Raises ForcemeshError when
        this client has not started any: mode and axes are unknown.
        """
        start_request = self._last_request
        if start_request is None:
            raise ForcemeshError(NOT_STARTED)
        if start_request.task is not None:
            raise ForcemeshError("a task has a set point for each axis: change it by start_task")
        return self.begin(start_request.replaced(setpoint_N=setpoint_N))

    def stop(self) -> Reply:
        """Stop force feedback; the arm stays where it is."""
        self._last_request = None
        return self._session.ask(topics.FORCE_STOP, Empty())

    def path(
        self,
        points_m: tuple[Vec3, ...],
        *,
        speed_m_s: float = 0.02,
        append: bool = False,
        in_contact: bool = True,
    ) -> Reply:
        """Follow points of the TCP in base axes while force feedback runs; without points: stop.

        Start with the tool's lateral axes locked (`axes`, frame tool): force feedback would yield
        to friction there. The adaptive law requires this, because it would drive back.
        """
        request = PathRequest(
            points_m=points_m, speed_m_s=speed_m_s, append=append, in_contact=in_contact
        )
        return self.follow(request)

    def path_of_poses(
        self,
        poses: tuple[PoseRecord, ...],
        *,
        speed_m_s: float = 0.02,
        blend_m: float = 0.0,
        append: bool = False,
        in_contact: bool = True,
    ) -> Reply:
        """Follow poses of the TCP in base while force feedback runs, in three dimensions.

        The tool turns with the poses, and moves along every axis that the force does not control;
        along those, force control corrects the path. Start with the others held, for instance
        `start_task("z=force:10", frame="tool")`.

        Args:
            poses: At most 30 in one request, the tool's z axis into the surface.
            speed_m_s: Feed; it drops where the force error grows.
            blend_m: Corners are rounded from this distance on.
            append: Continue the present path.
            in_contact: Wait where there is no contact; otherwise go on, and count what was missed.
        """
        request = PathRequest(
            poses=poses, speed_m_s=speed_m_s, blend_m=blend_m, append=append, in_contact=in_contact
        )
        return self.follow(request)

    def follow(self, request: PathRequest) -> Reply:
        """Follow a path with a complete request."""
        owned = request.replaced(commander=self._session.commander)
        return self._session.ask(topics.FORCE_PATH, owned)

    def gains(
        self,
        preset: Preset | None = None,
        *,
        force_p_m_per_N: Gain3 | None = None,
        force_i_m_per_Ns: Gain3 | None = None,
        torque_p_rad_per_Nm: Gain3 | None = None,
        torque_i_rad_per_Nms: Gain3 | None = None,
        accept_unstable: bool = False,
    ) -> Gains:
        """Set gains about the base axes x, y, z and return all gains; they ramp while it runs.

        Omitted gains keep their values, or take those of the preset. Without arguments the present
        gains are returned. Those that are unstable at the cell file's stiffest contact are refused
        unless they are accepted.
        """
        request = GainsRequest(
            preset=preset,
            force_p_m_per_N=force_p_m_per_N,
            force_i_m_per_Ns=force_i_m_per_Ns,
            torque_p_rad_per_Nm=torque_p_rad_per_Nm,
            torque_i_rad_per_Nms=torque_i_rad_per_Nms,
            accept_unstable=accept_unstable,
        )
        gains = self.ask_gains(request).gains
        if gains is None:
            raise ForcemeshError("the regulator's reply holds no gains")
        return gains

    def ask_gains(self, request: GainsRequest) -> Reply:
        """Set gains with a complete request; the reply holds all gains."""
        owned = request.replaced(commander=self._session.commander)
        return self._session.ask(topics.GAINS, owned)

    def press(
        self,
        force_N: float,
        *,
        within_s: float = 30.0,
        band_N: float = 1.0,
        steady_s: float = 0.3,
        progress: Progress | None = None,
    ) -> PressResult:
        """Press along the tool's axis until the force has stayed within a band for `steady_s`.

        In free space the tool approaches first. It keeps pressing until `stop`.

        Raises:
            ArmStoppedError: The arm was stopped.
            NotReachedError: Not within `within_s`: force feedback is stopped, the arm stays.
        """
        self.start(force_N)
        try:
            return self.settle(
                within_s=within_s, band_N=band_N, steady_s=steady_s, progress=progress
            )
        except (KeyboardInterrupt, NotReachedError):
            self.stop()
            raise

    def settle(
        self,
        *,
        within_s: float = 30.0,
        band_N: float = 1.0,
        steady_s: float = 0.3,
        progress: Progress | None = None,
    ) -> PressResult:
        """Wait until the force has settled within a band at the set point of `start` or `set`.

        Raises as `press`, but force feedback keeps running.
        """
        if self._last_request is None:
            raise ForcemeshError(NOT_STARTED)
        request, clock = self._last_request, self._session.clock
        began_ns, inside_ns = clock.now_ns(), None
        while True:
            clock.sleep_s(POLL_S)
            now_ns = clock.now_ns()
            found_N = self.pressed_N()
            if progress is not None:
                progress(found_N)
            self._raise_when_ended(now_ns - began_ns)
            if not self._is_near(request, found_N, band_N):
                inside_ns = None
            else:
                inside_ns = now_ns if inside_ns is None else inside_ns
                if now_ns - inside_ns >= steady_s * NS_PER_S:
                    return PressResult(found_N, (inside_ns - began_ns) / NS_PER_S)
            if now_ns - began_ns > within_s * NS_PER_S:
                goal = f"{request.setpoint_N:g} N" if request.task is None else "the set points"
                text = f"{goal} were not reached within {within_s:g} s: {found_N:.1f} N"
                raise NotReachedError(text)

    def pressed_N(self) -> float:
        """Return the present pressing force along the tool's axis [N]."""
        robot = self._session.feed(topics.ROBOT_STATE)()
        wrench = self._session.feed(topics.WRENCH)()
        return press_force_N(robot, wrench, self._session.info.T_flange_tcp)

    def _is_near(self, request: ForceStartRequest, found_N: float, band_N: float) -> bool:
        """Return whether the force is within a band; of a task that along each controlled axis.

        The band of a torque is that of a force at TORQUE_LEVER_M.
        """
        if request.task is None:
            force_N = request.setpoint_N
            return abs(found_N - force_N) <= band_N and self._is_in_contact(force_N)
        target = self._session.feed(topics.REGULATOR_TARGET).reading().fresh
        bands = (band_N,) * 3 + (TORQUE_LEVER_M * band_N,) * 3
        if target is None or not target.axes:
            return False
        return all(
            abs(state.exerted - asked.setpoint) <= band
            for asked, state, band in zip(request.task.axes, target.axes, bands, strict=True)
            if asked.control == "force"
        )

    def _is_in_contact(self, force_N: float) -> bool:
        """Return whether the tool is in contact; a small force is also measured in free space."""
        target = self._session.feed(topics.REGULATOR_TARGET).reading().fresh
        return force_N <= 0.0 or (target is not None and target.contact == "contact")

    def _raise_when_ended(self, since_ns: int) -> None:
        """Raise when the arm or force feedback was stopped."""
        status = self._session.feed(topics.ARBITER_STATUS)()
        if not status.operational:
            raise stopped_error(status, "pressing ended")
        target = self._session.feed(topics.REGULATOR_TARGET).reading().message
        ended = target is not None and target.mode is None
        if ended and target is not None and since_ns > STARTED_WITHIN_S * NS_PER_S:
            raise NotReachedError(f"pressing ended: {target.reason or 'force feedback stopped'}")


def press_force_N(robot: RobotState, wrench: WrenchAtTcp, T_flange_tcp: PoseRecord) -> float:
    """Return the force along the tool's z axis [N], positive: the tool presses."""
    axis_in_flange = turning.rotate(T_flange_tcp.orientation_xyzw, (0.0, 0.0, 1.0))
    axis = turning.rotate(robot.orientation_xyzw, axis_in_flange)
    return -sum(f * a for f, a in zip(wrench.force_N, axis, strict=True))
