"""Processes of a cell: table of role implementations, and the supervisor of the processes."""

import math
import signal
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import dump_cell
from common.runtime.stop import StopSignal
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.client.roles import HEALTH_POLL_S
from forcemesh.errors import BusError, ForcemeshError
from forcemesh.messages import MAY_MOVE
from forcemesh.requests import HoldRequest
from forcemesh.zenoh_settings import endpoint_of
from launch.cell_view import CellView
from launch.controller_program import program_file, write_program
from launch.restart import RESTART_PAUSE_S, Restarter
from launch.run_file import new_run, read_run, writable_folder, write_atomically
from launch.started_process import (
    ChildProcess,
    ProcessExit,
    ProcessSpec,
    WriteLine,
    write_stderr_line,
)

# The sensor `sim` with a gateway is on the arm of the emulated controller, which executes the
# program that users load into theirs.
EMULATOR = "sim.controller"
SHARED = "launch.together"
SUPERVISOR_POLL_S = 0.05
# Long, for a busy machine: a process that cannot start dies, which ends the wait at once.
UP_WITHIN_S = 120.0
HUB_SLOW_S = 10.0
ASK_WITHIN_S = 0.5
HOLD_WITHIN_S = 1.0
STOP_WITHIN_S = 3.0
LINGER_S = 5.0  # of a cell that was never ready
HUB_LAST_S = 0.5  # of those, reserved for the hub, which ends last
HELD = ("HOLDING", "FAULT", "BOOT")  # states of the arbiter after a hold


def processes_of(cell: CellConfig) -> tuple[ProcessSpec, ...]:
    """Return the processes of a cell in start order; one may implement several roles."""
    roles_of: dict[str, tuple[str, ...]] = {}
    for row in topics.ROLE_TABLE:
        module = row.modules[getattr(cell.roles, row.name, "")]
        if row.name == "sensor" and cell.roles.sensor == "sim" and cell.roles.robot == "gateway":
            module = EMULATOR
        if row.name in cell.together:
            module = SHARED
        if module is not None and not row.is_helper:
            roles_of[module] = (*roles_of.get(module, ()), row.name)
        if row.name == "hub" and cell.sim is not None and cell.sim.netft:
            # It implements no role of the bus: gateway and driver reach it over TCP and UDP.
            roles_of[EMULATOR] = ("controller",)
    arguments = {EMULATOR: (program_file(cell),), SHARED: cell.together}
    return tuple(
        ProcessSpec(module, roles, arguments=arguments.get(module, ()))
        for module, roles in roles_of.items()
    )


