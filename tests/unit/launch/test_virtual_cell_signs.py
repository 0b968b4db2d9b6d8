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
from common.config.payload import Payload
from common.motion.convert import record_of
from common.motion.frames import Array
from common.motion.weight import predict
from forcemesh import topics
from forcemesh.errors import ConfigError
from forcemesh.messages import Mode
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, MoveRequest
from identification.installation.axis_fit import SIGNED
from launch.virtual_cell import VirtualCell
from services.wrench.calibration_manager import tare
from sim.robot.ft_sensor import FtSample
from sim.robot.settings import SimSettings
from tests.fakes.bench import CELL

MOST_N, MOST_M = 10.0, 0.002
PRESS_N = 8.0
LIFT_M = 0.001
GAP_M = 0.001


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

    peak_N: float
    travel_m: float  # from the first touch
    codes: set[str]  # reasons of the stop; empty: it continued pressing


class Bench:
    """An armed cell whose sensor can be rewired between presses, as if tared in that state."""

    def __init__(self, cell: CellConfig) -> None:
        """Wait for the preflight and tare."""
        self.cell = VirtualCell(cell)
        self.arm = self.cell.arm
        self.status = self.cell.client.reader(topics.ARBITER_STATUS)
        self.cell.advance(1.3)
        assert self.cell.client.ask(topics.TARE, Empty()).accepted
        load = -self.arm.data.sensordata[:6]
        self.rest = load + self.bias(cell)
        self._site = self.arm.model.site("tcp").id
        self._p_touch: Array | None = None
        self._peak_N = self._travel_m = 0.0

    @staticmethod
    def bias(cell: CellConfig) -> Array:
        """Return the bias of the simulated sensor."""
        assert cell.sim is not None
        return np.array([*cell.sim.bias_force_N, *cell.sim.bias_torque_Nm])

    def rewire(self, force: Array, torque: Array | None = None) -> None:
        """Apply a wrong wiring to the channels; the reading at rest stays the same."""
        wiring = np.zeros((6, 6))
        wiring[:3, :3], wiring[3:, 3:] = force, np.eye(3) if torque is None else torque

        def disturb(sample: FtSample) -> FtSample:
            change = np.concatenate((sample.force_N, sample.torque_Nm)) - self.rest
            shown = self.rest + wiring @ change
            return FtSample(shown[:3], shown[3:], sample.status, sample.counter)

        self.arm.ft_sensor.disturb = disturb

    def press(
        self, mode: Mode = "position", press_N: float = PRESS_N, for_s: float = 0.55
    ) -> Touch:
        """Arm and press until the arm is stopped; return the true force and travel."""
        client = self.cell.client
        assert client.ask(topics.ARM, ArmRequest()).accepted
        request = ForceStartRequest(mode=mode, setpoint_N=press_N)
        assert client.ask(topics.FORCE_START, request).accepted
        self._p_touch, self._peak_N, self._travel_m = None, 0.0, 0.0
        self.cell.advance(for_s, self._stopped)
        trips = self.status.read(self.cell.clock.now_ns()).message
        codes = {trip.code for trip in trips.trips} if trips and self._stopped() else set()
        for _ in range(150):
            self.cell.advance(0.001)
            self._stopped()
        return Touch(self._peak_N, self._travel_m, codes)

    def lift(self) -> None:
        """Stop pressing, clear, and move up by LIFT_M."""
        client = self.cell.client
        self.arm.ft_sensor.disturb = lambda sample: sample
        client.ask(topics.FORCE_STOP, Empty())
        self.cell.advance(0.12)
        client.ask(topics.CLEAR, Empty())
        self.cell.advance(0.02)
        assert client.ask(topics.ARM, ArmRequest()).accepted
        T = self.arm.T_base_flange
        T.translation = T.translation + np.array([0.0, 0.0, LIFT_M - self.arm.lift_off_m])
        move = MoveRequest(kind="pose", pose=record_of(T), speed_m_s=0.05)
        assert client.ask(topics.MOVE, move).accepted
        self.cell.advance(0.3)
        assert self.arm.lift_off_m > 0.0

    def _stopped(self) -> bool:
        """Record the true contact; return whether the arbiter holds."""
        force_N = float(np.linalg.norm(self.arm.true_wrench().force_N))
        if force_N > 0.0 or self._p_touch is not None:
            p = self.arm.data.site_xpos[self._site].copy()
            if self._p_touch is None and force_N > 0.5:
                self._p_touch = p
            if self._p_touch is not None:
                self._travel_m = max(self._travel_m, float(np.linalg.norm(p - self._p_touch)))
            self._peak_N = max(self._peak_N, force_N)
        status = self.status.read(self.cell.clock.now_ns()).message
        return status is not None and status.state in {"HOLDING", "FAULT"}


