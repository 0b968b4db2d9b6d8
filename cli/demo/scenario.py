"""Scenario of the main task: press on the plate, then run force feedback until it settles.

It uses the requests and topics of any client, so that the same scenario runs against real processes
and in lock step on a virtual clock.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import hypot
from typing import Any

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Bus, Reader
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ForcemeshError
from forcemesh.messages import Host, Mode
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, Reply
from forcemesh.topics import CLIENT, Q, Request
from launch.processes import Supervisor

SAMPLE_S = 0.001
READY_TIMEOUT_S = 20.0
PRESS_TIMEOUT_S = 30.0
PRESS_BAND_N = 1.0
PRESS_STEADY_S = 0.3
SCENARIO_REST_S = 0.3
SETTLED_FORCE_N = 1.0
SETTLED_TORQUE_NM = 0.1
SETTLED_FOR_S = 1.0
REFRESH_S = 0.05
# Readings of a silent arbiter, one a sample: a demo that did not run itself reads before its bus
# has delivered the messages of that time.
SILENT_READINGS = 50

Check = Callable[[], None]
Progress = Callable[[str, float, float], None]  # phase, force [N], torque [N m]


class ScenarioError(ForcemeshError):
    """The scenario could not continue: its phase and the cause."""


@dataclass(frozen=True, slots=True)
class ScenarioPlan:
    """Parameters of the scenario."""

    mode: Mode = "position"
    host: Host = "pc"
    press_N: float = 30.0
    setpoint_N: float = 0.0
    timeout_s: float = 60.0
    settled_for_s: float = SETTLED_FOR_S  # time that it must stay within the band

    def is_within_band(self, sample: "ScenarioSample") -> bool:
        """Return whether a sample is within the settled band of this task."""
        force_ok = abs(sample.force - self.setpoint_N) <= SETTLED_FORCE_N
        torque_ok = sample.torque <= SETTLED_TORQUE_NM
        return (force_ok or self.mode == "orientation") and (torque_ok or self.mode == "position")


@dataclass(frozen=True, slots=True)
class ScenarioSample:
    """Wrench message with the newest pose at that time."""

    t_s: float  # since the start request of force feedback; negative while pressing
    force_N: Array
    torque_Nm: Array
    T_base_flange: pin.SE3

    @property
    def force(self) -> float:
        """Magnitude of the force [N]."""
        return hypot(*self.force_N)

    @property
    def torque(self) -> float:
        """Magnitude of the torque about the TCP [N m]."""
        return hypot(*self.torque_Nm)


@dataclass(slots=True)
class Trace:
    """Samples, latencies and outcome of a scenario."""

    press: list[ScenarioSample] = field(default_factory=list)
    work: list[ScenarioSample] = field(default_factory=list)
    started: str = ""  # the regulator's confirmation: the law that runs, and why
    settled_at_s: float | None = None
    stages: dict[str, dict[int, int]] = field(default_factory=dict)  # stage: sensor seq: age [ns]
    robot_numbers: dict[str, float] = field(default_factory=dict)  # of its health, at the end


class Scenario:
    """Run of a plan on a cell that is up and IDLE."""

    def __init__(
        self, client: Bus, plan: ScenarioPlan, *, check: Check, progress: Progress
    ) -> None:
        """Subscribe to the topics that are recorded."""
        self._client, self._clock = client, client.clock
        self._plan, self._check, self._progress = plan, check, progress
        self._arbiter = client.reader(topics.ARBITER_STATUS)
        self._robot = client.reader(topics.ROBOT_STATE)
        self._wrench = client.reader(topics.WRENCH)
        self._target = client.reader(topics.REGULATOR_TARGET)
        self._command = client.reader(topics.ROBOT_COMMAND)
        self._robot_health = client.reader(topics.HEALTH["robot"])
        self._silent_readings = 0
        self._start_ns = self._clock.now_ns()
        self.trace = Trace()

    def run(self) -> Trace:
        """Execute the plan; raise ScenarioError when the cell refuses or stops."""
        self._until_ready()
        self._ask(topics.TARE, Empty())
        self._ask(topics.ARM, ArmRequest())
        self._press()
        self._run_force_feedback()
        health = self._robot_health.read(self._clock.now_ns()).message
        self.trace.robot_numbers = {} if health is None else dict(health.numbers)
        self._ask(topics.FORCE_STOP, Empty())
        return self.trace

    def _until_ready(self) -> None:
        """Wait until arming would be accepted: inputs fresh for the preflight's time."""
        give_up_ns = self._clock.now_ns() + round(READY_TIMEOUT_S * NS_PER_S)
        reason = "the arbiter is silent"
        while self._clock.now_ns() < give_up_ns:
            self._tick("starting")
            status = self._arbiter.read(self._clock.now_ns()).fresh
            if status is not None and status.state == "IDLE" and not status.not_ready:
                return
            if status is not None:
                reason = f"the arbiter is {status.state}: {'; '.join(status.not_ready)}"
        raise ScenarioError(f"the cell was not ready within {READY_TIMEOUT_S:g} s: {reason}")

    def _press(self) -> None:
        """Press in position mode until the force is steady."""
        self._start_ns = self._clock.now_ns()
        start_request = ForceStartRequest(mode="position", setpoint_N=self._plan.press_N)
        self._ask(topics.FORCE_START, start_request)
        steady_since_s = float("inf")
        while (sample := self._watch("pressing", self.trace.press)) is None or (
            sample.t_s - steady_since_s < PRESS_STEADY_S
        ):
            if sample is None:
                continue
            is_near = abs(sample.force - self._plan.press_N) <= PRESS_BAND_N
            steady_since_s = min(steady_since_s, sample.t_s) if is_near else float("inf")
            if sample.t_s > PRESS_TIMEOUT_S:
                raise ScenarioError(
                    f"the plate did not push back with {self._plan.press_N:g} N within "
                    f"{PRESS_TIMEOUT_S:g} s: {sample.force:.1f} N"
                )
        self._ask(topics.FORCE_STOP, Empty())
        rest_until_ns = self._clock.now_ns() + round(SCENARIO_REST_S * NS_PER_S)
        while self._clock.now_ns() < rest_until_ns:
            self._watch("pressing", self.trace.press)

    def _run_force_feedback(self) -> None:
        """Start force feedback and record until it has settled or the timeout has passed."""
        plan, trace = self._plan, self.trace
        start_request = ForceStartRequest(
            mode=plan.mode, host=plan.host, setpoint_N=plan.setpoint_N
        )
        offset_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        trace.press = [replace(each, t_s=each.t_s - offset_s) for each in trace.press]
        self._start_ns = self._clock.now_ns()
        trace.started = self._ask(topics.FORCE_START, start_request).text
        inside_since_s: float | None = None
        while True:
            sample = self._watch("force feedback", trace.work)
            if sample is None:
                continue
            if not plan.is_within_band(sample):
                inside_since_s = None
            elif inside_since_s is None:
                inside_since_s = sample.t_s
            elif sample.t_s - inside_since_s >= plan.settled_for_s:
                trace.settled_at_s = inside_since_s
                return
            if sample.t_s > plan.timeout_s:
                return

    def _ask(self, request: Request[Q], message: Q) -> Reply:
        """Return the reply; repeat a request that came too early, as for a tare."""
        give_up_ns = self._clock.now_ns() + round(READY_TIMEOUT_S * NS_PER_S)
        while (reply := self._client.ask(request, message)).code == "wait":
            self._tick("starting")
            if self._clock.now_ns() > give_up_ns:
                break
        if not reply.accepted:
            raise ScenarioError(f"{request.key} was refused ({reply.code}): {reply.text}")
        return reply

    def _watch(self, phase: str, samples: list[ScenarioSample]) -> ScenarioSample | None:
        """Sleep for one sample time; return the newest sample if there is a new one."""
        fresh = self._tick(phase)
        now_ns = self._clock.now_ns()
        status = self._arbiter.read(now_ns)
        self._silent_readings = self._silent_readings + 1 if status.silent else 0
        if 0 < self._silent_readings <= SILENT_READINGS:
            return None
        if status.fault or (status.fresh and not status.fresh.operational):
            trips = status.fresh.trips if status.fresh else ()
            state = status.fresh.state if status.fresh else "silent"
            causes = "; ".join(trip.text for trip in trips) or status.fault or "no cause given"
            raise ScenarioError(
                f"while {phase}: the arm was stopped, the arbiter is {state}: {causes}"
            )
        wrench, robot = self._wrench.read(now_ns).message, self._robot.read(now_ns).message
        if not fresh or wrench is None or robot is None or not wrench.valid:
            return None
        sample = ScenarioSample(
            t_s=(now_ns - self._start_ns) / NS_PER_S,
            force_N=np.array(wrench.force_N),
            torque_Nm=np.array(wrench.torque_Nm),
            T_base_flange=pose_of(robot),
        )
        samples.append(sample)
        self._progress(phase, sample.force, sample.torque)
        return sample

    def _tick(self, phase: str) -> bool:
        """Sleep, record latencies, return whether a new wrench was received."""
        self._clock.sleep_s(SAMPLE_S)
        self._check()
        fresh = self._record_age("wrench", self._wrench)
        self._record_age("regulator", self._target)
        self._record_age("arbiter", self._command)
        if self._robot.poll():
            accepted = self._robot.read(self._clock.now_ns()).message
            echo = None if accepted is None else accepted.accepted
            if echo is not None and echo.sensor_stamp_ns is not None and phase != "starting":
                ages = self.trace.stages.setdefault("robot", {})
                ages.setdefault(echo.sensor_seq or 0, echo.at_ns - echo.sensor_stamp_ns)
        return fresh

    def _record_age(self, stage: str, reader: Reader[Any]) -> bool:
        """Record the age of the sensor sample when a stage published."""
        if not reader.poll():
            return False
        header = reader.read(self._clock.now_ns()).header
        if header is not None and header.sensor_stamp_ns is not None:
            ages = self.trace.stages.setdefault(stage, {})
            ages[header.sensor_seq or 0] = header.stamp_ns - header.sensor_stamp_ns
        return True


