"""Model of the cell file: one robot cell, every field with its unit, bounds and default.

SI units. Angles of frames are Kawasaki's O, A, T in degrees, as on the teach pendant.
"""

from math import sqrt
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from common.config.arm import UNKNOWN_ARM, RobotSection, arm_names
from common.config.calibration import CalibrationSection, CellCalibration
from common.config.cell_helpers import PanelSection, RecorderSection
from common.config.cell_sensor import SensorSection, sensor_mistake
from common.config.cell_sim import SimSection
from common.config.cell_terms import Fraction, FrameSection
from common.config.payload import DOWN, CellPayload, Direction, Payload
from common.config.plant import Plant
from common.config.signals import Dedicated, Signals, signals_mistake
from controller import plain
from controller.packet_table import Scales
from controller.plain import PlainSection
from forcemesh.connection import BusSection, ConfigSection
from forcemesh.messages import Vec3
from forcemesh.patterns import CELL_NAME, LAW_NAME
from forcemesh.topics import HELPERS, ROLES, Topic
from forcemesh.units import question

SHORTEST_DEADLINE_PERIODS = 3.0
SLOWEST_INERTIAL_HZ = 100.0
PACKET_JOINTS = 6  # in a packet of the controller
# A value that many times above what the cell allows is in another unit; less is refused at arming.
UNIT_SLIP = 100.0
SETPOINT_SHARE = 0.7  # of the ceiling: leaves room for overshoot and for a hold after it
USUAL_FORCE_N = 50.0  # above these two a risk assessment must be named
USUAL_SPEED_M_S = 0.25
FORCES = ("setpoint_max_N", "approach_budget_N", "touch_N")  # that the sensor must be able to read
FARTHEST_WORKSPACE_M = 10.0  # beyond the reach of any arm, also on a rail

Far = Annotated[float, Field(ge=-FARTHEST_WORKSPACE_M, le=FARTHEST_WORKSPACE_M)]  # [m] in base
Position = tuple[Far, Far, Far]


class RolesSection(ConfigSection):
    """Implementation of the roles robot and sensor: simulated or real."""

    robot: Literal["sim", "gateway", "external"]
    sensor: Literal["sim", "driver", "external"]


class Rates(ConfigSection):
    """Rates of this cell [Hz]."""

    robot_hz: float = Field(250.0, ge=5.0, le=1000.0)
    sensor_hz: float = Field(500.0, ge=50.0, le=8000.0)
    control_hz: float = Field(250.0, ge=5.0, le=1000.0)
    status_hz: float = Field(20.0, ge=1.0, le=100.0)
    health_hz: float = Field(4.0, ge=1.0, le=20.0)


class Deadlines(ConfigSection):
    """Minimum stale time of each class of input; three of its periods if that is longer.

    forcemesh/topics.py gives each topic its class; `sensor_s` is that of sensor/wrench and wrench.
    """

    command_s: float = Field(0.040, ge=0.040, le=1.0)
    sensor_s: float = Field(0.020, ge=0.020, le=1.0)
    status_s: float = Field(0.5, ge=0.1, le=5.0)
    health_s: float = Field(1.0, ge=0.3, le=10.0)


class ToolSection(ConfigSection):
    """Tool centre point in the flange frame; its z axis points out of the tool."""

    name: str = Field("", max_length=100)  # tools of the same name share one calibration
    T_flange_tcp: FrameSection


class FilterSection(ConfigSection):
    """Wrench filter: median of `median` samples, then a first-order low-pass."""

    median: Literal[1, 3, 5] = 3
    lowpass_s: float = Field(0.005, ge=0.0, le=0.5)
    inertial: bool = False  # inertial compensation of the tool; adds noise, no delay


class ContactSection(ConfigSection):
    """Stiffest contact for which the gains must be stable: basis of the gain rule."""

    stiffness_N_m: float = Field(ge=250.0, le=1e7)
    tilt_stiffness_Nm_rad: float = Field(gt=0.0, le=1e4)
    inertia_kg: float = Field(1.5, gt=0.0, le=100.0)  # mass in front of the sensor
    inertia_kg_m2: float = Field(
        0.005, gt=0.0, le=4.0
    )  # moment of inertia in front of the sensor, about the TCP


