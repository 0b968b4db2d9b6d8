"""Surface under the tool in the panel's drawing: it is that of the simulated cell."""

from typing import Literal

import mujoco
import numpy as np
import pytest

from common.config.cell_sim import DRAWN_DEPTH_M, SimSection
from services.panel.scene import _add_surface

P_TCP_M = np.array([0.5, 0.1, 0.4])
RADIUS_M, GAP_M = 0.06, 0.004


def drawn(sim: SimSection) -> mujoco.MjModel:
    """Return a model with the drawing of the surface alone."""
    spec = mujoco.MjSpec()
    _add_surface(spec, sim, P_TCP_M)
    return spec.compile()


def meshes(model: mujoco.MjModel) -> list[int]:
    """Return the geoms that are meshes."""
    mesh = int(mujoco.mjtGeom.mjGEOM_MESH)
    return [n for n in range(model.ngeom) if model.geom_type[n] == mesh]


@pytest.mark.parametrize("surface", ["cylinder", "hemisphere"])
def test_a_curved_surface_has_its_radius_and_its_top_below_the_tool(
    surface: Literal["cylinder", "hemisphere"],
) -> None:
    """Each corner is on the sphere, or on the cylinder, whose top is where the plate's would be."""
    model = drawn(SimSection(surface=surface, radius_m=RADIUS_M, gap_m=GAP_M))
    (geom,) = meshes(model)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    corners_m = data.geom_xpos[geom] + model.mesh_vert @ data.geom_xmat[geom].reshape(3, 3).T
    away_m = corners_m - (P_TCP_M - [0.0, 0.0, GAP_M + RADIUS_M])
    if surface == "cylinder":
        away_m[:, 1] = 0.0
    assert np.linalg.norm(away_m, axis=1) == pytest.approx(RADIUS_M, abs=1e-5)
    assert corners_m[:, 2].max() == pytest.approx(P_TCP_M[2] - GAP_M, abs=1e-5)
    assert np.ptp(corners_m[:, 2]) <= DRAWN_DEPTH_M


def test_a_plane_is_drawn_as_a_plate() -> None:
    """No mesh; its upper face is as far below the tool."""
    model = drawn(SimSection(gap_m=GAP_M))
    assert meshes(model) == []
    boxes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_BOX)
    tops_m = (model.geom_pos[:, 2] + model.geom_size[:, 2])[boxes]
    assert tops_m.max() == pytest.approx(P_TCP_M[2] - GAP_M, abs=1e-6)