# --- on a cell ------------------------------------------------------------------------------------


def play_virtual(cell: CellConfig, plan: ScenarioPlan, progress: Progress) -> Trace:
    """Run in one process on a virtual clock."""
    from launch.virtual_cell import VirtualCell

    world = VirtualCell(cell)
    trace = Scenario(world.client, plan, check=lambda: None, progress=progress).run()
    trace.stages.clear()  # multiples of the virtual step are not latencies
    return trace


def play_real(
    cell: CellConfig,
    plan: ScenarioPlan,
    progress: Progress,
    linger_s: float,
    *,
    panel: bool = False,
    recorder: bool = False,
) -> Trace:
    """Start the cell's processes, run the scenario, and stop them all in any case.

    Raises:
        ScenarioError: A process died or the arm was stopped; after a death the cell stays up for
            `linger_s` before that, so that `forcemesh status` can be used.
        BusError: There was no reply, and no process died.
    """
    names = [name for name, is_on in (("recorder", recorder), ("panel", panel)) if is_on]
    with Supervisor(cell) as processes:

        def check() -> None:
            processes.restart_exited()
            if processes.died:
                raise ScenarioError("a process of the cell died")

        processes.wait_ready()
        try:
            processes.start_helpers(names)
            with open_bus(cell, CLIENT) as client:
                return Scenario(client, plan, check=check, progress=progress).run()
        except ForcemeshError as error:  # also a request without reply: its server may have died
            processes.hold_after_death(linger_s)
            if not processes.died:
                raise
            deaths = "; ".join(str(died) for died in processes.died)
            raise ScenarioError(f"{deaths}: {error}") from error


@contextmanager
def live_progress(screen: Console, plan: ScenarioPlan) -> Iterator[Progress]:
    """Show phase, force and torque while the scenario runs."""
    columns = (
        TextColumn("{task.description:<16}"),
        BarColumn(bar_width=30),
        TextColumn("{task.completed:5.1f} N  {task.fields[torque]:6.3f} N m"),
    )
    with Bar(*columns, console=screen, transient=False) as bar:
        task = bar.add_task("starting", total=plan.press_N, torque=0.0)
        last_s = 0.0

        def progress(phase: str, force_N: float, torque_Nm: float) -> None:
            nonlocal last_s
            now_s = time.monotonic()
            if now_s - last_s > REFRESH_S:
                last_s = now_s
                bar.update(task, description=phase, completed=force_N, torque=torque_Nm)

        yield progress
