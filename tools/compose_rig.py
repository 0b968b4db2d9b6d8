"""Fixtures of the container tests: compose as a command, and an operator of the cell."""

import json
import math
import os
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.errors import ForcemeshError
from forcemesh.messages import MAY_MOVE, ArbiterStatus, RobotState
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, MoveRequest
from forcemesh.topics import HEALTH, ROLES, TOPICS
from tests.chaos.witness import Witness

T = TypeVar("T")

ROOT = Path(__file__).resolve().parents[1]
PROJECT = "forcemesh-test"
PRESS_N = 10.0
STILL_RAD = 2e-3
RETREAT_S = 30.0
MOST_REPEATS = 3  # per profile: with more stalls the machine is not suitable for the test
STEADY_S = 0.5  # of constant force: the press has settled
POLL_S = 0.01


class RequirementError(Exception):
    """A requirement that was not met."""


def run(*words: str, timeout_s: float = 120.0, **environment: str) -> str:
    """Run a command; return its output. Raise RequirementError with the end of it if it fails."""
    around = {**os.environ, **environment}
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=ROOT, timeout=timeout_s, env=around
    )
    if done.returncode != 0:
        raise RequirementError(f"{' '.join(words)}: {(done.stderr or done.stdout).strip()[-1500:]}")
    return done.stdout.strip()


def run_check(where: str, name: str, check: Callable[[], str]) -> int:
    """Run a check and print its result; return 1 if a requirement was not met, else 0."""
    began_s, wrong = time.monotonic(), 0
    try:
        result = check()
    except Exception as error:  # noqa: BLE001 - the other checks still run
        result, wrong = f"FAILED: {error}", 1
    print(f"{where:8} {name:26} {time.monotonic() - began_s:5.1f} s  {result}", flush=True)
    return wrong


@dataclass(frozen=True, slots=True)
class Compose:
    """The containers of one profile."""

    profile: str
    command: tuple[str, ...]  # `docker compose` or `docker-compose`

    def __call__(self, *words: str) -> str:
        """Run compose on the project."""
        word = [] if self.profile == "sim" else ["--profile", self.profile]
        return run(*self.command, "-p", PROJECT, *word, *words)

    def names(self) -> list[str]:
        """Return the services that the profile starts, including those on standby."""
        services = yaml.safe_load((ROOT / "docker-compose.yml").read_text("utf-8"))["services"]
        return sorted(
            name
            for name, entry in services.items()
            if self.profile in entry.get("profiles", [self.profile])
        )

    def id(self, name: str) -> str:
        """Return the container of a service."""
        return self("ps", "-q", name).splitlines()[0]

    def health(self, name: str) -> str:
        """Return the state of its health check: starting, healthy or unhealthy."""
        return run("docker", "inspect", "-f", "{{.State.Health.Status}}", self.id(name))

    def facts(self, name: str) -> Any:
        """Return the engine's data on a container."""
        return json.loads(run("docker", "inspect", self.id(name)))[0]

    def wait_log(self, name: str, text: str, within_s: float = 30.0) -> None:
        """Wait for a text in the log of a container."""
        give_up_s = time.monotonic() + within_s
        while text not in (log := self("logs", "--no-color", name)):
            if time.monotonic() > give_up_s:
                raise RequirementError(f"{name} does not log {text!r} but {log}")
            time.sleep(0.2)

    def wait_healthy(self, within_s: float) -> float:
        """Wait until every container is healthy; return the time taken [s]."""
        began_s = time.monotonic()
        waiting = set(self.names())
        while waiting:
            waiting = {name for name in waiting if self.health(name) != "healthy"}
            if time.monotonic() - began_s > within_s:
                logs = "\n".join(self("logs", "--no-color", "--tail", "5", n) for n in waiting)
                raise RequirementError(
                    f"not healthy after {within_s:.0f} s: {sorted(waiting)}\n{logs}"
                )
            time.sleep(0.5)
        return time.monotonic() - began_s


