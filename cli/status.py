"""Status of a cell, from its bus and from the run file of its supervisor."""

import time
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TypedDict

from cli.arm_readings import ArmReadings, ArmView, no_readings
from cli.context import NO_ANSWER, NOT_WELL, OK
from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.errors import BusError, SetupError
from forcemesh.identity import folder_of, is_encrypted
from forcemesh.messages import ArbiterStatus, Health
from launch.cell_view import CellView
from launch.run_file import ProcessRecord, Run

# In --json alone: shown elsewhere, or for a long test.
FOR_PROGRAMS = ("processor_fraction", "put_max_s", "tare_age_h")
# Of numbers whose names do not say it; of the others the name itself is the text.
NUMBER_TEXTS = {
    "framed_round_trip_p50": "network round trip (median)",
    "framed_round_trip_p99": "network round trip (99 %)",
    "taken_round_trip_p50": "round trip with the robot program (median)",
    "taken_round_trip_p99": "round trip with the robot program (99 %)",
    "streamed_round_trip_p50": "round trip of set points (median)",
    "program_loop": "cycles of the robot program",
    "sender": "reports of the controller",
    "loop_delay": "delay of the force loop",
    "loop_delay_model": "by the cell file",
    "gain": "gains in use",
}
DOWN = "DOWN"
STOPPED, ASKED = ("STOPPING", "HOLDING"), "hold"
CONNECT_WITHIN_S = 0.5


class ServiceStatus(TypedDict):
    """Status of one role."""

    name: str
    pid: int | None
    alive: bool
    rate_hz: float | None
    age_s: float | None
    fault: str
    late: str  # how often and why its loop was late within the last second, empty if it was not
    numbers: dict[str, float]  # measured by the role, from its health


class Restart(TypedDict):
    """Process that has died since the start of the cell and was restarted."""

    name: str
    times: int
    how: str  # the last time: killed by SIGKILL
    at: str


class CellStatus(TypedDict):
    """Output of `forcemesh status --json`."""

    cell: str
    state: str
    commander: str
    trips: list[dict[str, object]]
    not_ready: list[str]
    clears: str
    last_state: str
    arm: ArmReadings
    restarts: list[Restart]
    services: list[ServiceStatus]


def cell_status(cell: CellConfig, run: Run | None, only: str | None = None) -> CellStatus:
    """Return the status of a cell, also when no hub responds.

    Args:
        cell: The cell.
        run: Run file of its supervisor, if there is one.
        only: The only role to wait for; default: all.
    """
    expected = {only} if only else {role for role in topics.ROLES if not _has_died(role, run)}
    try:
        with open_bus(cell, topics.CLIENT, patience_s=CONNECT_WITHIN_S) as bus:
            view, arm = CellView(bus, cell), None if only else ArmView(bus, cell)
            started_s = time.monotonic()
            needs_state = expected == set(topics.ROLES)
            view.wait(
                lambda: (
                    _is_received(view, expected)
                    and not (needs_state and view.arbiter().fresh is None)
                ),
                view.longest_wait_s,
            )
            if arm is not None:  # also every helper
                view.wait(
                    lambda: _is_received(view, topics.HELPERS) and arm.is_complete(),
                    view.helper_wait_s,
                )
            waited_s = time.monotonic() - started_s
            return _cell_status(cell, run, view, arm, waited_s=waited_s, only=only)
    except SetupError:
        raise
    except BusError:
        return _cell_status(cell, run, None, None, waited_s=0.0, only=only)


def died_text(restart: Restart) -> str:
    """Return the text for a process that was restarted."""
    times = f", {restart['times']} times so far" if restart["times"] > 1 else ""
    return f"{restart['name']}: {restart['how']} at {restart['at']}{times}; restarted"


def describe_number(name: str, number: float) -> str:
    """Return a number of a health message as text, in the unit that its name ends with."""
    for ending, scale, unit in (
        ("_s", 1e3, "ms"),
        ("_h", 1.0, "h"),
        ("_hz", 1.0, "/s"),
        ("_fraction", 100.0, "%"),
    ):
        if name.endswith(ending):
            quantity = name.removesuffix(ending)
            text = NUMBER_TEXTS.get(quantity, quantity.replace("_", " "))
            return f"{text} {scale * number:.1f} {unit}"
    return f"{name} {number:.6g}"


def late_text(health: Health) -> str:
    """Return how often a loop was late within the last second, and why; empty if it was not."""
    if not health.overruns:
        return ""
    times = f"late {health.overruns} times within a second, by {1e3 * health.longest_gap_s:.0f} ms"
    return f"{times}: {health.late_cause}" if health.late_cause else times


def is_well(status: CellStatus) -> bool:
    """Return whether all roles are alive and without fault; a requested hold is no fault."""
    stopped = status["state"] in STOPPED and any(t["code"] != ASKED for t in status["trips"])
    is_faulty = stopped or status["state"] in (DOWN, "FAULT")
    return not is_faulty and all(row["alive"] and not row["fault"] for row in status["services"])


