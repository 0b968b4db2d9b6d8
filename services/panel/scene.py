"""3D view: arm, tool, force and torque arrows, workspace, contact. The only user of mjviser.

mjviser is young: it is used only to draw a MuJoCo model and to place its bodies.
"""

from typing import Any

import numpy as np
import viser
from mjviser import ViserMujocoScene

from common.config.arm import UNKNOWN_ARM
from common.config.cell import CellConfig
from common.motion.frames import Array, quaternion_from_R
from forcemesh.messages import RobotState
from services.panel.arm_model import FLOOR_Z_M, ArmModel
from services.panel.readout import Readout, Tool
from services.panel.watch import Snapshot

M_PER_N, M_PER_NM = 0.0045, 0.2  # length of the arrows
LABEL_M = np.array([-0.07, 0.07, 0.0])  # offset from the arrow
LEAST_N, LEAST_NM = 0.5, 0.05  # smaller values are noise
STILL_RAD = 1e-4  # no update is sent for smaller motion
TOUCHED_RADIUS_M = 0.03
FORCE_RGB, TORQUE_RGB, BOX_RGB, TOUCH_RGB = (
    (224, 49, 49),
    (112, 72, 232),
    (77, 171, 247),
    (64, 192, 87),
)


class Scene:
    """Contents of the 3D view; shared by all pages."""

    def __init__(self, server: viser.ViserServer, cell: CellConfig) -> None:
        """Build the scene."""
        self._server = server
        self._readout = Readout(cell)
        self._arm = None if cell.robot.model == UNKNOWN_ARM else ArmModel(cell)
        self._mujoco: ViserMujocoScene | None = None
        self._q: Array | None = None
        _set_the_stage(server)
        if self._arm is not None:
            self._mujoco = ViserMujocoScene(server, self._arm.model, num_envs=1)
            self._mujoco.camera_tracking_enabled = False
            self._mujoco.update_from_mjdata(self._arm.data)
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
        tool = self._readout.tool(robot, snapshot.wrench.fresh)
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
        # Another arm is not drawn in a wrong pose.
        fits = self._arm is not None and len(robot.joint_rad) == self._arm.model.nq
        if self._arm is not None and self._mujoco is not None and fits:
            self._arm.move(np.array(robot.joint_rad))
            self._mujoco.update_from_mjdata(self._arm.data)

    def _draw_wrench(self, tool: Tool) -> None:
        """Draw the force from the contact, in the direction in which it pushes the tool."""
        force_N = np.zeros(3) if tool.force_N is None else tool.force_N
        torque_Nm = np.zeros(3) if tool.torque_Nm is None else tool.torque_Nm
        strong, turning = float(np.linalg.norm(force_N)), float(np.linalg.norm(torque_Nm))
        _show(self._force, strong > LEAST_N)
        _show(self._torque, turning > LEAST_NM)
        _show(self._label, strong > LEAST_N)
        if strong > LEAST_N:
            self._force.points = _arrow(tool.contact_m, M_PER_N * force_N)
            self._label.position = tool.contact_m + 0.5 * M_PER_N * force_N + LABEL_M
            text = f"{strong:.1f} N"
            if self._label.text != text:
                self._label.text = text
        if turning > LEAST_NM:
            self._torque.points = _arrow(tool.p_tcp_m, M_PER_NM * torque_Nm)

    def _draw_touch(self, snapshot: Snapshot, tool: Tool) -> None:
        """Show the contact surface at the tool while the regulator reports contact."""
        target = snapshot.target.message
        touches = target is not None and target.contact == "contact" and snapshot.target.fault == ""
        _show(self._touched, touches)
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
        helper = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        x = np.cross(helper, normal)
        x /= np.linalg.norm(x)
        server.scene.add_box(
            f"/wall {number}",
            dimensions=(0.5, 0.5, 0.002),
            color=(250, 82, 82),
            opacity=0.25,
            position=plane.point_m,
            wxyz=_wxyz(np.column_stack([x, np.cross(normal, x), normal])),
        )


def box_edges(low: Array, high: Array) -> Any:
    """Return the twelve edges of a box as pairs of points. Shape (12, 2, 3)."""
    corners = np.array(
        [
            [(low, high)[bit][axis] for axis, bit in enumerate((i & 1, i >> 1 & 1, i >> 2 & 1))]
            for i in range(8)
        ]
    )
    pairs = [(i, i | 1 << axis) for i in range(8) for axis in range(3) if not i & 1 << axis]
    return np.array([[corners[a], corners[b]] for a, b in pairs])


def _arrow(start_m: Array, vector_m: Array) -> Any:
    return np.array([[start_m, start_m + vector_m]], dtype=np.float32)


def _show(handle: viser.SceneNodeHandle, visible: bool) -> None:  # noqa: FBT001 - show it or not
    if handle.visible != visible:
        handle.visible = visible


def _wxyz(R: Array) -> tuple[float, float, float, float]:
    x, y, z, w = quaternion_from_R(R)
    return (w, x, y, z)
