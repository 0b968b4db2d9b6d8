"""3D view: arm, tool, force and torque arrows, workspace, contact. The only user of mjviser.

mjviser is young: it is used only to draw a MuJoCo model and to place its bodies. Of MuJoCo only the
forward kinematics is used: joint angles in, poses of bodies out; no physics is stepped.
"""

import math
from itertools import combinations, product
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import viser
from mjviser import ViserMujocoScene

from common.config.arm import UNKNOWN_ARM, model_file, read_arm
from common.config.cell import CellConfig
from common.config.cell_sim import SimSection
from common.motion.frames import Array, quaternion_from_R
from common.motion.kinematics import ArmKinematics
from forcemesh.messages import RobotState, WrenchAtTcp
from services.panel.readout import Readout, Tool
from services.panel.viewer import put
from services.panel.watch import Snapshot

M_PER_N, M_PER_NM = 0.0045, 0.2  # length of the arrows
LABEL_M = np.array([-0.07, 0.07, 0.0])  # offset from the arrow
LEAST_N, LEAST_NM = 0.5, 0.05  # smaller values are noise
STILL_RAD = 1e-4  # no update is sent for smaller motion
TOUCHED_RADIUS_M = 0.03
FORCE_RGB, TORQUE_RGB = (224, 49, 49), (112, 72, 232)
BOX_RGB, TOUCH_RGB = (77, 171, 247), (64, 192, 87)
FLOOR_Z_M = -0.36
PLATE_HALF_M = (0.08, 0.08, 0.008)
SENSOR_RADIUS_M = 0.040

BLUE, STEEL, DARK = [0.10, 0.36, 0.80, 1.0], [0.72, 0.74, 0.77, 1.0], [0.17, 0.18, 0.20, 1.0]
ORANGE, GREEN = [0.93, 0.55, 0.13, 1.0], [0.20, 0.58, 0.34, 1.0]
Wxyz = tuple[float, float, float, float]
CYLINDER, BOX = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
MESH = mujoco.mjtGeom.mjGEOM_MESH


class Scene:
    """Contents of the 3D view; shared by all pages."""

    def __init__(self, server: viser.ViserServer, cell: CellConfig) -> None:
        """Build the scene."""
        self._server = server
        self._readout = Readout(cell)
        self._q: Array | None = None
        _set_the_stage(server)
        self._arm = None if cell.robot.model == UNKNOWN_ARM else DrawnArm(server, cell)
        _add_workspace(server, cell)
        nowhere = np.zeros((1, 2, 3), dtype=np.float32)
        self._force = server.scene.add_arrows(
            "/force", nowhere, FORCE_RGB, shaft_radius=0.014, head_radius=0.03, head_length=0.05
        )
        self._torque = server.scene.add_arrows(
            "/torque", nowhere, TORQUE_RGB, shaft_radius=0.008, head_radius=0.02, head_length=0.035
        )
        self._label = server.scene.add_label("/force label", "")
        self._tcp = server.scene.add_frame(
            "/tcp", axes_length=0.07, axes_radius=0.0025, origin_radius=0.005
        )
        self._touched = server.scene.add_cylinder(
            "/touched", radius=TOUCHED_RADIUS_M, height=0.002, color=TOUCH_RGB, opacity=0.45
        )
        for handle in (self._force, self._torque, self._label, self._touched):
            handle.visible = False

    def draw(self, snapshot: Snapshot) -> None:
        """Show a snapshot; without a fresh robot state the scene does not change."""
        robot = snapshot.robot.fresh
        if robot is None:
            return
        tool = self._readout.tool(robot, snapshot.wrench.fresh or WrenchAtTcp())
        with self._server.atomic():
            if self._has_moved(robot):
                self._place(robot, tool)
            self._draw_wrench(tool)
            self._draw_touch(snapshot, tool)

    def _has_moved(self, robot: RobotState) -> bool:
        q = np.array(robot.joint_rad)
        is_same = self._q is not None and self._q.shape == q.shape
        if is_same and float(np.abs(q - self._q).max(initial=0.0)) < STILL_RAD:
            return False
        self._q = q
        return True

    def _place(self, robot: RobotState, tool: Tool) -> None:
        self._tcp.position = tool.p_tcp_m
        self._tcp.wxyz = _wxyz(tool.R_base_tcp)
        if self._arm is not None:
            self._arm.draw(np.array(robot.joint_rad))

    def _draw_wrench(self, tool: Tool) -> None:
        """Draw the force from the contact, in the direction in which it pushes the tool."""
        arrow_m = M_PER_N * tool.force_N
        strong = float(np.linalg.norm(tool.force_N))
        turning = float(np.linalg.norm(tool.torque_Nm))
        put(self._force, visible=strong > LEAST_N)
        put(self._torque, visible=turning > LEAST_NM)
        put(self._label, visible=strong > LEAST_N)
        if strong > LEAST_N:
            self._force.points = _arrow(tool.contact_m, arrow_m)
            self._label.position = tool.contact_m + 0.5 * arrow_m + LABEL_M
            put(self._label, text=f"{strong:.1f} N")
        if turning > LEAST_NM:
            self._torque.points = _arrow(tool.p_tcp_m, M_PER_NM * tool.torque_Nm)

    def _draw_touch(self, snapshot: Snapshot, tool: Tool) -> None:
        """Show the contact surface at the tool while the regulator reports contact."""
        target = snapshot.target.fresh
        touches = target is not None and target.contact == "contact"
        put(self._touched, visible=touches)
        if touches:
            self._touched.position = tool.contact_m
            self._touched.wxyz = _wxyz(tool.R_base_tcp)


