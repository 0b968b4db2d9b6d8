"""H31: with a sensor of wrong sign, axis, frame or unit the force stays below 10 N, travel 2 mm.

All 48 signed permutations of the force axes in the simulated cell, judged by the true contact:
the arm stops within 2 mm of the first touch. The first check is the tare, which such a sensor does
not pass; here it has passed, and the first touch itself must reveal the error.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from common.config.cell import CellConfig
from common.config.load import cell_from_tree
from common.motion.convert import record_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.errors import ConfigError
from forcemesh.messages import Mode
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, MoveRequest
from identification.installation.axis_fit import SIGNED
from launch.virtual_cell import VirtualCell
from sim.robot.ft_sensor import FtSample
from tests.fakes.bench import CELL
from tests.fakes.lab import Lab

MOST_N, MOST_M = 10.0, 0.002
PRESS_N = 8.0
LIFT_M = 0.001
GAP_M = 0.001
EYE = np.eye(3)


def cell_with(**changes: Any) -> CellConfig:
    """Return the demo's cell with a plate close to the tool and other changes."""
    tree: dict[str, Any] = CELL.model_dump(mode="json")
    tree["sim"]["gap_m"] = GAP_M
    for dotted, value in changes.items():
        section, name = dotted.split("__")
        tree[section][name] = value
    return cell_from_tree(tree, "a cell")


@dataclass
class Touch:
    """True force and travel of the tool pressed on the plate."""

    peak_N: float = 0.0
    travel_m: float = 0.0  # from the first touch
    codes: frozenset[str] = frozenset()  # reasons of the stop; empty: it continued pressing


class Press:
    """An armed cell whose sensor can be rewired between presses, as if tared in that state."""

    def __init__(self, cell: CellConfig) -> None:
        """Tare and arm with a right sensor."""
        assert cell.sim is not None
        self.lab = Lab(cell)
        self.arm = self.lab.cell.arm
        bias = np.array([*cell.sim.bias_force_N, *cell.sim.bias_torque_Nm])
        self.rest = bias - self.arm.data.sensordata[:6]

    def rewire(self, force: Array, torque: Array = EYE) -> None:
        """Apply a wrong wiring to the channels; the reading at rest stays the same."""

        def disturb(sample: FtSample) -> FtSample:
            change = np.concatenate((sample.force_N, sample.torque_Nm)) - self.rest
            shown_N, shown_Nm = force @ change[:3], torque @ change[3:]
            rest_N, rest_Nm = self.rest[:3], self.rest[3:]
            return FtSample(rest_N + shown_N, rest_Nm + shown_Nm, sample.status, sample.counter)

        self.arm.ft_sensor.disturb = disturb

    def press(
        self, mode: Mode = "position", press_N: float = PRESS_N, for_s: float = 0.55
    ) -> Touch:
        """Press until the arm is stopped; return the true force and travel."""
        request = ForceStartRequest(mode=mode, setpoint_N=press_N)
        assert self.lab.ask(topics.FORCE_START, request).accepted
        touch, site = Touch(), self.arm.model.site("tcp").id
        first_m: Array | None = None

        def observe() -> bool:
            nonlocal first_m
            force_N = float(np.linalg.norm(self.arm.true_wrench().force_N))
            p_m = self.arm.data.site_xpos[site].copy()
            if first_m is None and force_N > 0.5:
                first_m = p_m
            if first_m is not None:
                touch.travel_m = max(touch.travel_m, float(np.linalg.norm(p_m - first_m)))
            touch.peak_N = max(touch.peak_N, force_N)
            return self.lab.status.state in {"HOLDING", "FAULT"}

        self.lab.cell.advance(for_s, observe)
        if observe():
            touch.codes = frozenset(trip.code for trip in self.lab.status.trips)
        self.lab.cell.advance(0.15, lambda: observe() and False)
        return touch

    def lift(self) -> None:
        """Stop pressing, clear, move up by LIFT_M and arm."""
        self.arm.ft_sensor.disturb = lambda sample: sample
        self.lab.ask(topics.FORCE_STOP, Empty())
        self.lab.cell.advance(0.12)
        self.lab.ask(topics.CLEAR, Empty())
        self.lab.cell.advance(0.02)
        assert self.lab.ask(topics.ARM, ArmRequest()).accepted
        T = self.arm.T_base_flange
        T.translation = T.translation + np.array([0.0, 0.0, LIFT_M - self.arm.lift_off_m])
        move = MoveRequest(kind="pose", pose=record_of(T), speed_m_s=0.05)
        assert self.lab.ask(topics.MOVE, move).accepted
        self.lab.cell.advance(0.3)
        assert self.arm.lift_off_m > 0.0


