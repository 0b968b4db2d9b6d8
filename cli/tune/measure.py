"""Measurement of a running cell: steps in free space, a press, a step inside the controller.

Each measurement is repeated until it agrees, a few times at most; otherwise it is refused. The
code is an ordinary client, so it runs against real processes and in virtual time. The arm must be
armed and in free space; at the end, and after every refusal, it is at its start.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil
from typing import Any

import numpy as np

from cli.skills.contact_monitor import (
    ContactMonitor,
    Debounce,
    ReportProgress,
    no_progress,
    stop_force_at_end,
)
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import pose_of, record_of, vec3
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Reader
from forcemesh.client.ask import stopped_error
from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError, NotReachedError, RefusedError
from forcemesh.faults import FAULTS
from forcemesh.requests import ForceStartRequest, PathRequest
from tuning import contact_response, servo
from tuning.contact_response import ContactResponse, loop_delay
from tuning.contact_spring import Spring, fit_spring
from tuning.identify import Steps, identify_servo
from tuning.servo import Round, Servo

NO_AXES = (False,) * 6
STEP_ACCEL_SHARE, STEP_ACCEL_M_S2 = 0.7, 1.5
STEP_M_S = 0.02
RECORD_POLL_S, REST_S = 0.001, 0.4
STEPS_WITHIN_S = 20.0  # timeout of one lap of steps
LEAST_REPORTS_HZ, MOST_LAPS = 100.0, 15  # at lower report rates a round has more laps
NEAR_N, STEADY_S, READ_S = 0.6, 0.4, 0.3
SHARES = (1 / 3, 2 / 3, 1.0, 2 / 3, 1 / 3)  # of the press force, in sequence
MOST_PRESSES = 3
LEVEL_WITHIN_S = 30.0
RESPONSE_S = 2.5
BACK_M_S = 0.02


@dataclass(frozen=True, slots=True)
class TuningTrial:
    """Step size and press force of a measurement."""

    step_m: float = 0.003
    force_N: float = 12.0


@dataclass(slots=True)
class Readings:
    """All measured data: input of the figure."""

    steps: tuple[Steps, ...] = ()  # of the last round, one for each axis
    rounds: list[Round] = field(default_factory=list)
    servo: Servo | None = None
    travel_m: list[float] = field(default_factory=list)
    forces_N: list[float] = field(default_factory=list)
    spring: Spring | None = None
    responses: list[ContactResponse] = field(default_factory=list)
    controller: ContactResponse | None = None

    @property
    def arm(self) -> Servo:
        """Delay and lag of the arm. Raises DataError before they were measured."""
        if self.servo is None:
            raise DataError("delay and lag were not measured")
        return self.servo


class TuningMeasurement:
    """One measurement of a cell, step by step."""

    def __init__(
        self, cell: ConfiguredCell, trial: TuningTrial, progress: ReportProgress = no_progress
    ) -> None:
        """Read the start pose; nothing moves yet. Raises LostError, NotValidError."""
        self._cell, self._trial, self._progress = cell, trial, progress
        self._clock = cell.session.clock
        self._start = pose_of(cell.state())
        self._T_base_tcp = self._start * cell.config.tool.T_flange_tcp.pose  # at the start
        self.readings = Readings()

    def check(self) -> None:
        """Raise ForcemeshError unless the arm is armed, at rest and in free space."""
        status, touch_N = self._cell.status(), self._cell.config.force.touch_N
        if status.state != "ARMED":
            text = f"the arbiter is {status.state}: tune starts armed and at rest"
            raise RefusedError("not_armed", text, remedy=FAULTS["not_armed"].remedy)
        found_N = float(np.linalg.norm(self._cell.wrench().force_N))
        if found_N > touch_N:
            text = f"{found_N:.1f} N measured before contact, limit {touch_N:g} N"
            raise NotReachedError(f"{text}: move the tool to free space, then tare")

    def steps(self) -> None:
        """Execute rounds of small steps across the tool's axis until two rounds agree.

        Raises:
            DataError: The records determine no delay, or a different one each time.
            NotReachedError: The steps leave the workspace, or take too long.
        """
        T = self._T_base_tcp
        axes = (T.rotation[:, 0], T.rotation[:, 1])
        request, laps = self._lap(T.translation, axes)
        rounds = self.readings.rounds
        with stop_force_at_end(self._cell):
            self._cell.force.begin(ForceStartRequest(mode="position", law="plain", axes=NO_AXES))
            while not servo.rounds_repeat(rounds):
                if len(rounds) == servo.MOST_ROUNDS:
                    sums_ms = ", ".join(f"{1e3 * sum_s:.1f}" for sum_s in servo.sums(rounds))
                    raise DataError(
                        f"delay and lag together were {sums_ms} ms in {len(rounds)} rounds, never "
                        f"twice within {1e3 * servo.REPEATS_S:g} ms: reduce the load of this "
                        "machine (`forcemesh doctor` checks it and the link), then tune again"
                    )
                recorder = MotionRecorder(self._cell)
                recorder.record_for(REST_S)
                self._cell.force.follow(request)
                self._record_steps(recorder, laps, f"steps in free space, round {len(rounds) + 1}")
                self.readings.steps = tuple(recorder.axis_steps(axis) for axis in axes)
                rounds.append(tuple(identify_servo(steps) for steps in self.readings.steps))
        self.readings.servo = servo.servo_of(rounds[-servo.LEAST_ROUNDS :])

    def press(self) -> None:
        """Press with a sequence of forces until the stiffness repeats.

        Raises DataError when it does not, and as `until`.
        """
        monitor, readings = ContactMonitor(self._cell, self._progress), self.readings
        for press in range(1, MOST_PRESSES + 1):
            for number, share in enumerate(SHARES):
                level_N = share * self._trial.force_N
                label = f"press {press}, {number + 1} of {len(SHARES)}"
                self._cell.force.begin(_press_request(level_N))
                travel_m, force_N = self._settled_point(monitor, level_N, label)
                readings.travel_m.append(travel_m)
                readings.forces_N.append(force_N)
            found = fit_spring(np.array(readings.travel_m), np.array(readings.forces_N))
            readings.spring = found
            if found.repeats:
                return
            if press == MOST_PRESSES and not found.is_known:
                text = f"{press} presses showed {found.k_N_m:.0f} +/- {found.spread_N_m:.0f} N/m"
                raise DataError(f"{text}: press harder (--force), on a surface that does not move")

    def controller(self, gain: float) -> None:
        """Step the controller's set point up and down until its delay repeats.

        Args:
            gain: Present integral gain along the tool's axis [m/(N s)].

        Raises:
            DataError: The force did not follow, or its delay did not repeat.
        """
        responses, gateway = self.readings.responses, self._cell.config.gateway
        within_s = contact_response.repeats_within_s(gateway.least_segment_s if gateway else 0.0)
        levels_N = (SHARES[0] * self._trial.force_N, self._trial.force_N)
        while not contact_response.delay_repeats(responses, within_s):
            if len(responses) == contact_response.MOST_RESPONSES:
                delays_ms = ", ".join(f"{1e3 * each.tau_s:.0f}" for each in responses)
                raise DataError(
                    f"the delay of the controller's force loop was {delays_ms} ms, never twice "
                    f"within {1e3 * within_s:g} ms: "
                    "`--no-controller` skips it"
                )
            first_N, then_N = levels_N if len(responses) % 2 == 0 else levels_N[::-1]
            responses.append(self._step_response(gain, first_N, then_N))
        self.readings.controller = contact_response.mean_response(
            responses[-contact_response.LEAST_RESPONSES :]
        )

    def _step_response(self, gain: float, first_N: float, then_N: float) -> ContactResponse:
        """Return the delay of the controller's force after one set point step."""
        assert self.readings.spring is not None  # noqa: S101 - measured before
        monitor = ContactMonitor(self._cell, self._progress)
        self._cell.force.begin(_press_request(first_N, host="controller"))
        initial_N = self._settled_point(monitor, first_N, "in the controller")[1]
        commanded_s = monitor.t_s
        self._cell.force.begin(_press_request(then_N, host="controller"))
        samples = monitor.until(
            lambda sample: sample.t_s - commanded_s > RESPONSE_S,
            within_s=2.0 * RESPONSE_S,
            label="in the controller",
        )
        return loop_delay(
            np.array([sample.t_s - commanded_s for sample in samples]),
            np.array([sample.press_N for sample in samples]),
            first_N=initial_N,
            then_N=then_N,
            ramp_N_s=self._cell.config.force.setpoint_ramp_N_s,
            rate=self.readings.spring.k_N_m * gain,
        )

    def return_to_start(self) -> None:
        """Return to the start. Raises as a move does."""
        speed_m_s = min(BACK_M_S, self._cell.config.limits.speed_m_s)
        start = record_of(self._start)
        self._cell.move.to(start.position_m, start.orientation_xyzw, speed_m_s=speed_m_s)

    def _lap(self, p_tcp_m: Array, axes: tuple[Array, Array]) -> tuple[PathRequest, int]:
        """Return the path of one round, and its number of laps."""
        reach = p_tcp_m + self._trial.step_m * np.array(axes)
        config = self._cell.config
        low, high = config.limits.workspace_min_m, config.limits.workspace_max_m
        if (reach < low).any() or (reach > high).any():
            step_mm = 1e3 * self._trial.step_m
            raise NotReachedError(f"steps of {step_mm:g} mm leave the workspace: start inside it")
        laps = min(MOST_LAPS, max(1, ceil(LEAST_REPORTS_HZ / config.rates.robot_hz)))
        points = (reach[0], p_tcp_m, reach[1], p_tcp_m) * laps
        request = PathRequest(
            points_m=tuple(vec3(point) for point in points),
            speed_m_s=min(STEP_M_S, config.force.speed_max_m_s),
            accel_m_s2=min(STEP_ACCEL_M_S2, STEP_ACCEL_SHARE * config.limits.accel_m_s2),
            in_contact=False,
        )
        return request, laps

    def _record_steps(self, recorder: "MotionRecorder", laps: int, label: str) -> None:
        began_ns, within_s = self._clock.now_ns(), laps * STEPS_WITHIN_S
        arrived_ns: int | None = None
        while arrived_ns is None or self._clock.now_ns() - arrived_ns < REST_S * NS_PER_S:
            recorder.record_for(RECORD_POLL_S)
            spent_s = (self._clock.now_ns() - began_ns) / NS_PER_S
            self._progress(spent_s, within_s, label)
            target = self._cell.target.reading().message
            if target is not None and target.path_left_m == 0.0 and arrived_ns is None:
                arrived_ns = self._clock.now_ns()
            if spent_s > within_s:
                raise NotReachedError(f"the small steps took longer than {within_s:g} s")
            if not self._cell.status().operational:
                raise stopped_error(self._cell.status(), "the arm was stopped")

    def _settled_point(
        self, monitor: ContactMonitor, level_N: float, label: str
    ) -> tuple[float, float]:
        """Return travel along the tool's axis and force, at rest at a force level."""
        settled = Debounce(lambda samples: abs(samples.press_N - level_N) <= NEAR_N, STEADY_S)
        monitor.until(settled, within_s=LEVEL_WITHIN_S, label=label)
        read = Debounce(lambda _: True, READ_S)
        samples = monitor.until(read, within_s=2.0, label=label)
        T = self._T_base_tcp
        place_m = np.mean([sample.T_base_tcp.translation for sample in samples], axis=0)
        travel_m = float((place_m - T.translation) @ T.rotation[:, 2])
        return travel_m, float(np.mean([sample.press_N for sample in samples]))