def _set_the_stage(server: viser.ViserServer) -> None:
    """Set floor and camera."""
    server.scene.set_up_direction("+z")
    server.scene.configure_default_lights(cast_shadow=False)  # a lab PC may have no GPU
    server.scene.add_grid(
        "/floor",
        width=4.0,
        height=4.0,
        cell_size=0.1,
        section_size=0.5,
        position=(0.0, 0.0, FLOOR_Z_M),
        infinite_grid=True,
        fade_distance=6.0,
    )
    server.initial_camera.position = (1.05, 1.5, 0.62)
    server.initial_camera.look_at = (0.0, 0.22, 0.06)
    server.initial_camera.up = (0.0, 0.0, 1.0)


def _add_workspace(server: viser.ViserServer, cell: CellConfig) -> None:
    """Draw the edges of the workspace box and the limiting planes."""
    low, high = np.array(cell.limits.workspace_min_m), np.array(cell.limits.workspace_max_m)
    server.scene.add_line_segments(
        "/workspace", box_edges(low, high), BOX_RGB, thickness=1.5, thickness_units="screen"
    )
    for number, plane in enumerate(cell.limits.planes):
        normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
        server.scene.add_box(
            f"/wall {number}",
            dimensions=(0.5, 0.5, 0.002),
            color=(250, 82, 82),
            opacity=0.25,
            position=plane.point_m,
            wxyz=_wxyz(_R_with_z(normal)),
        )


def box_edges(low: Array, high: Array) -> Any:
    """Return the twelve edges of a box as pairs of points. Shape (12, 2, 3)."""
    corners = np.array(list(product(*zip(low, high, strict=True))))
    return np.array([pair for pair in combinations(corners, 2) if np.sum(pair[0] != pair[1]) == 1])


def _arrow(start_m: Array, vector_m: Array) -> Any:
    return np.array([[start_m, start_m + vector_m]], dtype=np.float32)


# --- the arm --------------------------------------------------------------------------------------


class DrawnArm:
    """Arm with sensor, tool and simulated plate, drawn by a MuJoCo model."""

    def __init__(self, server: viser.ViserServer, cell: CellConfig) -> None:
        """Build the model and draw it at home."""
        name = cell.robot.model
        spec = mujoco.MjSpec.from_file(str(model_file(name)))
        home_rad = np.radians(read_arm(name).home_deg)
        _add_tool(spec, cell)
        if cell.sim is not None:
            T_base_tcp = ArmKinematics(name).flange_pose(home_rad) * cell.tool.T_flange_tcp.pose
            _add_surface(spec, cell.sim, T_base_tcp.translation)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._drawn = ViserMujocoScene(server, self.model, num_envs=1)
        self._drawn.camera_tracking_enabled = False
        self.draw(home_rad)

    def draw(self, joint_rad: Array) -> None:
        """Draw at joint angles [rad], shape (n,); another arm is not drawn in a wrong pose."""
        if len(joint_rad) == self.model.nq:
            self.data.qpos[:] = joint_rad
            mujoco.mj_kinematics(self.model, self.data)
            self._drawn.update_from_mjdata(self.data)


