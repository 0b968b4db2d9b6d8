"""Coupling of the plate model to MuJoCo: reads the disc's motion, applies the contact wrench."""

import math

import numpy as np

from sim.robot.engine import mujoco
from sim.robot.plate import Disc, SprungPlate
from sim.robot.scene import plate_at_rest
from sim.robot.settings import SimSettings

FAR_M = 0.02
_SITE = mujoco.mjtObj.mjOBJ_SITE


class PlateContact:
    """Plate under the disc: its pose, its springs, and the contact wrench of each step.

    It acts between `mj_step1` and `mj_step2`, when MuJoCo has computed the state but not used the
    forces yet. The wrench acts on the massless body `disc`, whose origin is the TCP, so the
    force/torque sensor measures it like any other load on the tool.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, settings: SimSettings) -> None:
        """Place the undeflected plate; `point_m` and `springs` may be changed at any time."""
        rest = plate_at_rest(settings)
        self.point_m, self.normal = rest.point_m.copy(), rest.normal
        self.springs = SprungPlate.of(settings)
        self._model, self._data, self._R_base_plate = model, data, rest.R_base_plate
        self._radius_m = settings.disc_radius_m
        self._tcp = model.site("tcp").id
        # Views of the state: MuJoCo never reallocates it.
        self._p_tcp_m, self._z_tcp = data.site_xpos[self._tcp], data.site_xmat[self._tcp][2::3]
        self._pushed = data.xfrc_applied[model.body("disc").id].reshape(2, 3)
        self._moves = np.zeros((4, 3))  # disc in base; the next two lines name its rows
        self._from_plate, self._back = self._moves[:2]
        self._twist = self._moves[2:].reshape(6)  # MuJoCo's order: rotation, translation

    def act(self) -> None:
        """Apply the contact wrench to the disc for the model's next time step."""
        if self.springs.rests and self._is_far():
            self._pushed[:] = 0.0
            return
        dt_s = self._model.opt.timestep
        push = self.springs.step(self._disc_after(dt_s), dt_s)
        both = np.array((push.force_N, push.torque_Nm))
        self._pushed[:] = both.dot(self._R_base_plate.T)  # twice as fast as `@`

    def _is_far(self) -> bool:
        """Return whether the disc cannot reach the plate within the step at its current speed."""
        from_plate = self._p_tcp_m - self.point_m
        return float(from_plate.dot(self.normal)) > self._radius_m + FAR_M

    def _disc_after(self, dt_s: float) -> Disc:
        """Return the disc extrapolated by its velocity to the end of the step."""
        np.subtract(self._p_tcp_m, self.point_m, out=self._from_plate)
        np.negative(self._z_tcp, out=self._back)
        mujoco.mj_objectVelocity(self._model, self._data, _SITE, self._tcp, self._twist, 0)
        rows = self._moves.dot(self._R_base_plate).tolist()
        (x, y, z), (bx, by, bz), (wx, wy, wz), (vx, vy, vz) = rows
        bx, by, bz = (
            bx + dt_s * (wy * bz - wz * by),
            by + dt_s * (wz * bx - wx * bz),
            bz + dt_s * (wx * by - wy * bx),
        )
        size = math.hypot(bx, by, bz)
        return Disc(
            centre_m=(x + dt_s * vx, y + dt_s * vy, z + dt_s * vz),
            back=(bx / size, by / size, bz / size),
            velocity_m_s=(vx, vy, vz),
            turn_rad_s=(wx, wy, wz),
            radius_m=self._radius_m,
        )
