"""Restart of exited processes: the arm is held, and the number of restarts is limited."""

import signal

from hypothesis import given
from hypothesis import strategies as st

from launch.processes import Supervisor
from launch.restart import DEATH_LIMIT, DEATH_WINDOW_S, RESTART_PAUSE_S, Restarter
from launch.started_process import ProcessExit, ProcessSpec
from tests.fakes.bench import CELL

EXITED = (ProcessSpec("services.wrench", ("wrench",)), ProcessSpec("services.hub", ("hub",)))


def killed(process: ProcessSpec = EXITED[0], pid: int = 1) -> ProcessExit:
    """Return the exit of a process by kill -9."""
    return ProcessExit(process, pid, -int(signal.SIGKILL))


# --- how often ------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.0, 300.0), max_size=60))
def test_restarts_within_a_window_are_limited(times_s: list[float]) -> None:
    """For any exit times: the last of DEATH_LIMIT exits within a window is not restarted."""
    restarter, started = World().restarter, []
    for now_s in sorted(times_s):
        if (due_s := restarter.restart_time_s("wrench", now_s)) is not None:
            assert now_s + RESTART_PAUSE_S <= due_s < now_s + DEATH_WINDOW_S
            started.append(now_s)
    for first, last in zip(started, started[DEATH_LIMIT - 1 :], strict=False):
        assert last - first >= DEATH_WINDOW_S


def test_the_pause_doubles_with_each_restart_separately_for_each_process() -> None:
    """Container engines do the same; an hour later the pause is the first one again."""
    restarter = World().restarter
    pauses = [(restarter.restart_time_s("wrench", 0.0) or 0.0) for _ in range(DEATH_LIMIT - 1)]
    assert pauses == [RESTART_PAUSE_S * 2.0**n for n in range(DEATH_LIMIT - 1)]
    assert restarter.restart_time_s("wrench", 0.0) is None
    assert restarter.restart_time_s("hub", 0.0) == RESTART_PAUSE_S
    assert restarter.restart_time_s("wrench", 3600.0) == 3600.0 + RESTART_PAUSE_S


def test_no_process_restarts_before_the_robot_holds() -> None:
    """With a long deadline, a hub that restarted within 0.2 s once left the arm moving."""
    slow = CELL.model_copy(
        update={"deadlines": CELL.deadlines.model_copy(update={"command_s": 0.7})}
    )
    supervisor = Supervisor(slow)
    supervisor.enable_restarts()
    assert supervisor._restarter.restart_time_s("hub", 10.0) == 10.7


# --- hold and restart, on a clock of the test itself ----------------------------------------------


class World:
    """A supervisor that records hold, start and output."""

    def __init__(self) -> None:
        """Record from now on."""
        self.log: list[str] = []
        self.restarter = Restarter(
            start=self.start, hold=self.hold, write_line=lambda _, text: self.write(text)
        )

    def start(self, died: ProcessExit) -> int:
        """Start a process in place of an exited one."""
        self.log.append(f"start {died.process.name} for {died.pid}")
        return died.pid + 1

    def hold(self, reason: str) -> str:
        """Request a hold."""
        self.log.append(f"hold: {reason}")
        return "held"

    def write(self, text: str) -> None:
        """Output a line."""
        self.log.append(text)


def test_the_hold_precedes_the_restart_and_the_message_gives_the_next_step() -> None:
    """The restart waits for its pause; messages give the process, the cause and the next step."""
    world = World()
    assert world.restarter.update(10.0, [killed()]) == []
    assert "killed by SIGKILL" in world.log[0]
    assert world.log[0].startswith("hold: died: wrench")
    world.restarter.update(10.0 + 0.9 * RESTART_PAUSE_S)
    assert len(world.log) == 2
    world.restarter.update(10.0 + RESTART_PAUSE_S)
    assert world.log[2] == "start wrench for 1"
    assert "`forcemesh clear`, then `forcemesh arm`" in world.log[3]
    world.restarter.update(1000.0)
    assert len(world.log) == 4


def test_after_repeated_exits_restarting_stops_with_one_message() -> None:
    """The message gives count, cause and remedy; each exit causes a hold."""
    world, now_s = World(), 0.0
    given_up: list[ProcessExit] = []
    while not given_up:
        given_up = world.restarter.update(now_s, [killed()])
        world.restarter.update(now_s := now_s + 5.0)
    assert sum(line.startswith("hold") for line in world.log) == DEATH_LIMIT
    assert sum(line.startswith("start") for line in world.log) == DEATH_LIMIT - 1
    assert world.log[-1] == (
        "wrench died 5 times within 60 s and is not restarted; the arm stays held. Last: "
        "killed by SIGKILL. Remove the cause, stop this with Ctrl-C, and restart `forcemesh up`"
    )


def test_a_helper_that_dies_holds_nothing_and_the_cell_continues_without_it() -> None:
    """It is restarted like the others, but not when it has reported why it cannot run."""
    world = World()
    panel = ProcessSpec("services.panel", ("panel",), is_helper=True)
    world.restarter.update(0.0, [killed(panel)])
    world.restarter.update(RESTART_PAUSE_S)
    assert world.log[0] == "start panel for 1"
    assert "clear" not in world.log[1]
    assert world.restarter.update(RESTART_PAUSE_S, [ProcessExit(panel, 2, 2)]) == []
    assert world.log[2:] == ["panel is not running: exit code 2; the cell continues without it"]