class MotionRecorder:
    """Recorder of commands and poses with their stamps."""

    def __init__(self, cell: ConfiguredCell) -> None:
        """Subscribe."""
        self._clock, self._T_flange_tcp = cell.session.clock, cell.config.tool.T_flange_tcp.pose
        self._period_s = 1.0 / cell.config.rates.control_hz
        self._command = cell.session.bus.reader(topics.ROBOT_COMMAND)
        self._robot = cell.session.bus.reader(topics.ROBOT_STATE)
        self._commanded: list[tuple[float, Array]] = []
        self._measured: list[tuple[float, Array]] = []

    def record_for(self, duration_s: float) -> None:
        """Record for a duration."""
        end_ns = self._clock.now_ns() + round(duration_s * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            self._clock.sleep_s(RECORD_POLL_S)
            self._record(self._command, self._commanded, lambda message: message.pose)
            self._record(self._robot, self._measured, lambda message: message)

    def axis_steps(self, axis: Array) -> Steps:
        """Return the recorded motion along an axis of the base.

        A late machine receives only the newest command: those between are interpolated.
        """
        commanded_s, commanded = (np.array(part) for part in zip(*self._commanded, strict=True))
        measured_s, measured = (np.array(part) for part in zip(*self._measured, strict=True))
        every_s = np.concatenate(
            [
                np.linspace(a, b, max(1, round((b - a) / self._period_s)), endpoint=False)
                for a, b in pairwise(commanded_s)
            ]
        )
        every_m = np.interp(every_s, commanded_s, commanded @ axis)
        return Steps(every_s, every_m, measured_s, measured @ axis)

    def _record(
        self, reader: Reader[Any], samples: list[tuple[float, Array]], pose: Callable[[Any], Any]
    ) -> None:
        if not reader.poll():
            return
        reading = reader.read(self._clock.now_ns())
        if reading.fresh is None or reading.header is None or pose(reading.fresh) is None:
            return
        # Stamps of another machine use another clock: then the arrival time is used.
        is_same_boot = reading.header.boot == self._clock.boot
        at_ns = reading.header.stamp_ns if is_same_boot else self._clock.now_ns()
        T = pose_of(pose(reading.fresh)) * self._T_flange_tcp
        samples.append((at_ns / NS_PER_S, np.array(T.translation)))


def measure(
    cell: ConfiguredCell,
    trial: TuningTrial,
    *,
    gain: float,
    with_press: bool,
    with_controller: bool,
    progress: ReportProgress = no_progress,
) -> Readings:
    """Execute the requested measurements; the arm returns to its start unless it was stopped.

    Args:
        cell: An armed cell, its tool in free space, a surface in front of it.
        trial: Step size and press force.
        gain: Present integral gain along the tool's axis [m/(N s)].
        with_press: Whether to press; without, the stiffness stays unknown.
        with_controller: Whether to press with the controller's own regulator, too.
        progress: Progress callback.

    Raises:
        DataError: The records do not determine a result.
        NotReachedError: The arm is not free, a step or a force was not reached in time.
        RefusedError, ArmStoppedError, LostError: As the client raises them.
    """
    measuring = TuningMeasurement(cell, trial, progress)
    measuring.check()
    measuring.steps()
    if with_press:
        try:
            with stop_force_at_end(cell):
                measuring.press()
                if with_controller:
                    measuring.controller(gain)
        except (DataError, NotReachedError):
            measuring.return_to_start()
            raise
        measuring.return_to_start()
    return measuring.readings


def _press_request(level_N: float, host: Any = "pc") -> ForceStartRequest:
    return ForceStartRequest(mode="position", host=host, setpoint_N=level_N, law="plain")