class ForceSection(ConfigSection):
    """Parameters of the regulator other than its gains."""

    chain_s: float = Field(
        0.004, ge=0.0, le=0.1
    )  # latency from sensor sample to robot, as printed in the last line of the demo
    deadband_N: float = Field(0.3, ge=0.0, le=20.0)
    deadband_Nm: float = Field(0.02, ge=0.0, le=2.0)
    speed_max_m_s: float = Field(0.05, gt=0.0, le=0.25)
    speed_max_rad_s: float = Field(0.5, gt=0.0, le=2.0)
    approach_m_s: float = Field(0.01, gt=0.0, le=0.25)
    approach_budget_N: float = Field(10.0, gt=0.0, le=200.0)  # permitted force at first contact
    idle_max_N: float = Field(
        2.0, gt=0.0, le=50.0
    )  # larger residual force in free space: payload or bias is wrong
    idle_max_Nm: float = Field(0.3, gt=0.0, le=5.0)  # the same for the torque about the TCP
    touch_N: float = Field(2.0, gt=0.0, le=50.0)  # contact begins above it, ends below half
    search_m: float = Field(0.05, gt=0.0, le=0.5)  # longest travel to the first contact
    lost_m: float = Field(0.005, gt=0.0, le=0.1)  # longest travel to regain a lost contact
    environment_work_J: float = Field(
        0.002, gt=0.0, le=1.0
    )  # net work that the environment may do on the tool
    setpoint_ramp_N_s: float = Field(200.0, gt=0.0, le=5000.0)
    setpoint_max_N: float = Field(40.0, gt=0.0, le=1000.0)
    # adaptive: gains from the identified stiffness, not from the stiffest
    law: str = Field("plain", pattern=LAW_NAME)
    delay_compensation: bool = True  # adaptive: Smith predictor for commands in flight
    surface_tracking: bool = True  # adaptive: track a moving surface
    # Opt-in: above 80 % of a ceiling the tool retreats along its axis by this distance, then holds.
    retreat_m: float = Field(0.0, ge=0.0, le=0.002)
    retreat_m_s: float = Field(0.005, gt=0.0, le=0.01)
    tare_max_N: float = Field(5.0, gt=0.0, le=100.0)  # of all tares since the calibration
    tare_max_Nm: float = Field(1.0, gt=0.0, le=10.0)
    tare_age_max_s: float = Field(28_800.0, ge=60.0, le=864_000.0)  # age of the last tare at arming


class PlaneSection(ConfigSection):
    """Workspace plane in base axes: the TCP must stay on the side of the normal."""

    point_m: Position  # any point of the plane
    normal: Vec3  # of any length

    @model_validator(mode="after")
    def _normal_points_somewhere(self) -> "PlaneSection":
        if not any(abs(part) > 1e-6 for part in self.normal):
            raise ValueError("the normal has length zero")
        return self


