"""What dies in a cell is started again, with the arm held, and not without end."""

import os
import signal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.status import died_text, restarts_of
from common.config.cell import CellConfig
from launch.processes import Supervisor
from launch.restart import DEATH_LIMIT, DEATH_WINDOW_S, RESTART_PAUSE_S, Restarter, RestartPolicy
from launch.run_file import read_run
from launch.started_process import ProcessExit, ProcessSpec
from tests.unit.launch.test_processes import DEMO, SLEEPER, cell, pids_of, python, until

__all__ = ["cell"]  # the fixture

GONE = (ProcessSpec("services.wrench", ("wrench",)), ProcessSpec("services.hub", ("hub",)))


def death(process: ProcessSpec = GONE[0], pid: int = 1) -> ProcessExit:
    """Return one by kill -9."""
    return ProcessExit(process, pid, -int(signal.SIGKILL))


# --- how often ------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.0, 300.0), max_size=60))
def test_never_more_starts_within_a_window_than_there_are_chances(times_s: list[float]) -> None:
    """Whenever it dies: of any so many deaths in a row within a window, the last is not revived."""
    patience, started = RestartPolicy(), []
    for now_s in sorted(times_s):
        if (due_s := patience.restart_time_s("wrench", now_s)) is not None:
            assert now_s + RESTART_PAUSE_S <= due_s < now_s + DEATH_WINDOW_S
            started.append(now_s)
    for first, last in zip(started, started[DEATH_LIMIT - 1 :], strict=False):
        assert last - first >= DEATH_WINDOW_S


def test_each_new_start_waits_longer_and_each_process_has_its_own_patience() -> None:
    """As the containers' engine does it; an hour later it is as if nothing had been."""
    patience = RestartPolicy()
    pauses = [(patience.restart_time_s("wrench", 0.0) or 0.0) for _ in range(DEATH_LIMIT - 1)]
    assert pauses == [RESTART_PAUSE_S * 2.0**n for n in range(DEATH_LIMIT - 1)]
    assert patience.restart_time_s("wrench", 0.0) is None
    assert patience.restart_time_s("hub", 0.0) == RESTART_PAUSE_S
    assert patience.restart_time_s("wrench", 3600.0) == 3600.0 + RESTART_PAUSE_S


def test_nothing_is_back_before_the_robot_has_missed_it(cell: CellConfig) -> None:
    """With a long deadline a hub that was back within 0.2 s left an arm that went on."""
    slow = cell.model_copy(
        update={"deadlines": cell.deadlines.model_copy(update={"command_s": 0.7})}
    )
    supervisor = Supervisor(slow)
    supervisor.enable_restarts()
    assert supervisor._restarter is not None
    assert supervisor._restarter.policy.restart_time_s("hub", 10.0) == 10.7


# --- what becomes of them, on a clock of the test's own -------------------------------------------


