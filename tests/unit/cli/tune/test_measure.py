"""`tune` on a whole cell in virtual time: true values are identified, the arm returns."""

import json
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from cli.skills.contact_monitor import no_progress
from cli.tune.measure import Readings, TuningMeasurement, TuningTrial, measure
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from control.gain_rule import tune
from forcemesh.errors import DataError, NotReachedError, RefusedError
from launch.virtual_cell import VirtualCell
from sim.robot.settings import TICK_S
from tests.fakes.bench import DEMO
from tests.fakes.long import long
from tests.fakes.verb_calls import call_verb
from tuning.contact_spring import Spring
from tuning.servo import Servo

CELLS = DEMO.parent
CHAIN_S = 0.003  # at most, from the arbiter's command to the robot, and back in its report
SHARP_S = 0.002
RATES_HZ = ((250, 250), (125, 250), (100, 125), (60, 250), (40, 125))  # of robot and regulator


class TuneCell:
    """A cell in virtual time, armed, its tool in free space."""

    def __init__(self, name: str = "demo.yaml", overrides=None) -> None:
        config = load_cell(CELLS / name, overrides)
        self.world = VirtualCell(config)
        self.client = ConfiguredCell(config, bus=self.world.client, commander="operator")
        self.world.advance(1.6)
        self.client.wait_ready()
        self.client.tare()
        self.client.arm()
        self.world.advance(0.1)

    def p(self) -> np.ndarray:
        """Return the true position of the flange."""
        return np.array(self.world.arm.T_base_flange.translation)


@pytest.mark.parametrize("number", [0, *(long(number) for number in range(1, 20))])
def test_delay_and_lag_together_are_found_to_2_ms_in_20_of_20_cells(number: int) -> None:
    """The error is within the stated deviation, for random arms, controllers and rates."""
    rng, (robot_hz, control_hz) = np.random.default_rng(number), RATES_HZ[number % len(RATES_HZ)]
    drawn = {
        "sim.delay_s": round(float(rng.uniform(0.0, 0.08)), 3),
        "sim.smoothing_s": round(float(rng.uniform(0.001, 0.04)), 3),
        "rates.robot_hz": robot_hz,
        "rates.control_hz": control_hz,
    }
    cell = TuneCell(overrides=drawn)
    readings = run(cell, TuningTrial())
    arm, found = cell.world.arm.settings, readings.arm
    lag_s = (arm.smoothing_ticks - 1) / 2 * TICK_S + arm.servo_lag_s
    true_s = arm.delay_s + lag_s
    assert found.sum_s == pytest.approx(true_s, abs=SHARP_S)
    assert abs(found.sum_s - true_s) <= 2.0 * found.deviation_s
    assert true_s <= found.bound_s < true_s + SHARP_S
    least_s, most_s = found.lags_s
    assert least_s <= lag_s <= most_s


@pytest.mark.long
@pytest.mark.parametrize(("delay_s", "k"), [(0.0, 5e3), (0.01, 1e5)])
def test_it_finds_delay_lag_and_stiffness_of_the_simulated_arm(delay_s: float, k: float) -> None:
    """The sum to 2 ms, the stiffness to 3 % and the stated spread; then the arm is at its start."""
    sim = {"sim.delay_s": delay_s, "sim.stiffness_N_m": k}
    cell = TuneCell(overrides=sim | {"contact.stiffness_N_m": 1e5, "force.approach_m_s": 0.0025})
    start, gain = cell.p(), tune(cell.client.config).force_i_m_per_Ns
    readings = measure(
        cell.client, TuningTrial(), gain=gain, with_press=True, with_controller=False
    )
    arm, spring = readings.arm, readings.spring
    true_s = delay_s + cell.client.config.robot.lag_s
    assert arm.sum_s == pytest.approx(true_s, abs=SHARP_S)
    assert spring is not None
    assert spring.k_N_m == pytest.approx(k, rel=0.03)
    assert abs(spring.k_N_m - k) <= 4.0 * spring.spread_N_m + 0.01 * k
    assert spring.repeats
    assert cell.p() == pytest.approx(start, abs=2e-4)
    cell.world.advance(0.3)
    assert cell.client.status().state == "ARMED"


def test_tune_starts_armed_in_free_space() -> None:
    """Each refusal is one sentence, without any motion."""
    cell = TuneCell()
    start = cell.p()
    trial = TuningTrial(step_m=0.01)
    cell.world.arm.data.xfrc_applied[cell.world.arm.model.body("tool").id][:3] = (0.0, 0.0, 8.0)
    cell.world.advance(0.3)
    with pytest.raises(NotReachedError, match=r"[78]\.\d N measured before contact"):
        run(cell, trial)
    cell.world.arm.data.xfrc_applied[:] = 0.0
    cell.world.advance(0.3)
    cell.client.hold()
    cell.world.advance(0.1)
    with pytest.raises(RefusedError, match="the arbiter is HOLDING: tune starts armed"):
        run(cell, trial)
    assert cell.p() == pytest.approx(start, abs=1e-4)