def exit_code(status: CellStatus) -> int:
    """Return the exit code of `status`: without faults, with faults, or cell not up."""
    if is_well(status):
        return OK
    is_down = status["state"] == DOWN and not any(row["alive"] for row in status["services"])
    return NO_ANSWER if is_down else NOT_WELL


def _is_received(view: CellView, names: Iterable[str]) -> bool:
    """Return whether the health of all named processes was received."""
    return all(view.health(name).message is not None for name in names)


def _cell_status(
    cell: CellConfig,
    run: Run | None,
    view: CellView | None,
    arm: ArmView | None,
    *,
    waited_s: float,
    only: str | None,
) -> CellStatus:
    listed = {only, *helpers_of(view, run)}
    helpers = [name for name in topics.HELPERS if name in listed]
    fresh = None if view is None else view.arbiter().fresh
    arbiter = fresh or ArbiterStatus()
    services = [_service(name, run, view, waited_s) for name in (*topics.ROLES, *helpers)]
    _name_certificates(cell, [row for row in services if not row["alive"]])
    return CellStatus(
        cell=cell.cell,
        state=DOWN if fresh is None else fresh.state,
        commander=arbiter.commander,
        trips=[trip.as_dict() for trip in arbiter.trips],
        not_ready=list(arbiter.not_ready),
        clears=arbiter.clears,
        last_state=run.last_state if run else "",
        arm=no_readings()
        if view is None or arm is None
        else arm.readings(view.fresh_health("wrench")),
        restarts=restarts_of(run),
        services=services,
    )


def _name_certificates(cell: CellConfig, silent: list[ServiceStatus]) -> None:
    """Add certificate errors of silent roles, for certificates on this machine."""
    if not silent or not is_encrypted(cell.bus.endpoint):
        return
    from common.security.pki_check import check_folder

    findings = check_folder(folder_of(cell), cell.cell, datetime.now(UTC))
    found = {finding.name: finding for finding in findings if finding.verdict == "wrong"}
    for row in silent:
        if wrong := found.get(row["name"]):
            row["fault"] += f"; its certificate: {wrong.text} ({wrong.remedy})"


def restarts_of(run: Run | None) -> list[Restart]:
    """Return the restarts by a supervisor that still runs."""
    entries = run.processes if run is not None and run.live else []
    return [
        Restart(name=" and ".join(entry.roles), times=len(entry.deaths), how=last.how, at=last.at)
        for entry in entries
        for last in entry.deaths[-1:]
    ]


def helpers_of(view: CellView | None, run: Run | None) -> tuple[str, ...]:
    """Return the helpers that publish health, or that a running supervisor has started."""
    started = run if run is not None and run.live else None
    return tuple(
        name
        for name in topics.HELPERS
        if (view is not None and _is_received(view, [name])) or (started and started.entry(name))
    )


def _service(role: str, run: Run | None, view: CellView | None, waited_s: float) -> ServiceStatus:
    entry = run.entry(role) if run else None
    ended = "" if run is None or entry is None else _exit_cause(run, entry)
    process = "" if entry is None else f"process {entry.pid} runs, but "
    row = ServiceStatus(
        name=role,
        pid=entry.pid if entry else None,
        alive=False,
        rate_hz=None,
        age_s=None,
        fault=ended or f"{process}no hub responds",
        late="",
        numbers={},
    )
    if view is None:
        return row
    reading = view.health(role)
    message = reading.message
    if message is not None:
        row["age_s"] = round(reading.age_s, 3)
    if isinstance(message, Health):
        row["pid"], row["rate_hz"] = message.pid, round(message.rate_hz, 1)
        row["numbers"] = {} if reading.fault else message.numbers
        row["late"] = "" if reading.fault else late_text(message)
    row["alive"] = not reading.fault and not _has_died(role, run)
    if row["alive"]:
        row["fault"] = message.fault if isinstance(message, Health) else ""
    else:
        silent_s = waited_s if message is None else reading.age_s
        row["fault"] = ended or f"{process}no health for {silent_s:.1f} s"
    return row


def _has_died(role: str, run: Run | None) -> bool:
    """Return whether a running supervisor saw this role die; its last health may still be fresh.

    Deaths in an ended run do not apply to a cell that is up now.
    """
    entry = run.entry(role) if run is not None and run.live else None
    return entry is not None and entry.ended is not None


def _exit_cause(run: Run, entry: ProcessRecord) -> str:
    """Return how a process ended, from the run file and the kernel; empty if unknown."""
    if entry.ended is not None:
        return entry.ended.how
    if entry.alive:
        return ""
    causes = [
        f"{other.roles[0]}: {other.ended.how}"
        for other in run.processes
        if other.ended and not other.is_helper
    ]
    if run.ended_at is not None and causes:
        return f"stopped because of {', '.join(causes)}"
    return (
        f"process {entry.pid} does not exist any more" if run.live else "ended with its supervisor"
    )
