"""Gateway service: the role `robot`, implemented by a Kawasaki controller over TCP."""

from math import radians

import numpy as np

from common.config.cell import CellConfig, GatewaySection
from common.motion.convert import record_of, vec3
from common.motion.last_check import MEASURED_SLACK_M, LastCheck
from common.motion.permission import NO_COMMAND_YET, CommandGate, GateDecision
from common.motion.unexplained import REACH, is_guided, reach_of
from common.runtime.signal_service import SignalService
from controller.packet_table import ID_COUNT, ID_FIRST
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError, LocalProtocolError
from forcemesh.faults import clipped, tripped
from forcemesh.messages import RobotState
from services.gateway.connection import ByteLink, ControllerConnection
from services.gateway.dialogue import Dialogue
from services.gateway.driver import Driver
from services.gateway.goals import ControllerReport
from services.gateway.link import Link, LinkSettings
from services.gateway.packets import ControllerLimits, Pacing
from services.gateway.plain_link import PlainLink
from services.gateway.setpoint_shaper import CatchUp, SetpointShaper
from services.gateway.signals import ControllerSignals

STEP_S = 0.002  # longest time that a report of the controller waits in the socket
# Margins of the controller's own limits over those of this process.
CONTROLLER_ROTATION_MARGIN_RAD = radians(0.5)
STEP_MARGIN = 1.1
CONTROLLER_SPEED_MARGIN = 1.01
WORKSPACE_MARGIN_M = MEASURED_SLACK_M + 1e-3
EARLY = 0.75  # least share of a period between two published reports


class Gateway:
    """Service that executes `robot/command` under permission and publishes `robot/state`."""

    def __init__(self, bus: Bus, cell: CellConfig, wire: ByteLink | None = None) -> None:
        """Open the topics of the robot; `wire` replaces the socket."""
        section = cell.gateway
        if section is None:
            raise ConfigError(cell.cell, ["gateway: the section is missing"])
        self.period_s = STEP_S
        self.fault = ""
        self._clock = bus.clock
        kept = controller_limits(cell, section)
        guard = LastCheck(cell)
        step = set_point_step(cell, section)
        shaper = SetpointShaper(cell.limits, guard.place, CatchUp.of(cell), step)
        pacing = Pacing(
            max_unexecuted=section.max_unexecuted_setpoints,
            heartbeat_after_s=section.heartbeat_s,
            release=shaper.release,
        )
        # A restarted process must not attribute echoes of its predecessor's IDs to itself.
        last_id = ID_FIRST + bus.epoch % ID_COUNT
        self._dialogue = Dialogue(section, pacing, arm=section.arm, last_id=last_id)
        wire, reach = wire or Link(LinkSettings(section.host, section.port)), REACH
        if section.protocol == "plain":
            wire, reach = PlainLink(wire, cell, section), reach_of(section.plain)
        self._connection = ControllerConnection(
            wire,
            self._dialogue,
            kept,
            stale_after_s=cell.stale_after_s(topics.ROBOT_STATE),
            signals=ControllerSignals(cell.signals),
        )
        self._driver = Driver(
            cell, self._dialogue, self._connection.send, guard=guard, shaper=shaper, reach=reach
        )
        self._gate = CommandGate(bus.epoch)
        self.verdict = NO_COMMAND_YET  # command that is executed now, or why none is
        self._state_period_ns = round(NS_PER_S / cell.rates.robot_hz)
        self._reported_ns = 0
        self._refusals = 0
        self._command = bus.reader(topics.ROBOT_COMMAND)
        self._wrench = bus.reader(topics.WRENCH)
        self._state = bus.publisher(topics.ROBOT_STATE)
        self._signals = SignalService(bus, cell)
        self.trigger = self._command

    @property
    def measured(self) -> ControllerReport | None:
        """Last report of the controller."""
        return self._connection.measured

    def counters(self) -> dict[str, int]:
        """Return the counters of superseded, refused and pending commands and of reconnections."""
        link = self._connection.link_health()
        return {
            "command_superseded": self._command.counters.superseded,
            "reconnects": link.reconnects,
            "protocol_errors": link.errors,
            "refusals": self._refusals,
            "unexecuted": self._dialogue.window.unexecuted,
            "unacknowledged": self._dialogue.window.unacknowledged,
        }

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the measurements of the controller, without unknown ones."""
        return self._connection.numbers(now_ns)

    def close(self) -> None:
        """Close the connection, at whose end the controller holds."""
        self._connection.close(self._clock.now_ns())

    def step(self, now_ns: int) -> None:
        """Read the controller's reports, execute the command or hold, publish the state.

        Every report is published; without reports the fault, at the usual rate.
        """
        is_new = self._connection.poll(now_ns)
        self.fault = self._connection.link_fault(now_ns)
        self.verdict = self._judge(now_ns, is_new=is_new)
        if self.verdict.command is None:
            self._driver.hold(self.verdict.hold_reason, now_ns)
        measured = self._connection.measured
        if measured is not None:
            self._driver.follow_goal(measured, now_ns)
        guided = is_guided(self._connection.status.faults)
        trip = self._driver.watch_rest(measured, guided=guided, now_ns=now_ns)
        if trip is not None:
            self.verdict = self._gate.revoke(trip)
        since_ns = now_ns - self._reported_ns
        if self.fault:
            is_due = since_ns >= self._state_period_ns
        else:
            is_due = is_new and since_ns >= EARLY * self._state_period_ns
        if is_due:
            self._reported_ns = now_ns
            self._state.put(self._robot_state())
        self._signals.step(
            now_ns,
            self._connection.signals(now_ns),
            hold=self.verdict.hold,
            switch=lambda number, on: self._connection.switch(number, on=on, now_ns=now_ns),
        )

    # --- commands ---------------------------------------------------------------------------------

    def _judge(self, now_ns: int, *, is_new: bool) -> GateDecision:
        """Execute a permitted command; any fault ends its lease."""
        verdict = self._gate.judge(self._command.read(now_ns), now_ns)
        measured = self._connection.measured
        if not self._dialogue.ready:
            self._driver.disconnected()
        if self.fault or measured is None:
            return self._gate.revoke(tripped(self._connection.code, self.fault))
        command, accepted = verdict.command, verdict.accepted
        if command is None or command.permission is None or accepted is None:
            return self._with_cause(verdict)
        if (controller_fault := self._connection.controller_fault()) is not None:
            return self._gate.revoke(controller_fault)
        try:
            trip = self._driver.obey(
                command,
                measured,
                lease=(accepted.epoch, command.permission.lease),
                wrench=self._wrench.read(now_ns),
                is_new=verdict.is_new,
                now_ns=now_ns,
            )
            if trip is None:
                self._connection.send(self._dialogue.tick(now_ns, permitted=True), now_ns)
                trip = self._driver.watch(measured, now_ns) if is_new else None
        except LocalProtocolError as error:
            trip = tripped("unsendable", str(error))
        if trip is None:
            return verdict
        self._refusals += 1
        return self._gate.revoke(trip)

    def _with_cause(self, verdict: GateDecision) -> GateDecision:
        """Put the controller's present fault, the cause, before the reason of the ended lease."""
        if (controller_fault := self._connection.controller_fault()) is None:
            return verdict
        text = clipped(f"{controller_fault.text}; {verdict.hold_reason}")
        return verdict._replace(hold=controller_fault.replaced(text=text))

    # --- state ------------------------------------------------------------------------------------

    def _robot_state(self) -> RobotState:
        measured, hold = self._connection.measured, self.verdict.hold
        goal, link = self._driver.track.report, self._connection.link_health()
        if self.fault or measured is None:
            why, code = self.fault[:400], self._connection.code
            return RobotState(valid=False, reason=why, code=code, goal=goal, hold=hold, link=link)
        flange, sent = record_of(measured.T_base_flange), self._driver.sent
        return RobotState(
            position_m=flange.position_m,
            orientation_xyzw=flange.orientation_xyzw,
            joint_rad=measured.joint_rad,
            status=self._connection.status,
            goal=goal,
            accepted=self.verdict.accepted,
            sent=None if sent is None else record_of(sent),
            hold=hold,
            link=link,
            challenge=self._gate.challenge,
        )


