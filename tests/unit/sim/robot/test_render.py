"""Pictures of the cell: sensor and force are in them, or there is one clear error."""

import os
import subprocess
import sys
from dataclasses import asdict

import matplotlib.image
import numpy as np
import pytest

from common.config.arm import arm_names, read_arm
from sim.robot import render
from sim.robot.arm import SimArm
from sim.robot.render import RenderUnavailable, View, render_png
from sim.robot.render_job import _camera
from sim.robot.settings import SimSettings

SETTINGS = SimSettings(tilt_deg=10.0)
SMALL = View(width_px=320, height_px=240)


def pixels(tmp_path, force_N, settings: SimSettings = SETTINGS) -> np.ndarray:
    """Return a small picture of a cell at home, 0..1. Shape (240, 320, 3)."""
    path = tmp_path / "cell.png"
    try:
        render_png(settings, path, q=settings.home_rad, force_N=force_N, view=SMALL)
    except RenderUnavailable as error:
        pytest.skip(str(error))
    return matplotlib.image.imread(path)[:, :, :3]


def share_of(picture: np.ndarray, main: int) -> float:
    """Return the share of pixels in which one colour is twice as strong as the others."""
    others = np.delete(picture, main, axis=2).max(axis=2)
    return float(((picture[:, :, main] > 2.0 * others) & (picture[:, :, main] > 0.2)).mean())


def test_a_picture_shows_sensor_plate_and_force(tmp_path):
    """Blue sensor always; a red arrow exactly when a force is given; the size asked for."""
    with_force = pixels(tmp_path, np.array([0.0, 0.0, 30.0]))
    without = pixels(tmp_path, None)
    assert with_force.shape == without.shape == (240, 320, 3)
    assert share_of(without, 2) > 0.001
    assert share_of(with_force, 0) > share_of(without, 0) + 0.001
    assert without.std() > 0.05


@pytest.mark.parametrize("variable", ["MUJOCO_GL", "__EGL_VENDOR_LIBRARY_FILENAMES"])
def test_without_graphics_there_is_one_clear_error(tmp_path, monkeypatch, variable):
    """A wrong library name or no driver at all: the error names the cause and the cure."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv(variable, "/nonexistent")
    path = tmp_path / "cell.png"
    with pytest.raises(RenderUnavailable, match=r"no picture: .*libegl1"):
        render_png(SETTINGS, path, q=SETTINGS.home_rad, view=SMALL)
    assert not path.exists()


def test_physics_runs_where_the_graphics_library_is_broken():
    """The simulation needs no graphics, even if the environment names a library that fails."""
    code = (
        "import os; from sim.robot.arm import SimArm; from sim.robot.settings import SimSettings;"
        "SimArm(SimSettings(), seed=0).step(); print(os.environ['MUJOCO_GL'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=dict(os.environ) | {"MUJOCO_GL": "nonsense"},
        cwd=render._ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.strip() == "nonsense", done.stderr


@pytest.mark.parametrize("arm", arm_names())
def test_the_camera_sees_the_whole_of_every_arm(arm):
    """Every joint, the tool and the floor below the arm are inside of the picture."""
    robot = SimArm(SimSettings(arm=arm, home_deg=read_arm(arm).home_deg), seed=0)
    view = asdict(View())
    camera = _camera(robot.data, view, robot.T_base_flange.translation)
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    forward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    up = np.cross(right, forward)
    floor = robot.data.geom("floor").xpos * (0.0, 0.0, 1.0)
    for point in (*robot.data.xpos[1:], floor):
        offset_m = point - (camera.lookat - camera.distance * forward)
        half_height = np.tan(np.radians(robot.model.vis.global_.fovy) / 2.0) * (offset_m @ forward)
        assert abs(offset_m @ up) < 0.95 * half_height
        assert abs(offset_m @ right) < 0.95 * half_height * view["width_px"] / view["height_px"]