def test_the_verb_measures_writes_and_applies(monkeypatch, tmp_path: Path) -> None:
    """Steps alone give tau as JSON, a picture, a tuning file and gains; wrong usage is refused."""
    cell = TuneCell()
    written, out = tmp_path / "tuning.yaml", tmp_path / "tune.png"
    words = ("--no-press", "--json", "--apply", "--write", str(written), "--out", str(out))
    done = call_verb(monkeypatch, cell.client, no_progress, "tune", *words)
    assert done.exit_code == 0, done.stderr
    report = json.loads(done.stdout)
    config = cell.client.config
    assert report["tau_s"] == pytest.approx(config.plant.tau_s, abs=CHAIN_S)
    true_s = config.robot.delay_s + config.robot.lag_s
    assert report["delay_and_lag_s"] == pytest.approx(true_s, abs=SHARP_S)
    assert report["refused"] is None
    assert report["stiffness_N_m"] is None
    advised = report["hosts"]["pc"]["gains"]["force_i_m_per_Ns"]
    assert cell.client.force.gains().force_i_m_per_Ns == pytest.approx(advised)
    assert advised[2] == pytest.approx(tune(config).force_i_m_per_Ns, rel=0.1)
    assert written.read_text().count("delay_s") == 1
    assert out.read_bytes().startswith(b"\x89PNG")
    for wrong, message in (
        (("--force", "90"), "--force 90: the cell allows at most 40 N"),
        (("--for", "controller"), "--for controller: this cell offers pc"),
    ):
        done = call_verb(monkeypatch, cell.client, no_progress, "tune", *wrong)
        assert (done.exit_code, done.stdout, done.stderr) == (2, "", f"{message}\n")


def test_the_verb_writes_and_sets_nothing_outside_the_range_of_the_law(
    monkeypatch, tmp_path: Path
) -> None:
    """It prints the measured values and the reason; a loop that was not measured is refused too."""
    cell, written = TuneCell(), tmp_path / "tuning.yaml"
    gains, config = cell.client.force.gains(), cell.client.config
    robot = config.robot.model_copy(update={"hosts": ("pc", "controller")})
    cell.client.config = config.model_copy(update={"robot": robot})
    found = Readings(servo=Servo(0.03, 5e-4, 0.005, 0.012), spring=Spring(3e5, 1e3))
    monkeypatch.setattr("cli.tune.measure.measure", lambda *_, **__: found)
    words = ("tune", "--apply", "--write", str(written))
    done = call_verb(monkeypatch, cell.client, no_progress, *words)
    assert done.exit_code == 1
    assert done.stderr.startswith("nothing is recommended, written or set: too stiff: 3e+05 N/m")
    assert "together 30.0 +/- 1.0 ms" in done.stdout
    found.spring = Spring(2e4, 100.0)
    done = call_verb(
        monkeypatch, cell.client, no_progress, "tune", "--apply", "--for", "controller"
    )
    assert done.exit_code == 2
    assert done.stderr == "--for controller: its loop was not measured, so no gains are set\n"
    assert cell.client.force.gains() == gains
    assert not written.exists()


def run(cell: TuneCell, trial: TuningTrial) -> Readings:
    """Measure only the steps."""
    return measure(cell.client, trial, gain=1e-3, with_press=False, with_controller=False)


@pytest.mark.parametrize(("noise_m", "presses"), [(1e-7, 1), (4e-5, 3), (4e-4, 0)])
def test_a_press_is_repeated_until_it_determines_a_stiffness_or_is_refused(
    noise_m: float, presses: int, monkeypatch
) -> None:
    """Repeatable positions need one press, scattered ones three; the error gives their results."""
    cell, rng = TuneCell(), np.random.default_rng(1)
    monkeypatch.setattr(cell.client.force, "begin", lambda _: None)
    measuring = TuningMeasurement(cell.client, TuningTrial())

    def place(_monitor, level_N, _what):
        return level_N / 2e4 + noise_m * rng.normal(), level_N

    monkeypatch.setattr(measuring, "_settled_point", place)
    error = pytest.raises(DataError, match=r"3 presses showed .* press harder")
    with nullcontext() if presses else error:
        measuring.press()
        assert len(measuring.readings.travel_m) == 5 * presses
