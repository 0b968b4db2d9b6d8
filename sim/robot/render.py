"""Offscreen rendering of the cell, with the force on the tool as an arrow.

A child process renders (`sim.robot.render_job`). MuJoCo selects its graphics library once, on
import, and fails in different ways if none is usable: import errors, attribute errors, aborts
inside a driver. The child process maps all of them to `RenderUnavailable`, and the simulating
process never loads graphics.
"""

import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from forcemesh.errors import ForcemeshError
from sim.robot.plate import lift_off_m
from sim.robot.scene import build_spec, plate_at_rest
from sim.robot.settings import SimSettings

_ROOT = Path(__file__).resolve().parents[2]
_TIMEOUT_S = 60.0  # a picture takes 2 s on a slow machine without a graphics card


class RenderUnavailable(ForcemeshError):  # noqa: N818 - a state of the machine, not a mistake
    """Error: this machine cannot render; the text names the failure and the remedy."""


@dataclass(frozen=True, slots=True)
class View:
    """Size of a picture, and the camera's angles; it is aimed and placed so that the arm fits."""

    azimuth_from_arm_deg: float = 115.0  # from the arm's heading, seen from above
    elevation_deg: float = -14.0
    width_px: int = 1280
    height_px: int = 960


DEFAULT_VIEW = View()


def render_png(
    settings: SimSettings,
    path: Path,
    *,
    q: Array,
    force_N: Array | None = None,
    contact_m: Array | None = None,
    view: View = DEFAULT_VIEW,
) -> None:
    """Write a picture of the cell with the arm at joint angles q [rad], shape (6,).

    The plate is drawn with its deflection by the disc. Raises RenderUnavailable.

    Args:
        settings: The cell.
        path: PNG file to write; its folder must exist.
        q: Joint angles of the arm [rad]. Shape (6,).
        force_N: Force on the tool in base axes [N]; drawn as an arrow from the contact.
        contact_m: Contact point in base [m], shape (3,); default: the TCP.
        view: Camera and size of the picture.
    """
    tcp_m, pushed_m = _tcp_and_plate(settings, q)
    job = {
        "xml": _described(settings, pushed_m),
        "joints": {f"joint{k}": float(angle) for k, angle in enumerate(q, 1)},
        "contact_m": tcp_m if contact_m is None else [float(x) for x in contact_m],
        "force_N": [0.0, 0.0, 0.0] if force_N is None else [float(f) for f in force_N],
        "view": asdict(view),
        "path": str(path.resolve()),
    }
    environment = {"MUJOCO_GL": "egl"} | dict(os.environ)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "sim.robot.render_job"],
            input=json.dumps(job),
            env=environment,
            cwd=_ROOT,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RenderUnavailable(_explain(environment, str(error))) from error
    if done.returncode != 0:
        raise RenderUnavailable(_explain(environment, _last_line(done)))


def _described(settings: SimSettings, pushed_m: float) -> str:
    spec = build_spec(settings, pushed_m=pushed_m)
    spec.compile()  # MuJoCo writes only what it has compiled
    return str(spec.to_xml())


def _tcp_and_plate(settings: SimSettings, q: Array) -> tuple[list[float], float]:
    """Return the TCP position [m], and the plate's deflection along its normal [m]."""
    T_base_flange = ArmKinematics(settings.arm).flange_pose(np.asarray(q, dtype=float))
    T_base_tcp = T_base_flange * settings.T_flange_tcp
    tcp_m = [float(x) for x in T_base_tcp.translation]
    if settings.surface != "plane":
        return tcp_m, 0.0
    plate = plate_at_rest(settings)
    lift_m = lift_off_m(
        T_base_tcp,
        plate_point_m=plate.point_m,
        plate_normal=plate.normal,
        disc_radius_m=settings.disc_radius_m,
    )
    return tcp_m, max(0.0, -lift_m)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return lines[-1] if lines else f"the drawing process ended with code {done.returncode}"


def _explain(environment: dict[str, str], cause: str) -> str:
    return (
        f"no picture: drawing with MUJOCO_GL={environment['MUJOCO_GL']} failed ({cause[:200]});"
        " it needs an EGL library, on Debian and Ubuntu the packages libegl1 and libegl-mesa0"
    )
