"""Checks of a cell by `forcemesh doctor`, from the findings on its link or its bus."""

import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from operator import or_
from typing import Any

import pinocchio as pin

from cli.doctor.checks import (
    SLOW_BELOW,
    ReportLine,
    check_address,
    check_arm,
    check_error_code,
    check_goodbye,
    check_hello,
    check_loop_delay,
    check_loops,
    check_monitor_speed,
    check_peer,
    check_plain,
    check_protocol,
    check_role,
    check_round_trip,
    check_scales,
    check_sender,
    check_serial,
    check_status,
    check_stream,
    finding,
    passed,
    skipped,
)
from cli.doctor.link import ReceivedReports, Visit, visit_controller
from cli.doctor.machine import check_processor, machine_lines, realtime_limit, sensor_line
from cli.doctor.pose import check_pose
from cli.status import helpers_of
from common.bus.cell_bus import open_bus
from common.config.arm import UNKNOWN_ARM
from common.config.cell import CellConfig, GatewaySection
from common.config.load import cell_hash
from common.motion.convert import pose_of
from common.motion.kinematics import ArmKinematics
from control.delay_monitor import DelayMonitorSettings
from controller.packet_table import Status, greeted
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.client.feed import Feed
from forcemesh.errors import BusError, LostError
from forcemesh.messages import (
    CONTROLLER_BITS,
    Health,
    Joints,
    KawasakiStatus,
    RobotState,
    RobotStatus,
    SensorWrench,
)
from forcemesh.zenoh_settings import endpoint_of
from launch.cell_view import CellView
from launch.run_file import read_run
from services.gateway.packet_window import Spread

CONNECT_WITHIN_S = 0.5
OBSERVED_S = 3.0
RATE_POLL_S = 0.002
STREAMS: tuple[topics.Topic[Any], ...] = (  # besides robot/state and sensor/wrench
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
)
DECIMATED_BELOW = 0.6
CONNECTION_CHECKS = ("address", "hello", "protocol", "arm", "scales")
REST = ("sender", "status bits", "error code", "pose", "program loop", "monitor speed",
        "peer", "round trip", "left behind")  # fmt: skip
UNREPORTED = ("status bits", "error code", "program loop", "monitor speed", "peer")  # of plain


def check_cell(cell: CellConfig, measured_percent: float | None = None) -> list[ReportLine]:
    """Check this PC and the sensor; then the bus when the cell is up, else the link.

    Args:
        cell: The cell.
        measured_percent: Monitor speed at which robot.delay_s was measured, if recorded [%].
    """
    run, found = read_run(cell.cell), observe_cell(cell)
    has_run = run is not None and run.live
    is_up, endpoint = has_run or found is not None, endpoint_of(cell)
    lines = machine_lines(cell, is_up=is_up)
    if found is None:
        lines.append(skipped("zenoh", f"no hub responds at {endpoint}: `forcemesh up` starts it"))
    else:
        lines.append(passed("zenoh", f"the hub responds at {endpoint}"))
    lines.append(sensor_line(cell, is_up=is_up))
    section = cell.gateway if cell.roles.robot == "gateway" else None
    if found is not None and (has_run or found.robot is not None or section is None):
        lines.append(_processor_line(found, is_here=has_run))
        return [*lines, *bus_lines(cell, found, measured_percent)]
    if has_run:
        text = "the cell is up, but its hub does not respond"
        return [*lines, finding("bus", "FAIL", text, "bus")]
    if section is None:
        no_hub = finding("bus", "FAIL", "no hub responds: the cell is not up", "bus.down")
        return [*lines, no_hub, *unused_lines(cell)]
    if section.protocol == "plain":
        return [*lines, *check_plain(), *_unreported((*CONNECTION_CHECKS, *REST))]
    visit = visit_controller(section.host, section.port, section, arm=section.arm)
    lines += link_lines(cell, section, visit, measured_percent)
    return [*lines, skipped("processes", "the cell is not up: the link itself was checked")]


@dataclass(slots=True)
class ObservedCell:
    """State of a cell as received from its bus."""

    roles: Mapping[str, Reading[Health] | Reading[SensorWrench]]  # health, or an external sensor
    robot: Health | None  # the robot's process, while its health is fresh
    state: RobotState | None  # the newest, valid or not
    stream_hz: dict[str, float | None] = field(default_factory=dict)
    sensor: SensorWrench | None = None  # the newest reading