def shows_pressing(force: Array, cell: CellConfig) -> float:
    """Return the part of a push along the tool that a wiring shows along the tool."""
    R = cell.sensor.T_flange_sensor.pose.rotation
    return float((R @ force @ R.T)[2, 2])


def judge_presses(cell: CellConfig, wirings: list[Array]) -> int:
    """Press with each wiring; return the number stopped by the sign of the first touch."""
    bench = Bench(cell)
    stopped = 0
    for wiring in wirings:
        bench.rewire(wiring)
        touch = bench.press()
        details = f"{wiring.astype(int).tolist()}: {touch}"
        assert touch.peak_N < MOST_N, details
        assert touch.travel_m < MOST_M, details
        if (
            shows_pressing(wiring, cell) > 0.9
        ):  # a straight press does not reveal the other two axes
            assert not touch.codes, details
            assert touch.peak_N == pytest.approx(PRESS_N, abs=0.6), details
        else:
            assert "sensor_sign" in touch.codes, details
            stopped += 1
        bench.lift()
    return stopped


# --- axis of the tool -----------------------------------------------------------------------------


@pytest.mark.parametrize("order", range(6))
def test_all_48_wirings_of_the_force_axes(order: int) -> None:
    """40 are stopped at the first touch; the 8 with the right tool axis press normally.

    Sensor mounted at 30 degrees about the tool's axis, as in the supplied cells.
    """
    assert CELL.sensor.T_flange_sensor.oat_deg == (30.0, 0.0, 0.0)
    wirings = list(SIGNED[8 * order : 8 * order + 8])
    aligned = sum(wiring[2, 2] == 1.0 for wiring in wirings)
    assert aligned in (0, 4)
    assert judge_presses(cell_with(), wirings) == 8 - aligned


@pytest.mark.parametrize("stiffness_N_m", [5e3, 1e5])
def test_a_wrong_sign_on_soft_and_on_stiff_plates(stiffness_N_m: float) -> None:
    """The approach speed follows from the stiffness: 10 N and 2 mm hold for both."""
    cell = cell_with(sim__stiffness_N_m=stiffness_N_m, contact__stiffness_N_m=stiffness_N_m)
    cell = cell.model_copy(
        update={"force": cell.force.model_copy(update={"approach_m_s": cell.approach_limit_m_s})}
    )
    bench = Bench(cell)
    bench.rewire(np.diag([1.0, 1.0, -1.0]))
    touch = bench.press(for_s=2.0)
    assert "sensor_sign" in touch.codes
    assert touch.peak_N < MOST_N
    assert touch.travel_m < MOST_M


# --- lateral axes ---------------------------------------------------------------------------------


def test_lateral_drift_is_stopped_by_the_work_limit() -> None:
    """Both lateral axes reversed, 20 N: the tool creeps until its work reveals it."""
    bench = Bench(cell_with())
    bench.rewire(np.diag([-1.0, -1.0, 1.0]))
    touch = bench.press(press_N=20.0, for_s=3.0)
    assert "sensor_sign" in touch.codes
    assert touch.travel_m < 2.0 * MOST_M
    bench.lift()
    bench.rewire(np.eye(3))
    assert not bench.press(press_N=20.0, for_s=1.0).codes


@pytest.mark.parametrize("signs", [(-1.0, -1.0, -1.0), (-1.0, 1.0, 1.0)])
def test_wrong_torques_are_stopped_while_the_tool_rotates(signs) -> None:
    """Mode both on a tilted plate: the disc would rotate onto its edge, not onto its face."""
    bench = Bench(cell_with(sim__tilt_deg=5.0))
    bench.rewire(np.eye(3), np.diag(signs))
    touch = bench.press("both", for_s=2.0)
    assert "sensor_sign" in touch.codes
    assert touch.peak_N < 2.0 * MOST_N
    assert touch.travel_m < MOST_M


# --- the tare, before anything moves --------------------------------------------------------------