class LimitsSection(ConfigSection):
    """Limits on motion and force, checked by the arbiter and again by the robot's own process.

    The upper bounds of the fields are hard: a cell file above them is not loaded.
    """

    workspace_min_m: Vec3  # of the TCP
    workspace_max_m: Vec3
    planes: tuple[PlaneSection, ...] = Field((), max_length=16)  # planes inside the box
    joint_speed_share: Fraction = 0.5  # share of robot.joint_speed_max_deg_s, for measured speeds
    step_m: float = Field(0.02, gt=0.0, le=0.2)
    step_deg: float = Field(10.0, gt=0.0, le=90.0)
    speed_m_s: float = Field(0.25, gt=0.0, le=2.0)
    speed_deg_s: float = Field(60.0, gt=0.0, le=360.0)
    accel_m_s2: float = Field(2.0, gt=0.0, le=20.0)  # of commanded set points
    accel_deg_s2: float = Field(480.0, gt=0.0, le=5000.0)
    tracking_m: float = Field(0.01, gt=0.0, le=0.2)  # between commanded and measured pose
    tracking_deg: float = Field(5.0, gt=0.0, le=90.0)
    tether_m: float = Field(1.0, gt=0.0, le=5.0)  # of the flange, from the pose at arming
    # Rotation of the flange from there: below 180, because larger rotations are ambiguous.
    tether_deg: float = Field(150.0, gt=0.0, le=175.0)
    force_N: float = Field(50.0, gt=0.0, le=1000.0)
    torque_Nm: float = Field(10.0, gt=0.0, le=100.0)
    move_rise_N: float = Field(20.0, gt=0.0, le=1000.0)  # rise above the lowest force of a move
    # Above 50 N or 250 mm/s: the risk assessment of this cell that permits it.
    risk_assessment: str = Field("", max_length=500)

    @model_validator(mode="after")
    def _more_than_usual_is_assessed(self) -> "LimitsSection":
        for name, value, most, unit in (
            ("force_N", self.force_N, USUAL_FORCE_N, "N"),
            ("speed_m_s", self.speed_m_s, USUAL_SPEED_M_S, "m/s"),
        ):
            if value > most and not self.risk_assessment.strip():
                raise ValueError(
                    f"{name} is {value:g} {unit}: above {most:g} {unit} name the risk assessment "
                    "of this cell in limits.risk_assessment (a text: its title, date, author), or "
                    "write less"
                )
        return self

    @model_validator(mode="after")
    def _box_is_not_empty(self) -> "LimitsSection":
        for axis, low, high in zip("xyz", self.workspace_min_m, self.workspace_max_m, strict=True):
            if max(abs(low), abs(high)) > FARTHEST_WORKSPACE_M:
                raise ValueError(
                    f"workspace from {low} to {high} m along {axis}: no arm reaches farther than "
                    f"{FARTHEST_WORKSPACE_M:g} m; is that in millimetres?"
                )
            if not low < high:
                raise ValueError(f"workspace is empty along {axis}: {low} m is not below {high} m")
        return self


class GatewaySection(Scales):
    """Address of the controller, and the scales requested from it (design section 3)."""

    host: str = "192.168.0.2"
    port: int = Field(49152, ge=8192, le=65535)
    arm: int = Field(1, ge=0, le=999)  # its number, fm.num in fm.config: detects swapped cables
    # Longest time between two set points that the controller accepts; within it none moves farther
    # than limits.speed_m_s allows; the controller refuses one that does.
    segment_s: float = Field(0.1, ge=0.02, le=1.0)
    # Least planned time of a motion that blends into the next one: with less the controller may
    # stop with E1117 (process time over). `forcemesh probe` measures it.
    least_segment_s: float = Field(0.03, ge=0.002, le=0.5)
    # Slowest program speed that the controller keeps: 0.01 % of 12 m/s.
    least_speed_m_s: float = Field(0.0012, ge=0.0001, le=0.01)
    max_unexecuted_setpoints: int = Field(1, ge=1, le=10)
    watchdog_s: float = Field(0.25, ge=0.1, le=2.0)
    heartbeat_s: float = Field(0.04, gt=0.0, le=0.1)
    # Command 4 also without force feedback in the controller, rates.status_hz times a second: for a
    # display or a log there. No motion follows from it; docs/controller.md has what it costs.
    send_wrench: bool = False
    dedicated_signals: Dedicated = ()  # used by the controller itself: its DEFSIG lists them
    # plain: the specification's packet, of controller/plain.as, which has no protection:
    # no watchdog, hold, limits, test of reach, hello, check of IDs, status or address of the PC
    # (docs/controller.md). The limits of the cell file must be lower, see controller/plain.py.
    protocol: Literal["forcemesh", "plain"] = "forcemesh"
    plain: PlainSection = PlainSection()  # characters and scales of that packet


# Each one's input is the output of the one before. Robot and arbiter never share a process.
NEIGHBOURS = (("wrench", "regulator"), ("regulator", "arbiter"), ("wrench", "regulator", "arbiter"))

Cores = Annotated[tuple[Annotated[int, Field(ge=0, le=1023)], ...], Field(min_length=1)]


