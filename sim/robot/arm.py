"""Simulated arm: joint commands in, one millisecond of physics per step, measurements out.

Lag of the robot behind its commands, measured at home (see the unit tests): dead time + half the
smoothing window + servo lag.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from forcemesh.errors import SimulationError
from sim.robot.curved import SprungSurface
from sim.robot.engine import mujoco
from sim.robot.ft_sensor import FtSensor
from sim.robot.plate import Disc, SprungPlate, lift_off_m
from sim.robot.scene import build_model, plate_at_rest
from sim.robot.settings import TICK_S, SimSettings

FAR_M = 0.02  # from the plate: no contact within a step at any speed of the arm
STILL_RAD_S = 0.002  # below this joint speed, with no active command, the arm is at rest


class SetPointLine:
    """Dead time and smoothing of joint commands in a ring buffer, exact to the tick.

    A command pushed now reaches the servos `delay_ticks` later; the average over
    `smoothing_ticks` then spreads a step over that many ticks.
    """

    def __init__(self, start: Array, *, delay_ticks: int, smoothing_ticks: int) -> None:
        """Fill the line with a constant command. Shape (6,)."""
        self._newest = np.array(start, dtype=float)
        self._ticks = delay_ticks + smoothing_ticks
        # Every entry is stored twice, so that any window of the ring is one slice.
        self._ring = np.tile(self._newest, (2 * self._ticks, 1))
        self._mean = np.full(smoothing_ticks, 1.0 / smoothing_ticks)
        self._head = 0
        self._same = self._ticks  # how many of the newest entries are equal
        self.settled = True  # all of them

    def push(self, command: Array) -> Array:
        """Take this tick's command, return this tick's servo set point. Shape (6,).

        The caller must not modify a command in place: an identical object is not compared again.
        """
        is_same = command is self._newest or command.tolist() == self._newest.tolist()
        self._same = self._same + 1 if is_same else 1
        self.settled = self._same >= self._ticks
        self._newest = command
        if self._same > self._ticks:  # the ring is already full of this command
            return command
        self._ring[self._head :: self._ticks] = command
        self._head = oldest = (self._head + 1) % self._ticks
        if self.settled:
            return command
        return np.asarray(self._mean.dot(self._ring[oldest : oldest + len(self._mean)]))


class PlateContact:
    """Surface under the disc: its pose, its springs, and the contact wrench of each step.

    It acts between `mj_step1` and `mj_step2`, when MuJoCo has computed the state but not used the
    forces yet. The wrench acts on the massless body `disc`, whose origin is the TCP, so the
    force/torque sensor measures it like any other load on the tool.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, settings: SimSettings) -> None:
        """Place the undeflected surface; `point_m` and `springs` may be changed at any time."""
        rest = plate_at_rest(settings)
        self.point_m, self.normal = rest.point_m.copy(), rest.normal
        self.springs = SprungPlate.of(settings)
        self._curved = None if settings.surface == "plane" else SprungSurface.of(settings)
        self._option, self._R_base_plate = model.opt, rest.R_base_plate
        self._radius_m = settings.disc_radius_m
        # Views of the state: MuJoCo never reallocates it.
        self._disc = data.sensordata[6:].reshape(4, 3)  # rows as in `scene.SENSORS`
        self._pushed = data.xfrc_applied[model.body("disc").id].reshape(2, 3)

    def act(self) -> None:
        """Apply the contact wrench to the disc for the model's next time step.

        The disc is extrapolated by its velocity to the end of the step.
        """
        rows = self._disc.dot(self._R_base_plate).tolist()  # `dot` is twice as fast as `@`
        (x, y, z), (zx, zy, zz), (vx, vy, vz), (wx, wy, wz) = rows  # in plate axes
        ox, oy, oz = self.point_m.dot(self._R_base_plate).tolist()
        springs = self._curved or self.springs
        if z - oz > self._radius_m + FAR_M and springs.rests:
            self._pushed[:] = 0.0
            return
        dt_s = self._option.timestep
        bx = dt_s * (wz * zy - wy * zz) - zx
        by = dt_s * (wx * zz - wz * zx) - zy
        bz = dt_s * (wy * zx - wx * zy) - zz
        size = math.hypot(bx, by, bz)
        disc = Disc(
            centre_m=(x - ox + dt_s * vx, y - oy + dt_s * vy, z - oz + dt_s * vz),
            back=(bx / size, by / size, bz / size),
            velocity_m_s=(vx, vy, vz),
            turn_rad_s=(wx, wy, wz),
            radius_m=self._radius_m,
        )
        push = springs.step(disc, dt_s)
        self._pushed[:] = np.array((push.force_N, push.torque_Nm)).dot(self._R_base_plate.T)

    def lift_off_m(self, T_base_tcp: pin.SE3) -> float:
        """Return the distance from the disc to the undeflected surface [m]; > 0 is free."""
        if self._curved is None:
            return lift_off_m(
                T_base_tcp,
                plate_point_m=self.point_m,
                plate_normal=self.normal,
                disc_radius_m=self._radius_m,
            )
        R = self._R_base_plate.T
        x, y, z = (R @ (T_base_tcp.translation - self.point_m)).tolist()
        bx, by, bz = (-R @ T_base_tcp.rotation[:, 2]).tolist()
        still = (0.0, 0.0, 0.0)
        return self._curved.nearest(Disc((x, y, z), (bx, by, bz), still, still, self._radius_m))[0]


