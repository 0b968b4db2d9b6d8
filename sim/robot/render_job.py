"""Rendering child process: a job as JSON on standard input, a PNG file as the result.

If rendering fails, the exit code is not 0 and the reason is the last line on standard error.
Started by `sim.robot.render`, which also selects the graphics library.
"""

import json
import sys
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from matplotlib.image import imsave

ARROW_M_PER_N = 0.006
ARROW_LONGEST_M = 0.25
ARROW_WIDTH_M = 0.012
DISTANCE_SHARE = 1.55  # camera distance to the diagonal of what must be seen
HIDDEN_SHARE = 0.7  # opacity of the arrow where tool or plate is in front of it
LEAST_DRAWN_FORCE_N = 0.5  # arrows of smaller forces are too short to be legible
_ARROW_RGBA = np.array([0.86, 0.12, 0.16, 1.0], dtype=np.float32)

Pixels = npt.NDArray[np.uint8]


def main() -> int:
    """Render one job; return the exit code."""
    job = json.load(sys.stdin)
    imsave(job["path"], draw(job))
    return 0


def draw(job: dict[str, Any]) -> Pixels:
    """Return the picture. Shape (height, width, 3)."""
    view = job["view"]
    model = mujoco.MjModel.from_xml_string(job["xml"])
    model.vis.global_.offwidth, model.vis.global_.offheight = view["width_px"], view["height_px"]
    data = mujoco.MjData(model)
    for name, value in job["joints"].items():
        data.joint(name).qpos[:] = value
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, view["height_px"], view["width_px"]) as renderer:
        renderer.update_scene(data, _camera(data, view, np.array(job["contact_m"])), _options())
        scene, bodies = renderer.scene, renderer.scene.ngeom
        _add_arrow(scene, np.array(job["contact_m"]), np.array(job["force_N"]))
        picture = np.array(renderer.render())
        if scene.ngeom == bodies:
            return np.asarray(picture, dtype=np.uint8)
        scene.ngeom, scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0, 0
        _add_arrow(scene, np.array(job["contact_m"]), np.array(job["force_N"]))
        return _laid_over(picture, np.array(renderer.render()))


def _laid_over(picture: Pixels, arrow: Pixels) -> Pixels:
    """Return the picture with the arrow, on black, visible also where a body hides it."""
    is_arrow = arrow.any(axis=2, keepdims=True)
    mixed = (1.0 - HIDDEN_SHARE) * picture + HIDDEN_SHARE * arrow
    return np.where(is_arrow, mixed, picture).astype(np.uint8)


def _camera(
    data: mujoco.MjData, view: dict[str, Any], contact_m: npt.NDArray[np.float64]
) -> mujoco.MjvCamera:
    """Return a camera next to the arm that sees everything from the floor to the highest joint."""
    points_m = np.vstack((data.xpos[1:], data.geom("floor").xpos * (0.0, 0.0, 1.0)))
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    heading_deg = np.degrees(np.arctan2(contact_m[1], contact_m[0]))
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (low_m + high_m) / 2.0
    camera.distance = DISTANCE_SHARE * np.linalg.norm(high_m - low_m)
    camera.azimuth = heading_deg + view["azimuth_from_arm_deg"]
    camera.elevation = view["elevation_deg"]
    return camera


def _options() -> mujoco.MjvOption:
    options = mujoco.MjvOption()
    options.geomgroup[:] = 0
    options.geomgroup[1] = 1
    options.sitegroup[:] = 0
    return options


def _add_arrow(
    scene: mujoco.MjvScene, tail_m: npt.NDArray[np.float64], force_N: npt.NDArray[np.float64]
) -> None:
    """Draw the force of the environment on the tool, from a point."""
    size_N = float(np.linalg.norm(force_N))
    if size_N < LEAST_DRAWN_FORCE_N:
        return
    length_m = min(ARROW_M_PER_N * size_N, ARROW_LONGEST_M)
    tip_m = tail_m + force_N / size_N * 2.0 * length_m  # MuJoCo draws arrows at half their size
    kind, geom = mujoco.mjtGeom.mjGEOM_ARROW, scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), _ARROW_RGBA)
    mujoco.mjv_connector(geom, kind, ARROW_WIDTH_M, tail_m, tip_m)
    scene.ngeom += 1


if __name__ == "__main__":
    sys.exit(main())
