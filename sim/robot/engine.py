"""MuJoCo import without graphics: `from sim.robot.engine import mujoco`.

MuJoCo loads a graphics library on import, and the import fails if the library that `MUJOCO_GL`
names is broken. Physics needs no graphics and disables it; rendering runs in a process of its own
(`sim.robot.render`). MuJoCo's warnings go to the log instead of a file in the working directory.
"""

import logging
import os

_ASKED = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "disable"
import mujoco  # noqa: E402 - the line above must come first

if _ASKED is None:
    del os.environ["MUJOCO_GL"]
else:
    os.environ["MUJOCO_GL"] = _ASKED

mujoco.set_mju_user_warning(logging.getLogger(__name__).warning)

__all__ = ["mujoco"]
