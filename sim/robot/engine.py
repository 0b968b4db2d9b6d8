"""MuJoCo without graphics, for everything that simulates: `from sim.robot.engine import mujoco`.

MuJoCo loads a graphics library while it is imported, and where `MUJOCO_GL` names one that is
broken the import itself fails. Physics needs none, so it asks for none; drawing is a process of
its own (`sim.robot.render`). MuJoCo's warnings go to the log instead of a file in the working
directory.
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