def _add_tool(spec: mujoco.MjSpec, cell: CellConfig) -> None:
    """Attach sensor and tool to the flange, by the cell file's frames."""
    T_flange_sensor = cell.sensor.T_flange_sensor.pose
    T_sensor_tcp = T_flange_sensor.inverse() * cell.tool.T_flange_tcp.pose
    flange = spec.site("flange").parent
    height = max(0.012, float(T_flange_sensor.translation[2]))
    _show(flange, CYLINDER, [SENSOR_RADIUS_M, height / 2, 0], pos=[0, 0, height / 2], rgba=BLUE)
    tool = flange.add_body(name="tool", pos=T_flange_sensor.translation)
    tool.quat = _wxyz(T_flange_sensor.rotation)
    tool.mass, tool.inertia, tool.explicitinertial = 1.0, [0.01] * 3, True  # required, not used
    length = float(np.linalg.norm(T_sensor_tcp.translation))
    direction = np.asarray(T_sensor_tcp.translation) / max(length, 1e-6)
    quat = _wxyz(_R_with_z(direction))
    plate, rod = [SENSOR_RADIUS_M, 0.005, 0], max(0.01, length - 0.02)
    _show(tool, CYLINDER, plate, pos=direction * 0.005, rgba=STEEL, quat=quat)
    middle = direction * (0.01 + rod / 2)
    _show(tool, CYLINDER, [0.012, rod / 2, 0], pos=middle, rgba=STEEL, quat=quat)
    face = [0.025 if cell.sim is None else cell.sim.disc_radius_m, 0.005, 0]
    middle, quat = T_sensor_tcp.act(np.array([0.0, 0.0, -0.005])), _wxyz(T_sensor_tcp.rotation)
    _show(tool, CYLINDER, face, pos=middle, rgba=ORANGE, quat=quat)


def _add_surface(spec: mujoco.MjSpec, sim: SimSection, p_tcp_m: Array) -> None:
    """Draw the simulated plate, or curved surface, below the tool at home, and its stand."""
    world, tilt = spec.worldbody, math.radians(sim.tilt_deg)
    rim_m = sim.disc_radius_m * math.tan(tilt)
    x, y, z = (float(v) for v in p_tcp_m - np.array([0.0, 0.0, sim.gap_m + rim_m]))
    quat = (math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0)
    thick = PLATE_HALF_M[2]
    middle = [x, y + thick * math.sin(tilt), z - thick * math.cos(tilt)]
    top = z - 0.085
    if sim.surface == "plane":
        _show(world, BOX, [*PLATE_HALF_M], pos=middle, rgba=GREEN, quat=quat)
    else:
        spec.add_mesh(name="curved", uservert=np.ravel(sim.curved_points_m()))
        body = world.add_body(name="curved", pos=[x, y, z], quat=quat)
        body.add_geom(type=MESH, meshname="curved", rgba=GREEN, contype=0, conaffinity=0, group=1)
    for sx, sy in product((-0.05, 0.05), repeat=2):
        spring = [x + sx, y + sy, (top + z - 0.016) / 2]
        _show(world, CYLINDER, [0.009, (z - 0.016 - top) / 2, 0], pos=spring, rgba=STEEL)
    half = (top - FLOOR_Z_M) / 2
    for width, height, centre, rgba in (
        (0.09, 0.010, top - 0.010, DARK),
        (0.035, half, FLOOR_Z_M + half, STEEL),
        (0.11, 0.010, FLOOR_Z_M + 0.010, DARK),
    ):
        _show(world, BOX, [width, width, height], pos=[x, y, centre], rgba=rgba)


def _show(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: list[float],
    *,
    pos: list[float] | Array,
    rgba: list[float],
    quat: Wxyz = (1.0, 0.0, 0.0, 0.0),
) -> None:
    drawn_only = {"contype": 0, "conaffinity": 0, "group": 1}
    body.add_geom(type=kind, size=size, pos=pos, rgba=rgba, quat=quat, **drawn_only)


def _R_with_z(z: Array) -> Array:
    """Return any rotation whose z axis points along a unit vector. Shape (3, 3)."""
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), z)
    return np.asarray(turn.toRotationMatrix())


def _wxyz(R: Array) -> Wxyz:
    x, y, z, w = quaternion_from_R(R)
    return (w, x, y, z)