def observe_cell(cell: CellConfig, watch_s: float = OBSERVED_S) -> ObservedCell | None:
    """Receive from a cell for some seconds; return None when no hub responds."""
    try:
        with open_bus(cell, topics.CLIENT, patience_s=CONNECT_WITHIN_S) as bus:
            view, robot = CellView(bus, cell), Feed(bus, topics.ROBOT_STATE, LostError)
            sensor = Feed(bus, topics.SENSOR_WRENCH, LostError)
            feeds: list[Feed[Any]] = [
                robot,
                sensor,
                *(Feed(bus, row, LostError) for row in STREAMS),
            ]
            end_s = time.monotonic() + max(watch_s, view.longest_wait_s)
            while time.monotonic() < end_s:
                for feed in feeds:
                    feed.reading()
                time.sleep(RATE_POLL_S)
            roles = (*topics.ROLES, *helpers_of(view, read_run(cell.cell)))
            return ObservedCell(
                roles={role: view.health(role) for role in roles},
                robot=view.fresh_health("robot"),
                state=robot.reading().message,
                stream_hz={feed.topic.key: feed.rate_hz for feed in feeds},
                sensor=sensor.reading().message,
            )
    except BusError:
        return None


def link_lines(
    cell: CellConfig, section: GatewaySection, found: Visit, measured_percent: float | None = None
) -> list[ReportLine]:
    """Return the lines of a visit to the controller; unreached checks are listed as skipped."""
    endpoint = f"{section.host}:{section.port}"
    lines = [
        check_address(
            endpoint,
            found.opened,
            found.opened_detail,
            found.opened_s,
            is_emulated=cell.roles.sensor == "sim",
        )
    ]
    if found.opened == "open":
        lines.append(check_hello(found.hello_outcome, found.hello_detail, found.hello_s))
    if found.hello is not None and found.hello_outcome == "answered":
        version, number = greeted(found.hello.param)
        lines += [check_protocol(version), check_arm(number, section.arm)]
        lines.append(check_scales(section, found.hello.vec))
    if found.reports is not None:
        return [*lines, *_controller_lines(cell, section, found.reports, measured_percent)]
    done = {line.check for line in lines}
    missing = [check for check in (*CONNECTION_CHECKS, *REST) if check not in done]
    return [*lines, *(skipped(check, "not checked: see above") for check in missing)]


def _controller_lines(
    cell: CellConfig,
    section: GatewaySection,
    reports: ReceivedReports,
    measured_percent: float | None,
) -> list[ReportLine]:
    stale_after_s = cell.stale_after_s(topics.ROBOT_STATE)
    lines = []
    if reports.broken:
        lines.append(finding("connection", "FAIL", reports.broken, "reports.broken"))
    lines.append(
        check_sender(
            reports.sender_hz,
            reports.longest_gap_s,
            robot_hz=cell.rates.robot_hz,
            stale_after_s=stale_after_s,
        )
    )
    health = reports.health
    if reports.pose is None or reports.joints is None:
        lines += [skipped(check, "no 101 and 102 received") for check in ("status bits", "pose")]
    else:
        status, q = reports.joints.status, reports.joints.joint_rad
        T_base_flange = reports.pose.T_base_flange
        lines += check_status(status)
        lines.append(_pose_line(cell, T_base_flange, q, status))
    return [
        *lines,
        check_error_code(None if health is None else health.error_code),
        check_loops(reports.loop_hz),
        check_monitor_speed(
            None if health is None else health.monitor_speed_fraction, measured_percent
        ),
        check_peer(any_peer=None if health is None else health.any_peer),
        check_round_trip(reports.round_trip, section.watchdog_s),
        check_goodbye(reports.held),
    ]


def bus_lines(
    cell: CellConfig, found: ObservedCell, measured_percent: float | None = None
) -> list[ReportLine]:
    """Return the lines of a cell that is up, from the reports of its gateway on the bus."""
    config_hash = cell_hash(cell)
    lines = [check_role(role, health, config_hash) for role, health in found.roles.items()]
    for row in topics.TOPICS:
        if row.key in found.stream_hz:
            # The gateway forwards whole samples: of a faster sender every second or third.
            is_decimated = row is topics.ROBOT_STATE and cell.roles.robot == "gateway"
            share = DECIMATED_BELOW if is_decimated else SLOW_BELOW
            hz = found.stream_hz[row.key]
            lines.append(check_stream(row.key, hz, cell.rate_hz(row), slow_below=share))
    if found.sensor is not None and cell.roles.sensor != "sim":
        lines.append(check_serial(found.sensor.serial))
    lines += _loop_delay_lines(cell, found.roles.get("regulator"))
    if cell.gateway is None or cell.roles.robot != "gateway":
        lines += unused_lines(cell, skip=("pose",))
        return [*lines, _state_pose(cell, found.state)]
    if cell.gateway.protocol == "plain":
        lines += check_plain()
    skip_reason = "the cell is up and its gateway uses the only connection: read from the bus"
    lines += [skipped(check, skip_reason) for check in (*CONNECTION_CHECKS, "left behind")]
    state = found.state
    if state is None or not state.valid or not state.link.connected:
        reason = "no robot/state received" if state is None else state.reason or "not connected"
        lines.append(finding("link", "FAIL", reason, "link"))
        rest = (check for check in REST if check != "left behind")
        return [*lines, *(skipped(check, "no reports: see link") for check in rest)]
    times = f"{state.link.reconnects} reconnects, {state.link.errors} protocol errors"
    lines.append(passed("link", f"connected; {times}"))
    if cell.gateway.protocol == "plain":
        numbers = _number_lines(cell, cell.gateway, found.robot, measured_percent)
        read = [line for line in numbers if line.check not in UNREPORTED]
        return [*lines, _state_pose(cell, state), *read, *_unreported(UNREPORTED)]
    lines += check_status(status_of(state.status))
    lines.append(check_error_code((state.status.kawasaki or KawasakiStatus()).error_code))
    lines.append(_state_pose(cell, state))
    return [*lines, *_number_lines(cell, cell.gateway, found.robot, measured_percent)]