class World:
    """A supervisor that writes down what is asked of it."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.did: list[str] = []
        self.reviver = Restarter(
            start=self.start, hold=self.hold, write_line=lambda _, text: self.say(text)
        )

    def start(self, process: ProcessSpec, died: ProcessExit) -> int:
        """Start a process in the place of another."""
        self.did.append(f"start {process.name} for {died.pid}")
        return died.pid + 1

    def hold(self, reason: str) -> str:
        """Ask for a hold."""
        self.did.append(f"hold: {reason}")
        return "held"

    def say(self, text: str) -> None:
        """Say something to people."""
        self.did.append(text)


def test_first_the_hold_then_the_new_start_then_what_a_person_does() -> None:
    """Nothing is started before its time; the words name who died, of what, and what comes next."""
    world = World()
    world.reviver.add(death())
    assert world.reviver.update(10.0) == []
    assert "killed by SIGKILL" in world.did[0]
    assert world.did[0].startswith("hold: died: wrench")
    world.reviver.update(10.0 + 0.9 * RESTART_PAUSE_S)
    assert len(world.did) == 2
    world.reviver.update(10.0 + RESTART_PAUSE_S)
    assert world.did[2] == "start wrench for 1"
    assert "`forcemesh clear`, then `forcemesh arm`" in world.did[3]
    world.reviver.update(1000.0)
    assert len(world.did) == 4


def test_two_that_die_together_are_held_for_once_and_both_come_back() -> None:
    """One hold names both."""
    world = World()
    for pid, process in enumerate(GONE):
        world.reviver.add(death(process, pid))
    world.reviver.update(0.0)
    world.reviver.update(RESTART_PAUSE_S)
    assert [line for line in world.did if line.startswith("start")] == [
        "start wrench for 0", "start hub for 1",
    ]  # fmt: skip
    assert sum(line.startswith("hold") for line in world.did) == 1


def test_what_dies_over_and_over_is_given_up_with_one_clear_sentence() -> None:
    """How often, of what, and what a person does; it is held for each death."""
    world, now_s = World(), 0.0
    given_up: list[ProcessExit] = []
    while not given_up:
        world.reviver.add(death())
        given_up = world.reviver.update(now_s)
        world.reviver.update(now_s := now_s + 5.0)
    assert sum(line.startswith("hold") for line in world.did) == DEATH_LIMIT
    assert sum(line.startswith("start") for line in world.did) == DEATH_LIMIT - 1
    assert world.did[-1] == (
        "wrench died 5 times within 60 s and is not restarted; the arm stays held. Last: "
        "killed by SIGKILL. Remove the cause, stop this with Ctrl-C, and restart `forcemesh up`"
    )


# --- the supervisor, with small processes ---------------------------------------------------------


@pytest.mark.processes
def test_a_killed_process_is_there_again_and_the_run_file_says_what_was(cell: CellConfig) -> None:
    """Another pid in the same place, the others as before; status tells how the first one ended."""
    processes = [python("wrench", SLEEPER), python("robot", SLEEPER)]
    with Supervisor(cell, DEMO, processes=processes) as supervisor:
        supervisor.enable_restarts()
        stays, victim = pids_of(cell)
        os.kill(victim, signal.SIGKILL)

        def is_back() -> bool:
            supervisor.restart_exited()
            return victim not in pids_of(cell)

        until(is_back)
        assert stays in pids_of(cell)
        run = read_run(cell.cell)
        assert run is not None
        entry = run.entry("robot")
        assert entry is not None
        assert entry.alive
        assert entry.ended is None
        (restart,) = restarts_of(run)
        assert died_text(restart).startswith("robot: killed by SIGKILL at 2")
        assert not supervisor.died
    assert read_run(cell.cell) is None  # it ended well


@pytest.mark.processes
def test_one_that_dies_at_once_over_and_over_does_not_take_the_others_with_it(
    cell: CellConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is given up and said so; what else runs goes on, for status and for the hold."""
    monkeypatch.setattr("launch.restart.RESTART_PAUSE_S", 0.01)
    said: list[str] = []
    broken = "import sys; print('no sensor'); sys.exit(3)"
    processes = [python("wrench", SLEEPER), python("robot", broken)]
    with Supervisor(
        cell, DEMO, processes=processes[:1], write_line=lambda _, line: said.append(line)
    ) as supervisor:
        supervisor.enable_restarts()
        supervisor.begin(processes[1])

        def is_given_up() -> bool:
            supervisor.restart_exited()
            return bool(supervisor.died)

        until(is_given_up)
        assert any("robot died 5 times within 60 s" in line for line in said)
        assert any("exit code 3, no sensor" in line for line in said)
        run = read_run(cell.cell)
        assert run is not None
        stays, gone = run.entry("wrench"), run.entry("robot")
        assert stays is not None
        assert stays.alive
        assert gone is not None
        assert gone.ended is not None
        assert len(gone.deaths) == DEATH_LIMIT - 1
