"""The gateway and plain.as, joined by a real TCP socket, on the clock of the test."""

from pathlib import Path
from typing import Any

from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.messages import Feedback, Gains
from launch.controller_program import program_of
from services.gateway.service import Gateway
from tests.contract.rig import Rig
from tests.contract.robots import Both
from tests.fakes.plain_controller import PlainController

CELL = Path(__file__).resolve().parents[2] / "cells" / "demo-plain.yaml"
SPECIFICATION = dict.fromkeys(
    ("position_per_mm", "oat_per_deg", "joint_per_deg", "force_per_N", "torque_per_Nm",
     "speed_per_mm_s", "gain_p", "gain_i"), 1,
)  # fmt: skip
FEEDBACK_S = 0.02  # a sample of the sensor


def plain_cell(**overrides: Any) -> CellConfig:
    """The demo's cell with protocol plain."""
    return load_cell(CELL, {"deadlines.command_s": 0.25, **overrides})


class PlainRig:
    """A controller whose program has the numbers of the cell, its gateway, and the arbiter."""

    def __init__(
        self, *, is_specification: bool = False, chars: int = 63, cell_chars: int = 0
    ) -> None:
        scales = SPECIFICATION if is_specification else {}
        changes: dict[str, Any] = {f"gateway.plain.{name}": 1 for name in scales}
        changes["gateway.plain.packet_chars"] = chars
        program = program_of(plain_cell(**changes)).text
        self.controller = PlainController(program, gap_m=0.003, stiffness_N_m=1e4)
        changes["gateway.port"] = self.controller.port
        changes["gateway.plain.packet_chars"] = cell_chars or chars
        self.rig = Rig(plain_cell(**changes), ManualClock(), self._make)

    def _make(self, bus: Bus, cell: CellConfig) -> Both:
        self.gateway = Gateway(bus, cell)
        start_ns = self.controller.machine.now_ns - bus.clock.now_ns()
        return Both(self.gateway, lambda now_ns: self.controller.machine.advance(start_ns + now_ns))

    def arm(self) -> None:
        """Connect and open a lease."""
        self.rig.connect()
        self.rig.arm()

    def run_feedback(self, gains: Gains, setpoint_N: float, duration_s: float) -> float:
        """Run force feedback on the true wrench; return the force along z at the end."""
        feedback = Feedback(mode="position", gains=gains, setpoint_force_N=(0.0, 0.0, setpoint_N))
        self.rig.push()
        self.rig.send("feedback", host="controller", feedback=feedback)
        force_N = [0.0, 0.0, 0.0]
        for _ in range(round(duration_s / FEEDBACK_S)):
            force_N, torque_Nm = self.controller.wrench()
            self.rig.push(tuple(force_N), tuple(torque_Nm))  # type: ignore[arg-type]
            self.rig.advance(FEEDBACK_S)
        return force_N[2]

    def close(self) -> None:
        """Close the connection and switch off."""
        self.gateway.close()
        self.controller.close()