@dataclass(frozen=True, slots=True)
class TrueWrench:
    """Ground-truth wrench of the environment on the tool: base axes, about the TCP, noise-free."""

    force_N: Array
    torque_Nm: Array


class SimArm:
    """An arm in its cell. Pure and deterministic: the state changes only in `step`."""

    def __init__(self, settings: SimSettings, *, seed: int) -> None:
        """Build the cell with the arm at rest at home. Raises SimulationError on bad settings."""
        self.settings = settings
        self.kinematics = ArmKinematics(settings.arm)
        self.model = build_model(settings)
        self.data = mujoco.MjData(self.model)
        self.plate = PlateContact(self.model, self.data, settings)
        self.ticks = 0
        home = settings.home_rad
        violation = self.kinematics.limit_violation(home)
        if violation:
            raise SimulationError(f"simulated cell: home_deg is out of reach: {violation}")
        self._command = self._taken = home
        # Views of the state: MuJoCo never reallocates it.
        self._q: Array = self.data.qpos[: self.kinematics.joints]
        self._speed_rad_s: Array = self.data.qvel[: self.kinematics.joints]
        self._ctrl = self.data.ctrl
        self.ft_sensor = FtSensor(settings, self.data.sensordata[:6], seed=seed)
        self._line = SetPointLine(
            home, delay_ticks=settings.delay_ticks, smoothing_ticks=settings.smoothing_ticks
        )
        self._T_flange_tcp = settings.T_flange_tcp
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
        """Measured joint angles [rad]. Shape (n,)."""
        return self._q.copy()

    @property
    def q_command(self) -> Array:
        """Last commanded joint angles [rad]. Shape (n,)."""
        return self._command.copy()

    @property
    def T_base_flange(self) -> pin.SE3:
        """Measured flange pose: forward kinematics of the current joint angles."""
        return self.kinematics.flange_pose(self._q)

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
        return self.plate.lift_off_m(self.T_base_tcp)

    def command_joints(self, q: Array) -> None:
        """Set the commanded joint angles [rad], shape (n,); they hold until the next command.

        A read-only array that is the same object as the last command is not checked again.

        Raises SimulationError if a number is not finite or outside a joint limit.
        """
        if q is self._taken and not q.flags.writeable:
            return
        command = np.array(q, dtype=float)
        if command.shape != self._q.shape or not all(map(math.isfinite, command.tolist())):
            raise SimulationError(f"joint command must be {len(self._q)} finite angles, got {q}")
        violation = self.kinematics.limit_violation(command)
        if violation:
            raise SimulationError(f"joint command rejected: {violation}")
        self._command, self._taken = command, q

    def step(self) -> None:
        """Advance by one millisecond. Raises SimulationError if the simulation diverged."""
        self._ctrl[:] = self._line.push(self._command)
        mujoco.mj_step1(self.model, self.data)
        self.plate.act()
        mujoco.mj_step2(self.model, self.data)
        self.ticks += 1
        if not any(self._warnings.tolist()):
            return
        kinds = mujoco.mjtWarning
        for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC):
            if self.data.warning[kind].number:
                raise SimulationError(
                    f"the simulation diverged at {self.time_s:.3f} s ({kind.name[7:]}):"
                    " reduce contact stiffness, time step or command acceleration"
                )

    def true_wrench(self) -> TrueWrench:
        """Return the wrench of the plate and of applied forces on the tool, for the last step."""
        data, tcp = self.data, self.data.site_xpos[self._tcp]
        plate, pushed = data.xfrc_applied[self._disc], data.xfrc_applied[self._tool]
        torque = plate[3:] + pushed[3:] + np.cross(data.xipos[self._tool] - tcp, pushed[:3])
        return TrueWrench(force_N=plate[:3] + pushed[:3], torque_Nm=torque)
