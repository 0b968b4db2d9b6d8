"""Fixtures of the container tests: compose as a command, and an operator of the cell."""

import json
import math
import os
import re
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.errors import ForcemeshError
from forcemesh.messages import MAY_MOVE, Trip
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, MoveRequest
from forcemesh.topics import HEALTH, ROLES, TOPICS, Q, Request
from tests.chaos.common_net import ROOT, CellUnderTest

T = TypeVar("T")

PROJECT = "forcemesh-test"
PRESS_N = 10.0
STILL_RAD = 2e-3
HELD_S = 0.35  # docs/reliability.md: at rest, real processes, deadlines of the demo
MOST_HOLDS = 10  # of one profile; a quiet machine has none
LONGEST_AGE = 2.0  # deadlines, of a message that ends a press: the one who notices may be late too
LATE = {"stale", "sensor_silent", "overrun", "misaligned"}  # codes of a late process
AGES_MS = re.compile(r"stale: (\d+) ms old, limit (\d+) ms")
STEADY_S = 0.5  # of constant force: the press has settled


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


class Operator(CellUnderTest):
    """Client that moves, presses, holds, and observes the arm of the cell in the containers."""

    poll_s = 0.01  # the containers need the processor

    def __init__(self, cell: CellConfig, bus: Bus) -> None:
        """Subscribe to every topic."""
        super().__init__(cell, bus)
        self.holds = 0  # because a process was late
        self.readers: dict[str, Any] = {topic.key: bus.reader(topic) for topic in TOPICS}
        self._home: tuple[float, ...] = ()

    def received(self) -> set[str]:
        """Return the topics with at least one received message."""
        now_ns = self.clock.now_ns()
        return {k for k, r in self.readers.items() if r.read(now_ns).message is not None}

    def fresh_joints(self) -> tuple[float, ...]:
        """Return the joint angles of the last robot state [rad], empty if it is not fresh."""
        robot = self.robot
        return () if robot is None else robot.joint_rad

    def at_home(self) -> None:
        """Store the present pose as the home pose."""
        self.until(self.fresh_joints, "robot/state")
        self._home = self.fresh_joints()

    def press_until_steady(self) -> None:
        """From rest in free space, press on the plate."""
        self.again_after_a_late_hold(self._press)

    def again_after_a_late_hold(self, what: Callable[[], T]) -> T:
        """Run an action; judge each hold that a late process causes, arm anew, and run it again."""
        while True:
            processes = self.processes()
            try:
                return what()
            except (RequirementError, ForcemeshError) as error:
                if self.holds >= MOST_HOLDS:
                    raise
                self._judge_hold(error, processes)

    def _judge_hold(self, error: Exception, processes: dict[str, int]) -> None:
        """Accept a hold that came in time, names lateness, and ends by a person alone.

        Args:
            error: What ended the action.
            processes: Process of each role before it: one that ended was not late.

        Raises:
            RequirementError: The hold is not such a one.
            Exception: The error itself, when the arm was not held.
        """
        status = self.status
        if status is None or status.may_move or not status.trips:
            raise error
        self.count_late_hold()
        self.rests(STEADY_S)
        self.same_processes(processes)
        self.retreat()

    def processes(self) -> dict[str, int]:
        """Return a number of the process of each role: one that was started again has another."""
        now_ns = self.clock.now_ns()
        health_of = {role: reader.read(now_ns) for role, reader in self._health.items()}
        return {role: each.header.epoch for role, each in health_of.items() if each.header}

    def same_processes(self, before: dict[str, int], but: tuple[str, ...] = ()) -> None:
        """Raise RequirementError if a process has ended since; those of some roles may have."""
        now = self.processes()
        if ended := {role for role in before.keys() - but if now[role] != before[role]}:
            raise RequirementError(f"held because {ended} ended: {self.cause}")

    def count_late_hold(self) -> None:
        """Count the present hold.

        Raises RequirementError: it is not for lateness, came late, or is one too many.
        """
        causes, trips = self.cause, self.trips
        if not trips or (other := {trip.code for trip in trips} - LATE):
            raise RequirementError(f"held for {other if trips else 'no cause'}: {causes}")
        for age_ms, limit_ms in AGES_MS.findall(causes):
            if int(age_ms) > LONGEST_AGE * int(limit_ms):
                raise RequirementError(f"held only after {age_ms} ms: {causes}")
        self.holds += 1
        if self.holds > MOST_HOLDS:
            raise RequirementError(f"more than {MOST_HOLDS} holds for lateness: {causes}")
        print(f"HELD, a process was late: {causes}", flush=True)

    def _press(self) -> None:
        self.clear()
        self.insist(topics.ARM, ArmRequest())
        self.insist(topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=PRESS_N))
        steady_since_s = time.monotonic()

        def is_steady() -> bool:
            nonlocal steady_since_s
            if (status := self.status) is not None and not status.may_move:
                raise RequirementError(f"{status.state} while it presses: {status.trips}")
            if not abs(self.force_N - PRESS_N) <= 1.0:  # nor while it is unknown
                steady_since_s = time.monotonic()
            return time.monotonic() - steady_since_s > STEADY_S

        self.until(is_steady, f"pressing with {PRESS_N} N", 40.0)

    def clear(self) -> None:
        """Return to IDLE, as a person does, and wait until arming would be accepted."""

        def is_idle() -> bool:
            if self.state not in {"", "IDLE"}:
                self._try(topics.CLEAR, Empty())
            return self.state == "IDLE"

        self.until(is_idle, "IDLE after clear")

    def retreat(self) -> None:
        """Move back to where the first press began."""
        self.clear()
        self.insist(topics.ARM, ArmRequest(purpose="jog"))
        home = MoveRequest(kind="joints", joint_rad=self._home, speed_m_s=0.05)
        self.insist(topics.MOVE, home)
        self.until(lambda: self._distance_rad(self._home) < 2 * STILL_RAD, "the return path")
        time.sleep(0.5)
        self._try(topics.HOLD, HoldRequest(reason="back again"))
        self.clear()

    def rests(self, seconds: float) -> None:
        """Observe the arm for a duration: it must not move, nor have permission to."""
        self.until(self.fresh_joints, "robot/state again")
        before = self.fresh_joints()
        give_up_s = time.monotonic() + seconds
        while time.monotonic() < give_up_s:
            if self.state in MAY_MOVE:
                raise RequirementError(f"motion is permitted again without a person: {self.state}")
            if self._distance_rad(before) > STILL_RAD:
                raise RequirementError("the arm moves again without a person")
            time.sleep(self.poll_s)

    def is_held(self, broken: str) -> bool:
        """Return whether robot or arbiter report a hold, even if one of them is missing."""
        robot, state = self.robot, self.state
        if robot is not None and robot.hold_reason:
            return True
        return broken != "arbiter" and state != "" and state not in MAY_MOVE

    @property
    def cause(self) -> str:
        """Causes of the hold that arbiter and robot have published last."""
        robot = self._robot.read(self.clock.now_ns()).message
        reason = "" if robot is None else robot.hold_reason
        return "; ".join([*(trip.text for trip in self.trips), reason])

    @property
    def trips(self) -> tuple[Trip, ...]:
        """Trips that the arbiter has published last."""
        status = self._arbiter.read(self.clock.now_ns()).message
        return () if status is None else status.trips

    def all_well(self) -> bool:
        """Return whether every role's health is fresh and reports no fault."""
        now_ns = self.clock.now_ns()
        healths = [self.readers[HEALTH[role].key].read(now_ns).fresh for role in ROLES]
        return all(health is not None and not health.fault for health in healths)

    def _distance_rad(self, joints: tuple[float, ...]) -> float:
        now = self.fresh_joints()
        return math.dist(now, joints) if now and joints else 0.0

    def _try(self, request: Request[Q], message: Q) -> None:
        with suppress(ForcemeshError):  # the server is missing: the state shows it
            self.client.ask(request, message)


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
