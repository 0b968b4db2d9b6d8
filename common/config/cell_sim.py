"""Section `sim` of a cell file: simulated arm, controller, sensor and contact plate."""

from math import acos, cos, pi, sin
from typing import Annotated, Literal

from pydantic import Field

from common.config.payload import BiasForce, ComPart
from forcemesh.connection import ConfigSection
from forcemesh.messages import MAX_SIGNALS

DRAWN_DEPTH_M, DRAWN_HALF_M, DRAWN_PARTS = 0.08, 0.08, 24
SimTorque = Annotated[float, Field(ge=-20.0, le=20.0)]  # [N m] of the simulated sensor's bias


class SimSection(ConfigSection):
    """The simulated arm, its controller, its sensor, its tool and the plate below it."""

    seed: int = 0
    delay_s: float = Field(0.010, ge=0.0, le=0.2)  # of the controller, whole milliseconds
    smoothing_s: float = Field(0.008, ge=0.001, le=0.1)  # of its set points
    as_step_s: float = Field(0.0001, ge=1e-6, le=0.01)  # of the emulated controller's programs
    # Of its steps with $ENCODE, TRANS and the like; none: 1, and 4 if pessimistic.
    as_dear_step_factor: float | None = Field(None, ge=1.0, le=1000.0)
    netft: bool = False  # the emulated controller serves its sensor over RDT at sensor.port
    as_pessimistic: bool = False  # worst-case reading where the controller manuals are unclear
    # Of the emulated controller: a shorter motion that blends into the next one is error E1117, and
    # motions that it takes from a program ahead.
    as_least_segment_s: float = Field(0.03, ge=0.0, le=1.0)
    as_motions_ahead: int | None = Field(None, ge=1, le=4)  # none: 1, and 3 if pessimistic
    stiffness_N_m: float = Field(2e4, ge=1e3, le=2e5)  # of the plate
    tilt_stiffness_Nm_rad: float | None = Field(None, gt=0.0, le=1e4)
    tilt_deg: float = Field(0.0, ge=0.0, le=20.0)
    surface: Literal["plane", "cylinder", "hemisphere"] = "plane"  # in place of the plate
    radius_m: float = Field(0.08, ge=0.02, le=1.0)  # of a curved one
    gap_m: float = Field(0.005, ge=0.0005, le=0.1)
    tool_mass_kg: float = Field(1.0, ge=0.05, le=7.0)
    tool_com_m: tuple[ComPart, ComPart, ComPart] = (
        0.012,
        -0.008,
        0.055,
    )  # sensor axes, from the sensor's origin
    disc_radius_m: float = Field(0.025, ge=0.005, le=0.05)
    noise_force_N: float = Field(0.1, ge=0.0, le=20.0)
    noise_torque_Nm: float = Field(0.005, ge=0.0, le=1.0)
    bias_force_N: BiasForce = (1.5, -2.0, 3.0)
    bias_torque_Nm: tuple[SimTorque, SimTorque, SimTorque] = (0.05, -0.04, 0.03)
    quantum_force_N: float = Field(0.01, ge=0.0, le=2.0)
    quantum_torque_Nm: float = Field(0.0005, ge=0.0, le=0.1)

    # Digital inputs that follow an output, by name: {part_gripped: gripper_close}.
    inputs_follow: dict[str, str] = Field({}, max_length=MAX_SIGNALS)

    @property
    def noiseless(self) -> bool:
        """Whether readings may repeat at rest: the noise is below the quantization step."""
        forces = self.noise_force_N <= self.quantum_force_N
        return forces and self.noise_torque_Nm <= self.quantum_torque_Nm

    def curved_points_m(self) -> list[tuple[float, float, float]]:
        """Return points whose convex hull is the curved surface, from its top on, to draw it."""
        radius_m, points = self.radius_m, []
        reach_rad = acos(max(0.0, 1.0 - DRAWN_DEPTH_M / radius_m))
        for part in range(-DRAWN_PARTS, DRAWN_PARTS + 1):
            angle = reach_rad * part / DRAWN_PARTS
            x, z = radius_m * sin(angle), radius_m * (cos(angle) - 1.0)
            if self.surface == "cylinder":
                points += [(x, -DRAWN_HALF_M, z), (x, DRAWN_HALF_M, z)]
                continue
            turns = (2.0 * pi * turn / DRAWN_PARTS for turn in range(DRAWN_PARTS))
            points += [(x * cos(turn), x * sin(turn), z) for turn in turns]
        return points