class CellConfig(ConfigSection):
    """One robot cell."""

    cell: str = Field(pattern=CELL_NAME)
    bus: BusSection = BusSection()
    panel: PanelSection = PanelSection()
    recorder: RecorderSection = RecorderSection()
    roles: RolesSection
    rates: Rates = Rates()
    deadlines: Deadlines = Deadlines()
    cores: dict[str, Cores] = Field({})  # processor cores of a role's process; without an entry all
    # Roles that `forcemesh up` runs in one process, such as [wrench, regulator]: less work for the
    # processor, but what ends one of them ends all. The default is a process for each role.
    together: tuple[str, ...] = ()
    robot: RobotSection
    sensor: SensorSection
    tool: ToolSection
    gravity_direction_in_base: Direction = DOWN  # unit vector; an arm on a wall: [1, 0, 0]
    payload: CellPayload  # used until a calibration exists
    # In the file: the name of a calibration file next to it, written by `forcemesh calibrate`.
    calibration: CellCalibration = None
    filter: FilterSection = FilterSection()
    contact: ContactSection
    force: ForceSection = ForceSection()
    limits: LimitsSection
    signals: Signals = Field({})  # digital; an output that is not here cannot be set
    gateway: GatewaySection | None = None
    sim: SimSection | None = None

    def __hash__(self) -> int:
        """Return the hash of the name, which equal cells share: a table of cores has none."""
        return hash(self.cell)

    @model_validator(mode="after")
    def _payload_has_its_gravity(self) -> "CellConfig":
        known = {"gravity_direction_in_base": self.gravity_direction_in_base}
        object.__setattr__(self, "payload", self.payload.model_copy(update=known))
        return self

    @model_validator(mode="after")
    def _roles_have_their_sections(self) -> "CellConfig":
        if self.roles.robot == "gateway" and self.gateway is None:
            raise ValueError("roles.robot is gateway, so a section `gateway` is needed")
        if "sim" in (self.roles.robot, self.roles.sensor) and self.sim is None:
            raise ValueError("a role is sim, so a section `sim` is needed")
        if self.roles.robot == "external" and self.roles.sensor == "sim":
            raise ValueError(
                "roles.sensor is sim, so roles.robot must be sim or gateway: the simulated sensor "
                "is on a simulated arm"
            )
        if self.roles.robot == "gateway" and self.robot.joints != PACKET_JOINTS:
            raise ValueError(
                f"roles.robot is gateway: the controller's packet has {PACKET_JOINTS} joints, "
                f"{self.robot.model} has {self.robot.joints}; roles.robot must be sim or external"
            )
        if self.sim is not None and self.robot.model == UNKNOWN_ARM:
            raise ValueError(
                f"the section `sim` needs an arm with a model, robot.model is {UNKNOWN_ARM}, "
                f"valid: {', '.join(arm_names())}"
            )
        if self.sim is not None and self.sim.netft and self.roles.sensor != "driver":
            raise ValueError(
                "sim.netft: the simulated sensor serves RDT, so roles.sensor must be driver"
            )
        if self.filter.inertial and self.rates.robot_hz < SLOWEST_INERTIAL_HZ:
            raise ValueError(
                f"filter.inertial: {self.rates.robot_hz:g} Hz is too slow to measure acceleration, "
                f"rates.robot_hz must be at least {SLOWEST_INERTIAL_HZ:g}"
            )
        is_sim = self.roles.sensor == "sim" or (self.sim is not None and self.sim.netft)
        noiseless = is_sim and self.sim is not None and self.sim.noiseless
        if noiseless and self.sensor.frozen_s > 0.0:
            raise ValueError("sensor.frozen_s must be 0: the simulated sensor has no noise")
        return self

    @field_validator("cores")
    @classmethod
    def _cores_are_of_roles(cls, cores: dict[str, Cores]) -> dict[str, Cores]:
        valid = (*ROLES, *HELPERS)
        if unknown := [role for role in cores if role not in valid]:
            raise ValueError(f"{', '.join(unknown)}: not a role, valid: {', '.join(valid)}")
        return cores

    @model_validator(mode="after")
    def _together_are_neighbours(self) -> "CellConfig":
        roles = self.together
        if roles and roles not in NEIGHBOURS:
            valid = " or ".join(f"[{', '.join(each)}]" for each in NEIGHBOURS)
            raise ValueError(f"together: [{', '.join(roles)}] must be {valid}")
        if bound := [role for role in roles[1:] if role in self.cores]:
            raise ValueError(
                f"cores.{bound[0]}: it shares the process of {roles[0]}, so cores.{roles[0]} counts"
            )
        return self

    @model_validator(mode="after")
    def _set_point_is_below_the_ceiling(self) -> "CellConfig":
        most_N = SETPOINT_SHARE * self.limits.force_N
        if self.force.setpoint_max_N > most_N:
            raise ValueError(
                f"force.setpoint_max_N is {self.force.setpoint_max_N:g} N, at most {most_N:g} N is "
                f"allowed ({SETPOINT_SHARE:g} of limits.force_N, {self.limits.force_N:g} N): "
                "overshoot near the ceiling would stop the arm"
            )
        return self

    @model_validator(mode="after")
    def _approach_is_no_other_unit(self) -> "CellConfig":
        allowed_m_s = self.plant.approach_limit_m_s
        value, most = self.force.approach_m_s, UNIT_SLIP * allowed_m_s
        if value > most:
            asked = question("approach_m_s", value, most)
            raise ValueError(
                f"force.approach_m_s is {value:g}: stiffness and delay of this cell allow "
                f"{allowed_m_s:.2g}{asked}"
            )
        return self

    @model_validator(mode="after")
    def _sensor_carries_its_numbers(self) -> "CellConfig":
        payloads: dict[str, Payload] = {"payload": self.payload}
        if isinstance(self.calibration, CalibrationSection):
            payloads["calibration.payload"] = self.calibration.payload
        limits = {"limits.force_N": self.limits.force_N, "limits.torque_Nm": self.limits.torque_Nm}
        limits |= {f"force.{name}": getattr(self.force, name) for name in FORCES}
        is_driven = self.roles.sensor == "driver"
        if mistake := sensor_mistake(self.sensor, payloads, limits, is_driven=is_driven):
            raise ValueError(mistake)
        return self

    @model_validator(mode="after")
    def _plain_is_bounded(self) -> "CellConfig":
        if self.gateway is None or self.gateway.protocol != "plain":
            return self
        limits = {
            name: getattr(getattr(self, section), field)
            for name in plain.MOST
            for section, field in (name.split("."),)
        }
        if mistake := plain.terms_mistake(self.robot.hosts, limits):
            raise ValueError(mistake)
        if self.signals:
            raise ValueError(
                "signals: gateway.protocol is plain, whose packet has no signals: remove the "
                "section, or use protocol forcemesh"
            )
        return self

    @model_validator(mode="after")
    def _signals_can_be_used(self) -> "CellConfig":
        follows = {} if self.sim is None else self.sim.inputs_follow
        dedicated = () if self.gateway is None else self.gateway.dedicated_signals
        if mistake := signals_mistake(self.signals, dedicated, follows):
            raise ValueError(mistake)
        return self

    @property
    def plant(self) -> Plant:
        """What the file states about arm, link, filter and contact."""
        contact, rates, gateway, rounding_m = self.contact, self.rates, self.gateway, 0.0
        if gateway is not None and gateway.protocol != "plain":
            rounding_m = 0.5e-3 * sqrt(3.0) / gateway.position_per_mm  # half a cube's diagonal
        return Plant(
            robot_delay_s=self.robot.delay_s,
            lag_s=self.robot.lag_s,
            chain_s=self.force.chain_s,
            median_s=(self.filter.median - 1) / 2 / rates.sensor_hz,
            lowpass_s=self.filter.lowpass_s,
            control_hz=rates.control_hz,
            robot_hz=rates.robot_hz,
            sensor_hz=rates.sensor_hz,
            stiffness_N_m=contact.stiffness_N_m,
            tilt_stiffness_Nm_rad=contact.tilt_stiffness_Nm_rad,
            inertia_kg=contact.inertia_kg,
            inertia_kg_m2=contact.inertia_kg_m2,
            bandwidth_rad_s=self.robot.bandwidth_rad_s,
            rounding_m=rounding_m,
            approach_budget_N=self.force.approach_budget_N,
            approach_asked_m_s=self.force.approach_m_s,
        )

    def rate_hz(self, topic: Topic[Any]) -> float:
        """Return the rate of a topic in this cell [Hz]."""
        rate: float = getattr(self.rates, f"{topic.rate}_hz")
        return rate

    def stale_after_s(self, topic: Topic[Any]) -> float:
        """Return the age [s] above which a topic is stale: three periods, or its deadline."""
        deadline_s: float = getattr(self.deadlines, f"{topic.deadline}_s")
        return max(SHORTEST_DEADLINE_PERIODS / self.rate_hz(topic), deadline_s)
