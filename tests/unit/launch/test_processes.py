"""Process table of a cell, and the supervisor with small processes of the test itself."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest

from common.config.cell import CellConfig, RolesSection
from common.config.load import load_cell
from forcemesh.errors import ForcemeshError
from forcemesh.topics import ROLE_TABLE, Role
from launch import processes
from launch.processes import Supervisor, processes_of
from launch.run_file import FOLDER_VARIABLE, is_alive, read_run
from launch.started_process import ProcessSpec
from tests.fakes.bench import DEMO
from tools.tree import ROOT

PATIENCE_S = 20.0  # limit of the test's waits, for a loaded machine
GATEWAY = {"roles.robot": "gateway", "gateway": {}, "roles.sensor": "driver"}

pytestmark = pytest.mark.processes


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A cell whose run files belong to this test only."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    return load_cell(DEMO, {"cell": "unit"})


def python(name: str, program: str) -> ProcessSpec:
    """Return a process that runs a small program under the name of a role."""
    return ProcessSpec("test.program", (name,), (sys.executable, "-c", program))


SLEEPER = "import time; print('up', flush=True); time.sleep(600)"
STUBBORN = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {SLEEPER}"


def until(condition: Callable[[], object]) -> None:
    """Wait until a condition is true; fail after PATIENCE_S."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "the condition did not become true in time"
        time.sleep(0.005)


def pids_of(cell: CellConfig) -> list[int]:
    """Return the processes that the run file names."""
    run = read_run(cell.cell)
    return [entry.pid for entry in run.processes] if run else []


@pytest.mark.parametrize(
    ("overrides", "robot", "sensor"),
    [
        ({}, "sim.robot", "sim.robot"),
        (GATEWAY, "services.gateway", "services.sensor"),
        ({**GATEWAY, "roles.sensor": "external"}, "services.gateway", None),
        ({"roles.robot": "external", "roles.sensor": "external"}, None, None),
    ],
)
def test_every_role_is_run_by_the_process_that_the_cell_names(overrides, robot, sensor) -> None:
    """The cell file selects the modules of robot and sensor; the other roles are fixed."""
    processes = processes_of(load_cell(DEMO, overrides))
    modules = {role: process.module for process in processes for role in process.roles}
    fixed = {role: f"services.{role}" for role in ("hub", "arbiter", "regulator", "wrench")}
    started = {role: module for role, module in (("robot", robot), ("sensor", sensor)) if module}
    assert modules == fixed | started
    assert processes[0].module == "services.hub"


def test_neighbours_may_share_a_process() -> None:
    """As the cell file says; it is named by the first, and the others have one each."""
    processes = processes_of(load_cell(DEMO, {"together": ["wrench", "regulator"]}))
    assert [(each.module, each.roles) for each in processes] == [
        ("services.hub", ("hub",)),
        ("sim.robot", ("robot", "sensor")),
        ("launch.together", ("wrench", "regulator")),
        ("services.arbiter", ("arbiter",)),
    ]


def test_the_table_has_every_role_and_only_runnable_modules() -> None:
    """A role without a row, or a row without a program, would fail only at start."""
    modules = {module for row in ROLE_TABLE for module in row.modules.values() if module}
    assert [m for m in modules if importlib.util.find_spec(f"{m}.__main__") is None] == []


@pytest.mark.parametrize("row", ROLE_TABLE, ids=lambda row: row.name)
def test_the_cell_file_offers_the_implementations_of_the_table(row: Role) -> None:
    """A role with several implementations is a field of the section `roles`, with these words."""
    field = RolesSection.model_fields.get(row.name)
    assert tuple(row.modules) == (("",) if field is None else get_args(field.annotation))


def test_a_killed_process_is_named_with_its_signal_and_none_is_left(cell: CellConfig) -> None:
    """Supervisor and run file, also after the end; each process has its own group."""
    both = [python("wrench", SLEEPER), python("robot", SLEEPER)]
    with Supervisor(cell, DEMO, processes=both) as supervisor:
        pids = pids_of(cell)
        assert [os.getpgid(pid) for pid in pids] == pids
        assert {os.getsid(pid) for pid in pids} == {os.getsid(0)}
        victim = pids[1]
        os.kill(victim, signal.SIGKILL)
        until(lambda: supervisor.died)
        assert [str(died) for died in supervisor.died] == [
            f"robot (test.program, pid {victim}): killed by SIGKILL"
        ]
    assert not any(is_alive(pid, None) for pid in pids)
    run = read_run(cell.cell)
    assert run is not None
    assert not run.live
    assert run.ended_at is not None
    assert {e.roles[0]: e.ended and e.ended.how for e in run.processes} == {
        "wrench": None,
        "robot": "killed by SIGKILL",
    }


