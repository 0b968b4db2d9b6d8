"""Selection of the checks of a cell, from the findings on its link or its bus: pure."""

from typing import TYPE_CHECKING

import numpy as np

from cli.doctor.checks import (
    SLOW_BELOW,
    ReportLine,
    check_address,
    check_arm,
    check_error_code,
    check_goodbye,
    check_hello,
    check_loops,
    check_monitor_speed,
    check_peer,
    check_protocol,
    check_role,
    check_round_trip,
    check_scales,
    check_sender,
    check_status,
    check_stream,
    finding,
    passed,
    skipped,
)
from cli.doctor.pose import Frames, check_pose
from common.config.arm import UNKNOWN_ARM
from common.config.load import cell_hash
from common.motion.convert import pose_of
from common.motion.kinematics import ArmKinematics
from controller.packet_table import Status, greeted
from forcemesh import topics
from forcemesh.messages import CONTROLLER_BITS, KawasakiStatus
from services.gateway.packet_window import Spread

if TYPE_CHECKING:
    import pinocchio as pin

    from cli.doctor.bus import ObservedCell
    from cli.doctor.link import ReceivedReports, Visit
    from common.config.cell import CellConfig, GatewaySection
    from controller.packet_table import Scales
    from forcemesh.messages import Health, Joints, RobotState, RobotStatus

DECIMATED_BELOW = 0.6
CONNECTION_CHECKS = ("address", "hello", "protocol", "arm", "scales")
REST = ("sender", "status bits", "error code", "pose", "program loop", "monitor speed",
        "peer", "round trip", "left behind")  # fmt: skip


def link_lines(
    cell: "CellConfig", section: "GatewaySection", scales: "Scales", found: "Visit"
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
        lines.append(check_scales(scales, found.hello.vec))
    if found.reports is not None:
        return [*lines, *_controller_lines(cell, section, scales, found.reports)]
    done = {line.check for line in lines}
    missing = [check for check in (*CONNECTION_CHECKS, *REST) if check not in done]
    return [*lines, *(skipped(check, "not checked: see above") for check in missing)]


def _controller_lines(
    cell: "CellConfig", section: "GatewaySection", scales: "Scales", reports: "ReceivedReports"
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
        lines.append(_pose_line(cell, scales, T_base_flange=T_base_flange, q=q, status=status))
    return [
        *lines,
        check_error_code(None if health is None else health.error_code),
        check_loops(reports.loop_hz),
        check_monitor_speed(None if health is None else health.monitor_speed_fraction),
        check_peer(any_peer=None if health is None else health.any_peer),
        check_round_trip(reports.round_trip, section.watchdog_s),
        check_goodbye(reports.held),
    ]


def bus_lines(cell: "CellConfig", scales: "Scales", found: "ObservedCell") -> list[ReportLine]:
    """Return the lines of a cell that is up, from the reports of its gateway on the bus."""
    config_hash = cell_hash(cell)
    lines = [check_role(role, health, config_hash) for role, health in found.roles.items()]
    lines += [
        check_stream(row.key, hz, cell.rate_hz(row), slow_below=_slow_share(cell, row.key))
        for row in topics.TOPICS
        for hz in (found.stream_hz.get(row.key),)
        if row.key in found.stream_hz
    ]
    if cell.gateway is None or cell.roles.robot != "gateway":
        lines += unused_lines(cell, skip=("pose",))
        return [*lines, _state_pose(cell, scales, found.state)]
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
    lines += check_status(status_of(state.status))
    lines.append(check_error_code((state.status.kawasaki or KawasakiStatus()).error_code))
    lines.append(_state_pose(cell, scales, state))
    return [*lines, *_number_lines(cell, cell.gateway, found.robot)]


def unused_lines(cell: "CellConfig", skip: tuple[str, ...] = ()) -> list[ReportLine]:
    """Return a line for each check of the link, in a cell that has none."""
    reason = f"not used by this cell: roles.robot is {cell.roles.robot}"
    return [skipped(check, reason) for check in (*CONNECTION_CHECKS, *REST) if check not in skip]


def _slow_share(cell: "CellConfig", key: str) -> float:
    """Return the share of its rate below which a topic is slow.

    The gateway forwards whole samples: of a faster sender every second or third.
    """
    is_decimated = key == topics.ROBOT_STATE.key and cell.roles.robot == "gateway"
    return DECIMATED_BELOW if is_decimated else SLOW_BELOW


def status_of(robot: "RobotStatus") -> Status:
    """Return the status of a robot as the bits that its controller sends."""
    controller = robot.kawasaki or KawasakiStatus()
    named = {
        **{Status[name.upper()]: getattr(controller, name) for name in CONTROLLER_BITS},
        Status.MOVING: robot.moving,
        Status.HELD: robot.held,
        Status.POSITION_FEEDBACK: robot.feedback in ("position", "both"),
        Status.ORIENTATION_FEEDBACK: robot.feedback in ("orientation", "both"),
    }
    bits = Status(0)
    for bit, is_set in named.items():
        bits |= bit if is_set else Status(0)
    return bits


def _number_lines(
    cell: "CellConfig", section: "GatewaySection", robot: "Health | None"
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
        check_monitor_speed(numbers.get("monitor_speed_fraction")),
        check_peer(any_peer=None if any_peer is None else bool(any_peer)),
        round_trip,
    ]


def _state_pose(cell: "CellConfig", scales: "Scales", state: "RobotState | None") -> ReportLine:
    if state is None or not state.valid:
        return skipped("pose", "robot/state is missing or not valid")
    T_base_flange, status = pose_of(state), status_of(state.status)
    return _pose_line(cell, scales, T_base_flange=T_base_flange, q=state.joint_rad, status=status)


def _pose_line(
    cell: "CellConfig", scales: "Scales", *, T_base_flange: "pin.SE3", q: "Joints", status: Status
) -> ReportLine:
    if cell.robot.model == UNKNOWN_ARM:
        return skipped("pose", f"robot.model is {UNKNOWN_ARM}: there is no model to compare with")
    if status & Status.MOVING:
        return finding("pose", "WARN", "not compared: the arm moves", "pose.moving")
    frames = Frames(cell.tool.T_flange_tcp.pose, cell.sensor.T_flange_sensor.pose)
    arm = ArmKinematics(cell.robot.model)
    return check_pose(T_base_flange, np.array(q), scales=scales, frames=frames, arm=arm)