@pytest.mark.parametrize("order", range(6))
def test_all_48_wirings_of_the_force_axes(order: int) -> None:
    """40 are stopped at the first touch; the 8 with the right tool axis press normally.

    Sensor mounted at 30 degrees about the tool's axis, as in the supplied cells. A straight press
    does not reveal the other two axes.
    """
    assert CELL.sensor.T_flange_sensor.oat_deg == (30.0, 0.0, 0.0)
    bench = Press(cell_with())
    for wiring in SIGNED[8 * order : 8 * order + 8]:
        bench.rewire(wiring)
        touch = bench.press()
        details = f"{wiring.astype(int).tolist()}: {touch}"
        assert touch.peak_N < MOST_N, details
        assert touch.travel_m < MOST_M, details
        if wiring[2, 2] == 1.0:
            assert not touch.codes, details
            assert touch.peak_N == pytest.approx(PRESS_N, abs=0.6), details
        else:
            assert "sensor_sign" in touch.codes, details
        bench.lift()


@pytest.mark.parametrize("stiffness_N_m", [5e3, 1e5])
def test_a_wrong_sign_on_soft_and_on_stiff_plates(stiffness_N_m: float) -> None:
    """The approach speed follows from the stiffness: 10 N and 2 mm hold for both."""
    cell = cell_with(sim__stiffness_N_m=stiffness_N_m, contact__stiffness_N_m=stiffness_N_m)
    force = cell.force.model_copy(update={"approach_m_s": cell.plant.approach_limit_m_s})
    bench = Press(cell.model_copy(update={"force": force}))
    bench.rewire(np.diag([1.0, 1.0, -1.0]))
    touch = bench.press(for_s=2.0)
    assert "sensor_sign" in touch.codes
    assert touch.peak_N < MOST_N
    assert touch.travel_m < MOST_M


def test_lateral_drift_is_stopped_by_the_work_limit() -> None:
    """Both lateral axes reversed, 20 N: the tool creeps until its work reveals it."""
    bench = Press(cell_with())
    bench.rewire(np.diag([-1.0, -1.0, 1.0]))
    touch = bench.press(press_N=20.0, for_s=3.0)
    assert "sensor_sign" in touch.codes
    assert touch.travel_m < 2.0 * MOST_M
    bench.lift()
    bench.rewire(EYE)
    assert not bench.press(press_N=20.0, for_s=1.0).codes


@pytest.mark.parametrize("signs", [(-1.0, -1.0, -1.0), (-1.0, 1.0, 1.0)])
def test_wrong_torques_are_stopped_while_the_tool_rotates(signs: tuple[float, ...]) -> None:
    """Mode both on a tilted plate: the disc would rotate onto its edge, not onto its face.

    The work that the contact seems to do reveals it, before the force reaches its ceiling.
    """
    bench = Press(cell_with(sim__tilt_deg=5.0))
    bench.rewire(EYE, np.diag(signs))
    touch = bench.press("both", for_s=2.0)
    assert "sensor_sign" in touch.codes
    assert touch.peak_N < CELL.limits.force_N
    assert touch.travel_m < MOST_M


# --- before anything moves ------------------------------------------------------------------------

IN_MM = "is that in millimetres?"


@pytest.mark.parametrize(
    ("dotted", "value", "question"),
    [
        ("payload.mass_kg", 1000.0, ": must be at most 50 kg, found 1000 kg; is that in grams?"),
        ("payload.com_m", (12.0, -8.0, 60.0), f".2: must be at most 1 m, found 60 m; {IN_MM}"),
        (
            "tool.T_flange_tcp",
            {"position_m": (0.0, 0.0, 160.0)},
            f".position_m.2: must be at most 2 m, found 160 m; {IN_MM}",
        ),
    ],
)
def test_a_cell_in_wrong_units_is_refused_with_a_question_about_the_unit(
    dotted: str, value: Any, question: str
) -> None:
    """The refusal comes while the file is loaded: no process runs that could move the arm."""
    with pytest.raises(ConfigError) as refused:
        cell_with(**{dotted.replace(".", "__"): value})
    assert dotted + question in str(refused.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"payload__mass_kg": CELL.payload.mass_kg * 2.20462},
        {"payload__mass_kg": CELL.payload.mass_kg * 9.80665},
        {"payload__com_m": tuple(10.0 * x_m for x_m in CELL.payload.com_m)},
    ],
    ids=["pounds for kilograms", "newtons for kilograms", "decimetres for metres"],
)
def test_a_plausible_payload_in_wrong_units_is_refused_before_any_motion(
    changes: dict[str, Any],
) -> None:
    """The true weight does not fit the plausible payload; the tare gives the difference."""
    cell = VirtualCell(cell_with(**changes))
    cell.advance(0.4)
    reply = cell.client.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code) == (False, "contact")
    assert "the bias would change by" in reply.text