def test_an_exited_process_is_named_with_its_code_and_last_output(cell: CellConfig) -> None:
    """The last output gives the cause of the exit; its lines carry the role, of either stream."""
    output: list[tuple[str, str]] = []
    program = "import sys; print('no such file', file=sys.stderr); sys.exit(2)"
    wrench = [python("wrench", program)]
    with Supervisor(
        cell, DEMO, processes=wrench, write_line=lambda *pair: output.append(pair)
    ) as supervisor:
        until(lambda: supervisor.died)
    assert str(supervisor.died[0]).endswith("exit code 2, last output: no such file")
    assert ("wrench", "no such file") in output


def test_an_exit_while_waiting_for_hub_or_readiness_ends_the_wait(cell: CellConfig) -> None:
    """Long before the limit for a slow hub; the error names the exited process."""
    began_s = time.monotonic()
    with (
        pytest.raises(ForcemeshError, match=r"hub .*exit code 3"),
        Supervisor(cell, DEMO, processes=[python("hub", "raise SystemExit(3)")]),
    ):
        pass
    assert time.monotonic() - began_s < processes.UP_WITHIN_S / 2.0
    wrench = [python("wrench", "raise SystemExit(3)")]
    with (
        Supervisor(cell, DEMO, processes=wrench) as supervisor,
        pytest.raises(ForcemeshError, match=r"wrench .*exit code 3"),
    ):
        supervisor.wait_ready(PATIENCE_S)


def test_a_hub_that_never_responds_ends_the_wait(cell: CellConfig, monkeypatch) -> None:
    """Its process is alive but does not respond: the error gives the address."""
    monkeypatch.setattr(processes, "UP_WITHIN_S", 0.3)
    with (
        pytest.raises(ForcemeshError, match=r"the hub at tcp/.* did not respond in 0"),
        Supervisor(cell, DEMO, processes=[python("hub", SLEEPER)]),
    ):
        pass


def test_a_process_that_will_not_end_is_killed_with_its_children(cell: CellConfig) -> None:
    """SIGTERM first, then SIGKILL for the whole group: no orphans."""
    output: list[str] = []
    parent = (
        "import subprocess, sys; "
        f"child = subprocess.Popen([sys.executable, '-c', {SLEEPER!r}], stdout=sys.stderr); "
        f"print(child.pid, flush=True); {STUBBORN}"
    )
    with Supervisor(
        cell,
        DEMO,
        processes=[python("wrench", parent)],
        write_line=lambda _, line: output.append(line),
    ):
        until(lambda: len(output) == 3)
        child = next(int(line) for line in output if line.isdigit())
        pids = [*pids_of(cell), child]
        assert all(is_alive(pid, None) for pid in pids)
    until(lambda: not any(is_alive(pid, None) for pid in pids))


def test_processes_end_with_a_killed_supervisor(cell: CellConfig) -> None:
    """After kill -9 of the supervisor no process is left, and the run is not live."""
    program = f"""
import sys, time
from pathlib import Path
from typing import get_args
from launch.processes import Supervisor
from launch.started_process import ProcessSpec
from common.config.load import load_cell
sleeper = ProcessSpec("test.program", ("robot",), (sys.executable, "-c", {STUBBORN!r}))
with Supervisor(load_cell({str(DEMO)!r}, {{"cell": "unit"}}), Path({str(DEMO)!r}),
                processes=[sleeper, sleeper]):
    time.sleep(600)
"""
    supervisor = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT)
    try:
        until(lambda: len(pids_of(cell)) == 2)
        pids = pids_of(cell)
        assert all(is_alive(pid, None) for pid in pids)
    finally:
        supervisor.kill()
        supervisor.wait()
    until(lambda: not any(is_alive(pid, None) for pid in pids))
    run = read_run(cell.cell)
    assert run is not None
    assert not run.live


def test_a_running_cell_is_not_started_again(cell: CellConfig) -> None:
    """Two supervisors of one cell would be two commanders; the error names the first one."""
    with (
        Supervisor(cell, DEMO, processes=[python("wrench", SLEEPER)]),
        pytest.raises(ForcemeshError, match=f"already up .pid {os.getpid()}"),
        Supervisor(cell, DEMO, processes=[python("wrench", SLEEPER)]),
    ):
        pass


def test_a_helper_that_dies_is_restarted_and_its_death_recorded(cell: CellConfig) -> None:
    """Also in a cell that is not restarted: a scenario continues without its panel."""
    panel = ProcessSpec("test.program", ("panel",), (sys.executable, "-c", SLEEPER), is_helper=True)

    def deaths() -> int:
        supervisor.restart_exited()
        run = read_run(cell.cell)
        entry = run.entry("panel") if run else None
        return len(entry.deaths) if entry else 0

    with Supervisor(cell, DEMO, processes=[panel]) as supervisor:
        os.kill(pids_of(cell)[0], signal.SIGKILL)
        until(deaths)
        assert supervisor.died == []
        (pid,) = pids_of(cell)
        assert is_alive(pid, None)
    assert not is_alive(pid, None)