@pytest.mark.parametrize("unit", [1.0, 1 / 9.80665, 1 / 4.44822, 1e-3, 1e3])
def test_the_tare_accepts_only_wirings_and_units_that_show_the_weight(unit: float) -> None:
    """Tool down: 8 of 48 in newtons, none in kgf, pounds, kN or mN."""
    payload = Payload(
        mass_kg=CELL.payload.mass_kg,
        com_m=CELL.payload.com_m,
        bias_force_N=CELL.payload.bias_force_N,
        bias_torque_Nm=CELL.payload.bias_torque_Nm,
    )
    R = np.diag([1.0, -1.0, -1.0])
    weight_N, moment_Nm = (v - b for v, b in zip(predict(payload, R), biases(), strict=True))
    most_N, most_Nm = CELL.force.tare_max_N, CELL.force.tare_max_Nm
    passed = 0
    for wiring in SIGNED:
        shown = np.concatenate((unit * wiring @ weight_N, moment_Nm)) + np.concatenate(biases())
        passed += tare(payload, [shown], R, most_N=most_N, most_Nm=most_Nm)[1].accepted
    assert passed == (8 if unit == 1.0 else 0)


def test_tares_do_not_ratchet_while_the_tool_presses() -> None:
    """Press 4 N, stop, tare, twelve times: each tare is refused, and the true force stays 4 N."""
    world = VirtualCell(cell_with(sim__gap_m=GAP_M))
    world.advance(1.3)
    assert world.client.ask(topics.TARE, Empty()).accepted
    true_N = 0.0
    for _ in range(12):
        world.client.ask(topics.ARM, ArmRequest())
        world.client.ask(topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=4.0))
        world.advance(1.0)
        world.client.ask(topics.FORCE_STOP, Empty())
        world.advance(0.4)
        reply = world.client.ask(topics.TARE, Empty())
        true_N = float(np.linalg.norm(world.arm.true_wrench().force_N))
        assert (reply.accepted, reply.code) == (False, "contact"), f"{true_N:.1f} N"
        assert "forcemesh calibrate" in reply.text
    assert 3.0 < true_N < 5.0


def biases() -> tuple[Array, Array]:
    """Return the bias of force and of torque."""
    return np.array(CELL.payload.bias_force_N), np.array(CELL.payload.bias_torque_Nm)


IN_GRAMS = "must be at most 50 kg, found 1000 kg; is that in grams?"
IN_MM = "is that in millimetres?"


@pytest.mark.parametrize(
    ("dotted", "value", "question"),
    [
        ("payload.mass_kg", 1000.0, f": {IN_GRAMS}"),
        ("payload.com_m", (12.0, -8.0, 60.0), f".2: must be at most 1 m, found 60 m; {IN_MM}"),
        ("tool.T_flange_tcp", 160.0, f".position_m.2: must be at most 2 m, found 160 m; {IN_MM}"),
        (
            "sensor.T_flange_sensor",
            20.0,
            f".position_m.2: must be at most 2 m, found 20 m; {IN_MM}",
        ),
    ],
)
def test_a_cell_in_wrong_units_is_refused_with_a_question_about_the_unit(
    dotted, value, question: str
) -> None:
    """The refusal comes while the file is loaded: no process runs that could move the arm."""
    if "T_flange" in dotted:
        value = {"position_m": (0.0, 0.0, value)}
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
def test_a_plausible_payload_in_wrong_units_is_refused_before_any_motion(changes) -> None:
    """The true weight does not fit the plausible payload; the tare gives the difference."""
    cell = VirtualCell(cell_with(**changes))
    cell.advance(0.4)
    reply = cell.client.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code) == (False, "contact")
    assert "the bias would change by" in reply.text


@pytest.mark.parametrize("lever", ["tool__T_flange_tcp", "sensor__T_flange_sensor"])
def test_a_lever_in_wrong_units_is_refused_or_harmless(lever, monkeypatch) -> None:
    """A tool of 1.6 m is refused, a sensor at 2 m is harmless; both are plausible lengths."""
    true = cell_with()
    settings = SimSettings.of(true)
    monkeypatch.setattr(SimSettings, "of", lambda _: settings)
    too_long = {"position_m": (0.0, 0.0, 1.6 if lever.startswith("tool") else 2.0)}
    bench = Bench(cell_with(**{lever: too_long}))
    if lever.startswith("tool"):
        reply = bench.cell.client.ask(topics.ARM, ArmRequest())
        assert not reply.accepted
        assert reply.code in {"workspace", "torque"}
    else:
        touch = bench.press()
        assert touch.peak_N < MOST_N
        assert touch.travel_m < MOST_M
