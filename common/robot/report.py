"""Report of an arm: its measured pose and joints. Pure."""

from dataclasses import dataclass

import pinocchio as pin

from forcemesh.messages import Joints


@dataclass(frozen=True, slots=True)
class ArmReport:
    """Measured state of an arm at one time."""

    T_base_flange: pin.SE3
    joint_rad: Joints
    moving: bool
    at_ns: int
