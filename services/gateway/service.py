"""Gateway service: the role `robot`, implemented by a Kawasaki controller over TCP."""

from math import radians

import numpy as np

from common.config.cell import CellConfig, GatewaySection
from common.motion.arm_check import MEASURED_SLACK_M, ArmCheck
from common.motion.convert import vec3
from common.motion.unexplained import REACH, reach_of
from common.robot.service import RobotService
from controller.packet_table import ID_COUNT, ID_FIRST
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.errors import ConfigError
from services.gateway.connection import ByteLink, ControllerConnection
from services.gateway.dialogue import Dialogue
from services.gateway.driver import ControllerDriver
from services.gateway.link import Link, LinkSettings
from services.gateway.packets import ControllerLimits, Pacing
from services.gateway.plain_link import PlainLink
from services.gateway.setpoint_shaper import CatchUp, SetpointShaper
from services.gateway.signals import ControllerSignals

# Margins of the controller's own limits over those of this process.
CONTROLLER_ROTATION_MARGIN_RAD = radians(0.5)
STEP_MARGIN = 1.1
CONTROLLER_SPEED_MARGIN = 1.01
WORKSPACE_MARGIN_M = MEASURED_SLACK_M + 1e-3


class Gateway(RobotService):
    """Robot service with a Kawasaki controller."""

    driver: ControllerDriver

    def __init__(self, bus: Bus, cell: CellConfig, wire: ByteLink | None = None) -> None:
        """Open the topics of the robot; `wire` replaces the socket."""
        section = cell.gateway
        if section is None:
            raise ConfigError(cell.cell, ["gateway: the section is missing"])
        check = ArmCheck(cell)
        step = set_point_step(cell, section)
        shaper = SetpointShaper(cell.limits, check.place, CatchUp.of(cell), step)
        pacing = Pacing(
            max_unexecuted=section.max_unexecuted_setpoints,
            heartbeat_after_s=section.heartbeat_s,
            release=shaper.release,
        )
        # A restarted process must not attribute echoes of its predecessor's IDs to itself.
        last_id = ID_FIRST + bus.epoch % ID_COUNT
        wire, reach = wire or Link(LinkSettings(section.host, section.port)), REACH
        if section.protocol == "plain":
            wire, reach = PlainLink(wire, cell, section), reach_of(section.plain)
        connection = ControllerConnection(
            wire,
            Dialogue(section, pacing, arm=section.arm, last_id=last_id),
            controller_limits(cell, section),
            stale_after_s=cell.stale_after_s(topics.ROBOT_STATE),
            signals=ControllerSignals(cell.signals),
        )
        super().__init__(bus, cell, ControllerDriver(cell, connection, shaper, reach), check)
        self._clock = bus.clock

    def counters(self) -> dict[str, int]:
        """Return the counters of commands, of pending packets and of reconnections."""
        connection, window = self.driver.connection, self.driver.dialogue.window
        return super().counters() | {
            "reconnects": connection.link_health().reconnects,
            "protocol_errors": connection.errors,
            "unexecuted": window.unexecuted,
            "unacknowledged": window.unacknowledged,
        }

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the measurements of the controller, without unknown ones."""
        return self.driver.connection.numbers(now_ns)

    def close(self) -> None:
        """Close the connection, at whose end the controller holds."""
        self.driver.connection.close(self._clock.now_ns())


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