def _loop_delay_lines(
    cell: CellConfig, regulator: Reading[Health] | Reading[SensorWrench] | None
) -> list[ReportLine]:
    """Return the line on the loop's delay, if a session has measured it."""
    health = None if regulator is None else regulator.fresh
    numbers = health.numbers if isinstance(health, Health) else {}
    if "loop_delay_s" not in numbers:
        return []
    settings = DelayMonitorSettings.of(cell)
    return [
        check_loop_delay(
            numbers["loop_delay_s"],
            settings.tau_s,
            delay_s=cell.robot.delay_s,
            tolerance_s=settings.tolerance_s,
        )
    ]


def _unreported(checks: Iterable[str]) -> list[ReportLine]:
    """Return a line for each check that protocol plain has no report for."""
    reason = "not reported by protocol plain, which has no hello"
    return [skipped(check, reason) for check in checks]


def _processor_line(found: ObservedCell, *, is_here: bool) -> ReportLine:
    """Return the line on the processor time of a cell that runs on this PC."""
    if not is_here:
        return skipped("processor", "the cell's processes were not started by a supervisor here")
    health = {
        role: reading.fresh
        for role, reading in found.roles.items()
        if isinstance(reading.fresh, Health)
    }
    return check_processor(health, os.cpu_count() or 1, realtime_limit())


def unused_lines(cell: CellConfig, skip: tuple[str, ...] = ()) -> list[ReportLine]:
    """Return a line for each check of the link, in a cell that has none."""
    reason = f"not used by this cell: roles.robot is {cell.roles.robot}"
    return [skipped(check, reason) for check in (*CONNECTION_CHECKS, *REST) if check not in skip]


def status_of(robot: RobotStatus) -> Status:
    """Return the status of a robot as the bits that its controller sends."""
    controller = robot.kawasaki or KawasakiStatus()
    named = {
        **{Status[name.upper()]: getattr(controller, name) for name in CONTROLLER_BITS},
        Status.MOVING: robot.moving,
        Status.HELD: robot.held,
        Status.POSITION_FEEDBACK: robot.feedback in ("position", "both"),
        Status.ORIENTATION_FEEDBACK: robot.feedback in ("orientation", "both"),
    }
    return reduce(or_, (bit for bit, is_set in named.items() if is_set), Status(0))


def _number_lines(
    cell: CellConfig,
    section: GatewaySection,
    robot: Health | None,
    measured_percent: float | None,
) -> list[ReportLine]:
    """Check the measurements of the gateway."""
    numbers = {} if robot is None else robot.numbers
    p50_s, p99_s = (numbers.get(f"framed_round_trip_{p}_s") for p in ("p50", "p99"))
    any_peer = numbers.get("any_peer_may_connect")
    if p50_s is None or p99_s is None:
        round_trip = skipped(
            "round trip", "nothing was sent in the last minute: arm, run doctor again"
        )
    else:
        round_trip = check_round_trip(Spread(p50_s, p99_s), section.watchdog_s)
    return [
        check_sender(
            numbers.get("sender_hz"),
            None,
            robot_hz=cell.rates.robot_hz,
            stale_after_s=cell.stale_after_s(topics.ROBOT_STATE),
        ),
        check_loops(numbers.get("program_loop_hz")),
        check_monitor_speed(numbers.get("monitor_speed_fraction"), measured_percent),
        check_peer(any_peer=None if any_peer is None else bool(any_peer)),
        round_trip,
    ]


def _state_pose(cell: CellConfig, state: RobotState | None) -> ReportLine:
    if state is None or not state.valid:
        return skipped("pose", "robot/state is missing or not valid")
    return _pose_line(cell, pose_of(state), state.joint_rad, status_of(state.status))


def _pose_line(cell: CellConfig, T_base_flange: pin.SE3, q: Joints, status: Status) -> ReportLine:
    if cell.robot.model == UNKNOWN_ARM:
        return skipped("pose", f"robot.model is {UNKNOWN_ARM}: there is no model to compare with")
    if status & Status.MOVING:
        return finding("pose", "WARN", "not compared: the arm moves", "pose.moving")
    return check_pose(cell, T_base_flange, q, ArmKinematics(cell.robot.model))
