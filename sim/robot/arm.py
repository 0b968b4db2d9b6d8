"""Simulated arm: joint commands in, one millisecond of physics per step, measurements out.

Lag of the robot behind its commands, measured at home (see the unit tests): dead time + half the
smoothing window + servo lag. The gain rule of force control needs that sum and the bandwidth;
both are computed here from the settings.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, is_finite
from common.motion.kinematics import JOINTS, ArmKinematics
from forcemesh.errors import SimulationError
from sim.robot.contact import lift_off_m
from sim.robot.engine import mujoco
from sim.robot.ft_sensor import FtSample, FtSensor
from sim.robot.plate_contact import PlateContact
from sim.robot.scene import build_model, home_rad
from sim.robot.set_points import SetPointLine
from sim.robot.settings import TICK_S, SimSettings

STILL_RAD_S = 0.002  # below this joint speed, with no active command, the arm is at rest
# -3 dB of a critically damped servo: sqrt(sqrt(2) - 1) times its natural frequency 2 / lag.
_SERVO_BANDWIDTH = 2.0 * (2.0**0.5 - 1.0) ** 0.5


def motion_lag_s(settings: SimSettings) -> float:
    """Return the area lag from command to flange without the dead time [s].

    The integral of 1 - y/y_end after a step: half the smoothing window plus kv/kp of the servo.
    """
    return (settings.smoothing_ticks - 1) / 2 * TICK_S + settings.servo_lag_s


def bandwidth_rad_s(settings: SimSettings) -> float:
    """Return the -3 dB frequency of the flange's motion, smoothing included [rad/s].

    |H| = |sin(w T/2) / (w T/2)| / (1 + (w lag/2)^2) = 1/sqrt(2), solved by bisection.
    """
    window_s, lag_s = settings.smoothing_ticks * TICK_S, settings.servo_lag_s
    low, high = 0.0, _SERVO_BANDWIDTH / lag_s  # the servo alone bounds it
    for _ in range(60):
        w = 0.5 * (low + high)
        gain = np.sinc(w * window_s / 2 / np.pi) / (1.0 + (w * lag_s / 2) ** 2)
        low, high = (w, high) if gain > 0.5**0.5 else (low, w)
    return 0.5 * (low + high)


@dataclass(frozen=True, slots=True)
class TrueWrench:
    """Ground-truth wrench of the environment on the tool: base axes, about the TCP, noise-free."""

    force_N: Array
    torque_Nm: Array


class SimArm:
    """RS007L in its cell. Pure and deterministic: the state changes only in `step`."""

    def __init__(self, settings: SimSettings, *, seed: int) -> None:
        """Build the cell with the arm at rest at home. Raises SimulationError on bad settings."""
        self.settings = settings
        self.kinematics = ArmKinematics()
        self.model = build_model(settings)
        self.data = mujoco.MjData(self.model)
        self.plate = PlateContact(self.model, self.data, settings)
        self.ft_sensor = FtSensor(settings.sensor, seed=seed)
        self.ticks = 0
        home = home_rad(settings)
        violation = self.kinematics.limit_violation(home)
        if violation:
            raise SimulationError(f"simulated cell: home_deg is out of reach: {violation}")
        self._command = self._taken = home
        # Views of the state: MuJoCo never reallocates it.
        self._q: Array = self.data.qpos[:JOINTS]
        self._speed_rad_s: Array = self.data.qvel[:JOINTS]
        self._ctrl, self._on_tool = self.data.ctrl, self.data.sensordata[:6]
        self._line = SetPointLine(
            home, delay_ticks=settings.delay_ticks, smoothing_ticks=settings.smoothing_ticks
        )
        self._T_flange_tcp = settings.T_flange_sensor * settings.T_sensor_tcp
        self._warnings = self.data.warning.number  # how many of each kind so far
        self._tool, self._disc = self.model.body("tool").id, self.model.body("disc").id
        self._tcp = self.model.site("tcp").id
        self._q[:] = self._ctrl[:] = home
        mujoco.mj_forward(self.model, self.data)

    @property
    def time_s(self) -> float:
        """Simulated time since start [s]."""
        return self.ticks * TICK_S

    @property
    def q(self) -> Array:
        """Measured joint angles [rad]. Shape (6,)."""
        return self._q.copy()

    @property
    def q_command(self) -> Array:
        """Last commanded joint angles [rad]. Shape (6,)."""
        return self._command.copy()

    @property
    def T_base_flange(self) -> pin.SE3:
        """Measured flange pose: forward kinematics of the current joint angles."""
        return self.kinematics.flange_pose(self.q)

    @property
    def T_base_tcp(self) -> pin.SE3:
        """True pose of the tool centre point: centre of the disc's face, z out of the tool."""
        return self.T_base_flange * self._T_flange_tcp

    @property
    def moving(self) -> bool:
        """Whether a command is active or a joint is moving."""
        return not self._line.settled or max(map(abs, self._speed_rad_s.tolist())) > STILL_RAD_S

    @property
    def lift_off_m(self) -> float:
        """True distance from the disc's lowest point to the undeflected plate [m]; > 0 is free."""
        return lift_off_m(
            self.T_base_tcp,
            plate_point_m=self.plate.point_m,
            plate_normal=self.plate.normal,
            disc_radius_m=self.settings.disc_radius_m,
        )

    def command_joints(self, q: Array) -> None:
        """Set the commanded joint angles [rad], shape (6,); they hold until the next command.

        A read-only array that is the same object as the last command is not checked again.

        Raises SimulationError if a number is not finite or outside a joint limit.
        """
        if q is self._taken and not q.flags.writeable:
            return
        command = np.array(q, dtype=float)
        if command.shape != (JOINTS,) or not is_finite(command.tolist()):
            raise SimulationError(f"joint command must be six finite angles, got {q}")
        violation = self.kinematics.limit_violation(command)
        if violation:
            raise SimulationError(f"joint command rejected: {violation}")
        self._command, self._taken = command, q

    def step(self) -> None:
        """Advance by one millisecond. Raises SimulationError if the simulation diverged."""
        self._ctrl[:] = self._line.push(self._command)
        self.advance()
        self.ticks += 1
        self._check()

    def advance(self) -> None:
        """Advance by one time step of the model, without new set points."""
        mujoco.mj_step1(self.model, self.data)
        self.plate.act()
        mujoco.mj_step2(self.model, self.data)

    def sample_ft(self) -> FtSample:
        """Return a new sample of the force/torque sensor for the last step."""
        load = -self._on_tool  # MuJoCo: robot on tool; a real sensor: tool on robot
        return self.ft_sensor.sample(force_N=load[:3], torque_Nm=load[3:])

    def true_wrench(self) -> TrueWrench:
        """Return the wrench of the plate and of applied forces on the tool, for the last step."""
        data, tcp = self.data, self.data.site_xpos[self._tcp]
        plate, pushed = data.xfrc_applied[self._disc], data.xfrc_applied[self._tool]
        torque = plate[3:] + pushed[3:] + np.cross(data.xipos[self._tool] - tcp, pushed[:3])
        return TrueWrench(force_N=plate[:3] + pushed[:3], torque_Nm=torque)

    def _check(self) -> None:
        if not any(self._warnings.tolist()):
            return
        kinds = mujoco.mjtWarning
        for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC):
            if self.data.warning[kind].number:
                raise SimulationError(
                    f"the simulation diverged at {self.time_s:.3f} s ({kind.name[7:]}):"
                    " reduce contact stiffness, time step or command acceleration"
                )