def set_point_step(cell: CellConfig, section: GatewaySection) -> tuple[float, float]:
    """Return the largest distance between two set points [m, rad]."""
    limits = cell.limits
    return (
        min(limits.step_m, limits.speed_m_s * section.segment_s),
        radians(min(limits.step_deg, limits.speed_deg_s * section.segment_s)),
    )


def controller_limits(cell: CellConfig, section: GatewaySection) -> ControllerLimits:
    """Return the limits that the controller enforces itself, also without this process.

    They are a little wider than the limits of this process, so that rounding causes no refusal and
    this process reports the violation first.
    """
    limits = cell.limits
    step_m, step_rad = set_point_step(cell, section)
    return ControllerLimits(
        step_m=limits.step_m,
        step_rad=radians(limits.step_deg),
        speed_m_s=min(limits.speed_m_s, cell.force.speed_max_m_s),
        travel_m=limits.tether_m,
        force_N=limits.force_N,
        watchdog_s=section.watchdog_s,
        turn_rad=radians(limits.tether_deg) + CONTROLLER_ROTATION_MARGIN_RAD,
        torque_Nm=limits.torque_Nm,
        set_point_m=STEP_MARGIN * step_m,
        set_point_rad=STEP_MARGIN * step_rad,
        fastest_m_s=CONTROLLER_SPEED_MARGIN * limits.speed_m_s,
        lower_m=vec3(np.array(limits.workspace_min_m) - WORKSPACE_MARGIN_M),
        upper_m=vec3(np.array(limits.workspace_max_m) + WORKSPACE_MARGIN_M),
        T_flange_tcp=cell.tool.T_flange_tcp.pose,
        least_segment_s=section.least_segment_s,
        least_speed_m_s=section.least_speed_m_s,
        joint_speed_rad_s=tuple(np.radians(cell.robot.joint_speed_max_deg_s).tolist()),
    )