class Supervisor:
    """Supervisor of a cell: starts the processes, detects deaths, stops all; a context manager.

    Used in one thread, which lives as long as the cell: the processes die with it. Deaths are
    detected in `died` and `restart_exited`, to be read often.
    """

    def __init__(
        self,
        cell: CellConfig,
        cell_file: Path | None = None,
        *,
        processes: Sequence[ProcessSpec] | None = None,
        stop: StopSignal | None = None,
        write_line: WriteLine = write_stderr_line,
    ) -> None:
        """Prepare. Without a cell file the cell is written next to the run file."""
        self._died: list[ProcessExit] = []
        self._to_restart: list[ProcessExit] = []
        self._reported_pids: set[int] = set()
        self.cell_file = (cell_file or writable_folder() / f"{cell.cell}.yaml").resolve()
        self.run = new_run(cell, self.cell_file)
        self._cell = cell
        self._is_file_generated = cell_file is None
        self._processes = processes_of(cell) if processes is None else tuple(processes)
        self._stop = stop or StopSignal()
        self._write_line = write_line
        self._running: list[ChildProcess] = []
        self._is_stopped = False
        self._exits = ExitStack()
        self._client: Bus | None = None
        self._view: CellView | None = None
        pause_s = max(RESTART_PAUSE_S, cell.stale_after_s(topics.ROBOT_COMMAND))
        self._restarter = Restarter(self._start_again, self._hold, write_line, pause_s)
        self._is_restarting = False

    # --- start and stop ---------------------------------------------------------------------------

    def __enter__(self) -> "Supervisor":
        """Start everything, the hub first.

        Raises:
            ForcemeshError: The cell is already up, or its hub did not start.
        """
        before = read_run(self._cell.cell)
        if before is not None and before.live:
            raise ForcemeshError(
                f"cell {self._cell.cell} is already up (pid {before.supervisor_pid}, "
                f"since {before.started_at}): stop that one first"
            )
        if self._is_file_generated:
            write_atomically(self.cell_file, dump_cell(self._cell))
        write_program(self._cell)
        self._stop_on_sigterm()
        try:
            for process in self._processes:
                self._raise_death()
                pid = self.begin(process)
                if "hub" in process.roles:
                    self._connect(pid)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop everything."""
        self.stop()

    def stop(self) -> None:
        """Hold the arm if it may move, end every process, keep the run file only after a death."""
        if self._is_stopped:
            return
        self._note_exits()
        if self._last_state() in MAY_MOVE and not self._has_exited("hub", "arbiter"):
            self._hold("the cell is being stopped")
        self._is_stopped = True
        self._exits.close()
        hubs = [running for running in self._running if "hub" in running.process.roles]
        helpers = [running for running in self._running if running.process.is_helper]
        others = [running for running in self._running if running not in (*hubs, *helpers)]
        give_up_s = time.monotonic() + STOP_WITHIN_S
        _end_all(others, give_up_s - HUB_LAST_S)
        _end_all(hubs, give_up_s)
        _end_all(helpers, time.monotonic() + STOP_WITHIN_S)
        if self._died:
            self.run.end()
        else:
            self.run.remove()

    # --- while it is up ---------------------------------------------------------------------------

    @property
    def died(self) -> list[ProcessExit]:
        """Processes that have died until now and are not restarted; no helpers."""
        self._note_exits()
        return self._died

    def missing(self) -> list[str]:
        """Return why the cell is not ready, and record the arbiter's state."""
        if self._view is None:
            return ["no hub among the processes"]
        self._last_state()
        return self._view.missing()

    def wait_ready(self, timeout_s: float = UP_WITHIN_S) -> None:
        """Wait until every role's health is fresh and the arbiter is past BOOT.

        Raises:
            ForcemeshError: A process died, or the timeout has passed; names what is missing.
        """
        give_up_s = time.monotonic() + timeout_s
        while lines := self.missing():
            self._raise_death()
            if self._stop.is_set():
                raise ForcemeshError("stopped while the cell was starting")
            if time.monotonic() >= give_up_s:
                raise ForcemeshError(f"not ready after {timeout_s:g} s: {'; '.join(lines)}")
            time.sleep(HEALTH_POLL_S)
        self._raise_death()

    def enable_restarts(self) -> None:
        """Restart what dies from now on, in `update`: the cell was ready once."""
        self._is_restarting = True

    def start_helpers(self, names: Iterable[str]) -> None:
        """Start panel or helpers, which are restarted in `restart_exited` and end last."""
        for name in names:
            self.begin(ProcessSpec(f"services.{name}", (name,), is_helper=True))

    def restart_exited(self) -> None:
        """Restart what has died; to be called often.

        A process that is given up is in `died` from then on, and the others stay up.
        """
        self._note_exits()
        new, self._to_restart = self._to_restart, []
        self._died += self._restarter.update(time.monotonic(), new)

    def hold_after_death(self, linger_s: float | None) -> None:
        """After a death: request a hold, and keep the rest up so that status can be used.

        Without a time they stay up until this is stopped, if the cell was ready once.
        """
        give_up_s = time.monotonic() + 2 * SUPERVISOR_POLL_S
        while not self.died and time.monotonic() < give_up_s:
            time.sleep(HEALTH_POLL_S)
        self._write_line("up", self._hold("; ".join(str(died) for died in self.died) or "stopped"))
        if linger_s is None:
            linger_s = math.inf if self._is_restarting else LINGER_S
        if linger_s > 0.0 and self.died:
            until = "until Ctrl-C" if math.isinf(linger_s) else f"for {linger_s:g} s"
            self._write_line("up", f"the others stay up {until}: see `forcemesh status`")
            give_up_s = time.monotonic() + linger_s
            with suppress(KeyboardInterrupt):  # ends the waiting; the failure is still reported
                while not self._stop.wait(SUPERVISOR_POLL_S) and time.monotonic() < give_up_s:
                    self.restart_exited()

    # --- inside -----------------------------------------------------------------------------------

    def _stop_on_sigterm(self) -> None:
        """Let SIGTERM unwind a program without a handler of its own, which stops the cell."""
        is_main = threading.current_thread() is threading.main_thread()
        if is_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
            self._exits.callback(signal.signal, signal.SIGTERM, signal.SIG_DFL)

    def begin(self, process: ProcessSpec) -> int:
        """Start a process; return its pid."""
        running = ChildProcess(process, self.cell_file, self._write_line)
        self.run.add_process(process, running.pid)
        self._running = [*self._running, running]
        return running.pid

    def _start_again(self, died: ProcessExit) -> int:
        """Restart a process that died; return its pid."""
        for running in self._running:
            if running.pid == died.pid:
                running.finish(0.0)
        self._running = [running for running in self._running if running.pid != died.pid]
        return self.begin(died.process)

    def _connect(self, hub_pid: int) -> None:
        """Wait until the own hub responds; with another hub at the endpoint two cells would mix."""
        endpoint, began_s, is_slow_reported = endpoint_of(self._cell), time.monotonic(), False
        while True:
            self._raise_death()
            if self._stop.is_set():
                raise ForcemeshError("stopped while the hub was starting")
            if self._view is None:
                with suppress(BusError):
                    client = self._exits.enter_context(
                        open_bus(self._cell, topics.CLIENT, patience_s=0.0)
                    )
                    self._client, self._view = client, CellView(client, self._cell)
            elif self._view.pid("hub") == hub_pid:
                return
            elapsed_s = time.monotonic() - began_s
            if elapsed_s >= UP_WITHIN_S:
                raise ForcemeshError(f"the hub at {endpoint} did not respond in {UP_WITHIN_S:g} s")
            if elapsed_s >= HUB_SLOW_S and not is_slow_reported:
                is_slow_reported = True
                self._write_line(
                    "up", f"after {elapsed_s:.0f} s still waiting for the hub at {endpoint}"
                )
            time.sleep(HEALTH_POLL_S)

    def _note_exits(self) -> None:
        """Record and report new deaths, until the cell is stopped."""
        if self._is_stopped:
            return
        for running in self._running:
            died = None if running.pid in self._reported_pids else running.ended()
            if died is None:
                continue
            self._reported_pids.add(running.pid)
            self.run.add_exit(died)
            self._write_line("up", f"died: {died}")
            if self._is_restarting or died.process.is_helper:
                self._to_restart.append(died)
            else:
                self._died.append(died)

    def _last_state(self) -> str:
        """Return the arbiter's state as last received."""
        if self._view is not None and (status := self._view.arbiter().message) is not None:
            self.run.set_state(status.state)
            return status.state
        return ""

    def _has_exited(self, *roles: str) -> bool:
        ended = [each.process for each in self._running if each.ended() is not None]
        return any(role in process.roles for process in ended for role in roles)

    def _raise_death(self) -> None:
        if self.died:
            raise ForcemeshError("; ".join(str(died) for died in self.died))

    def _hold(self, reason: str) -> str:
        """Request a hold and wait until the arbiter reports it; return the outcome."""
        if self._client is None or self._view is None or self._has_exited("hub", "arbiter"):
            limit_ms = 1e3 * self._cell.stale_after_s(topics.ROBOT_COMMAND)
            return f"no arbiter is reachable: the robot holds by itself within {limit_ms:.0f} ms"
        try:
            reply = self._client.ask(topics.HOLD, HoldRequest(reason=reason[:400]), ASK_WITHIN_S)
        except ForcemeshError as error:
            return f"hold was requested: {error}"
        self._view.wait(lambda: self._last_state() in HELD, HOLD_WITHIN_S)
        return f"hold was requested: {reply.text}; the arbiter is {self._last_state()}"[:300]


def _end_all(processes: list[ChildProcess], give_up_s: float) -> None:
    """Send SIGTERM to all, and kill what has not ended by then (monotonic time [s])."""
    for running in processes:
        running.terminate()
    for running in processes:
        running.finish(give_up_s - time.monotonic())