class Operator:
    """Operator of the cell: moves, presses, holds, and observes the arm."""

    def __init__(self, bus: Bus, cell: CellConfig, witness: Witness) -> None:
        """Subscribe to every topic."""
        self._bus, self._witness = bus, witness
        self._deadline_s = min(cell.deadlines.command_s, cell.deadlines.sensor_s)
        self.repeats = 0
        self.readers = {topic.key: bus.reader(topic) for topic in TOPICS}
        self._home: tuple[float, ...] | None = None

    def received(self) -> set[str]:
        """Return the topics with at least one received message."""
        now_ns = self._bus.clock.now_ns()
        return {k for k, r in self.readers.items() if r.read(now_ns).message is not None}

    def state(self) -> str:
        """Return the arbiter's state, empty while it is silent."""
        reading = self.readers[topics.ARBITER_STATUS.key].read(self._bus.clock.now_ns())
        return "" if reading.fresh is None else str(getattr(reading.fresh, "state", ""))

    def _why(self) -> str:
        """Return the state and causes that the arbiter reports."""
        status = self.readers[topics.ARBITER_STATUS.key].read(self._bus.clock.now_ns()).fresh
        if not isinstance(status, ArbiterStatus):
            return "the arbiter is silent"
        causes = [*(trip.text for trip in status.trips), *status.not_ready]
        return f"the arbiter is {status.state}: {'; '.join(causes) or 'nothing tripped'}"

    def arm(self) -> RobotState | None:
        """Return the last robot state, if it is fresh."""
        reading = self.readers[topics.ROBOT_STATE.key].read(self._bus.clock.now_ns())
        return reading.fresh if isinstance(reading.fresh, RobotState) else None

    def force_N(self) -> float:
        """Return the magnitude of the force at the tool [N], 0 while it is unknown."""
        reading = self.readers[topics.WRENCH.key].read(self._bus.clock.now_ns())
        return math.hypot(*getattr(reading.fresh, "force_N", (0.0,)))

    def until(self, what: Callable[[], object], within_s: float, name: str) -> float:
        """Wait for a condition; return the time taken [s]."""
        began_s = time.monotonic()
        while not what():
            if time.monotonic() - began_s > within_s:
                raise RequirementError(f"not within {within_s:g} s: {name}; {self._why()}")
            time.sleep(POLL_S)
        return time.monotonic() - began_s

    def at_home(self) -> None:
        """Store the present pose as the home pose."""
        self.until(self.arm, 30.0, "robot/state")
        self._home = getattr(self.arm(), "joint_rad", None)

    def press(self) -> None:
        """From rest in free space, press on the plate."""
        self.again_after_a_stall(self._press)

    def again_after_a_stall(self, what: Callable[[], T]) -> T:
        """Run an action that a stall of the machine may end; then go home and repeat it once.

        Only if the witness was late by more than the cell's shortest deadline in that time.
        """
        began_ns = time.monotonic_ns()
        try:
            return what()
        except (RequirementError, ForcemeshError) as error:
            stall_s = self._witness.worst_s(began_ns, time.monotonic_ns())
            if stall_s <= self._deadline_s or self.repeats == MOST_REPEATS:
                raise
            self.repeats += 1
            print(f"REPEATED, the machine stalled for {stall_s:.3f} s: {error}", flush=True)
        self.retreat()
        return what()

    def _press(self) -> None:
        self.clear()
        self._do(topics.ARM, ArmRequest())
        self._do(topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=PRESS_N))
        steady_since_s = time.monotonic()

        def is_steady() -> bool:
            nonlocal steady_since_s
            if abs(self.force_N() - PRESS_N) > 1.0:
                steady_since_s = time.monotonic()
            return time.monotonic() - steady_since_s > STEADY_S

        self.until(is_steady, 40.0, f"pressing with {PRESS_N} N")

    def clear(self) -> None:
        """Return to IDLE, as a person does, and wait until arming would be accepted."""

        def is_idle() -> bool:
            if self.state() not in {"", "IDLE"}:
                self._request(topics.CLEAR, Empty())
            return self.state() == "IDLE"

        self.until(is_idle, 30.0, "IDLE after clear")

    def retreat(self) -> None:
        """Move back to where the first press began."""
        self.clear()
        self._do(topics.ARM, ArmRequest(purpose="jog"))
        home = self._home
        self._do(topics.MOVE, MoveRequest(kind="joints", joint_rad=home, speed_m_s=0.05))
        self.until(lambda: self._distance(home) < 2 * STILL_RAD, RETREAT_S, "the return path")
        time.sleep(0.5)
        self._request(topics.HOLD, HoldRequest(reason="back again"))
        self.clear()

    def rests(self, seconds: float) -> None:
        """Observe the arm for a duration: it must not move, nor have permission to."""
        self.until(self.arm, 30.0, "robot/state again")
        before = getattr(self.arm(), "joint_rad", ())
        give_up_s = time.monotonic() + seconds
        while time.monotonic() < give_up_s:
            if self.state() in MAY_MOVE:
                raise RequirementError(
                    f"motion is permitted again without a person: {self.state()}"
                )
            if self._distance(before) > STILL_RAD:
                raise RequirementError("the arm moves again without a person")
            time.sleep(POLL_S)

    def is_held(self, broken: str) -> bool:
        """Return whether robot or arbiter report a hold, even if one of them is missing."""
        arm, state = self.arm(), self.state()
        if arm is not None and arm.hold_reason:
            return True
        return broken != "arbiter" and state != "" and state not in MAY_MOVE

    def all_well(self) -> bool:
        """Return whether every role's health is fresh and reports no fault."""
        healths = [self._read(HEALTH[role].key) for role in ROLES]
        return all(health is not None and not health.fault for health in healths)

    def _distance(self, joints: Any) -> float:
        arm = self.arm()
        return 0.0 if arm is None or not joints else math.dist(arm.joint_rad, joints)

    def _read(self, key: str) -> Any:
        return self.readers[key].read(self._bus.clock.now_ns()).fresh

    def _request(self, request: Any, message: Any) -> Any:
        try:
            return self._bus.ask(request, message, 2.0)
        except ForcemeshError:
            return None  # the server is missing: the state shows it

    def _do(self, request: Any, message: Any) -> None:
        give_up_s = time.monotonic() + 30.0
        while True:
            reply = self._request(request, message)
            if reply is not None and reply.accepted:
                return
            if time.monotonic() > give_up_s:  # a temporary obstacle has passed by then
                raise RequirementError(f"{request.key}: {reply}")
            time.sleep(0.2)


def compose_command() -> tuple[str, ...]:
    """Return the compose command of this machine, empty if there is none."""
    for command in (("docker", "compose"), ("docker-compose",)):
        try:
            done = subprocess.run([*command, "version"], capture_output=True, check=False)
        except OSError:
            continue
        if done.returncode == 0:
            return command
    return ()


def in_namespace(namespace: str, *words: str) -> list[str]:
    """Return a command that runs in the namespace of the containers' published ports."""
    return ["nsenter", f"--net=/run/netns/{namespace}", *words] if namespace else list(words)


def environment_of(file: Path) -> dict[str, str]:
    """Return this process's environment extended by a file of settings."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return {**os.environ, **dict(line.split("=", 1) for line in lines if "=" in line)}
