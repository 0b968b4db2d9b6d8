"""`tune` on a whole cell in virtual time: it finds what is there, and leaves the arm as it was."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.skills.feel import silent
from cli.tuning.measure import Trial, measure
from cli.virtual import VirtualCell
from common.client import Cell
from common.config import load_cell
from common.errors import NotReachedError, RefusedError
from services.regulator.tuning import tune
from tests.fakes.verbs import said

CELLS = Path(__file__).resolve().parents[2] / "cells"
CHAIN_S = 0.003  # at most, from the arbiter's command to the robot, and back in its report


class Tuned:
    """A cell in virtual time, armed, its tool in free space."""

    def __init__(self, name: str = "demo.yaml", overrides=None) -> None:
        config = load_cell(CELLS / name, overrides)
        self.world = VirtualCell(config)
        self.client = Cell(config, bus=self.world.client, commander="operator")
        self.world.advance(1.6)
        self.client.wait_ready()
        self.client.tare()
        self.client.arm()
        self.world.advance(0.1)

    def p(self) -> np.ndarray:
        """True place of the flange."""
        return np.array(self.world.arm.T_base_flange.translation)


@pytest.mark.long
@pytest.mark.parametrize(("delay_s", "k"), [(0.0, 5e3), (0.01, 1e5), (0.04, 2e4)])
def test_it_finds_delay_lag_and_stiffness_of_the_simulated_arm(delay_s: float, k: float) -> None:
    """The sum to a few milliseconds, never too little; the stiffness to 3 %; then it is back."""
    sim = {"sim.delay_s": delay_s, "sim.stiffness_N_m": k}
    cell = Tuned(overrides=sim | {"contact.stiffness_N_m": 1e5, "force.approach_m_s": 0.0025})
    start, gain = cell.p(), tune(cell.client.config).force_i_m_per_Ns
    readings = measure(cell.client, Trial(), gain=gain, with_press=True, with_controller=False)
    servo, spring = readings.servo, readings.spring
    true_s = delay_s + cell.client.config.robot.lag_s
    assert -5e-4 < servo.delay_s + servo.lag_s - true_s < CHAIN_S
    assert spring is not None
    assert spring.k_N_m == pytest.approx(k, rel=0.03)
    assert cell.p() == pytest.approx(start, abs=2e-4)
    cell.world.advance(0.3)
    assert cell.client.status().state == "ARMED"


@pytest.mark.long
def test_the_controllers_own_loop_is_measured_too() -> None:
    """On the emulated controller: slower than its servo, about what its cell file allows for."""
    cell = Tuned("demo-tcp.yaml")
    gain = tune(cell.client.config).force_i_m_per_Ns
    readings = measure(cell.client, Trial(), gain=gain, with_press=True, with_controller=True)
    tau_s = readings.controller_tau_s
    assert tau_s is not None
    assert 0.03 < tau_s < 1.5 * cell.client.config.loop_delay_s
    assert 0.04 < readings.servo.delay_s + readings.servo.lag_s < 0.08


def test_it_begins_armed_free_and_inside_the_workspace() -> None:
    """Each refusal is one sentence, nothing has moved."""
    cell = Tuned()
    start = cell.p()
    x = float(start[0])
    trial = Trial(step_m=0.01)
    cell.world.arm.data.xfrc_applied[cell.world.arm.model.body("tool").id][:3] = (0.0, 0.0, 8.0)
    cell.world.advance(0.3)
    with pytest.raises(NotReachedError, match=r"feels [78]\.\d N before it touches"):
        run(cell, trial)
    cell.world.arm.data.xfrc_applied[:] = 0.0
    cell.world.advance(0.3)
    limits = cell.client.config.limits
    narrow = limits.model_copy(update={"workspace_max_m": (x + 0.001, *limits.workspace_max_m[1:])})
    wide = cell.client.config
    cell.client.config = wide.model_copy(update={"limits": narrow})
    with pytest.raises(NotReachedError, match="steps of 10 mm leave the workspace"):
        run(cell, trial)
    cell.client.config = wide
    cell.client.hold()
    cell.world.advance(0.1)
    with pytest.raises(RefusedError, match="the arbiter is HOLDING: tune begins armed"):
        run(cell, trial)
    assert cell.p() == pytest.approx(start, abs=1e-4)


def test_the_verb_measures_writes_and_applies(monkeypatch, tmp_path: Path) -> None:
    """Steps alone: tau as JSON, a picture, a file for the cell, gains set; wrong words are said."""
    cell = Tuned()
    written, out = tmp_path / "tuning.yaml", tmp_path / "tune.png"
    words = ("--no-press", "--json", "--apply", "--write", str(written), "--out", str(out))
    done = said(monkeypatch, cell.client, silent, "tune", *words)
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    config = cell.client.config
    assert told["tau_s"] == pytest.approx(config.loop_delay_s, abs=CHAIN_S)
    assert told["stiffness_N_m"] is None
    advised = told["hosts"]["pc"]["gains"]["force_i_m_per_Ns"]
    assert cell.client.force.gains().force_i_m_per_Ns == pytest.approx(advised)
    assert advised[2] == pytest.approx(tune(config).force_i_m_per_Ns, rel=0.1)
    assert written.read_text().count("delay_s") == 1
    assert out.read_bytes().startswith(b"\x89PNG")
    for wrong, says in (
        (("--force", "90"), "--force 90: the cell allows 40 N"),
        (("--for", "controller"), "--for controller: this cell offers pc"),
    ):
        done = said(monkeypatch, cell.client, silent, "tune", *wrong)
        assert (done.exit_code, done.stdout, done.stderr) == (2, "", f"{says}\n")


def test_ctrl_c_in_the_middle_of_the_steps_holds_the_arm(monkeypatch) -> None:
    """The verb ends with 130, the arbiter is HOLDING."""
    cell = Tuned()

    def interrupt(done, _total, _text) -> None:
        if done > 0.3:
            raise KeyboardInterrupt

    done = said(monkeypatch, cell.client, interrupt, "tune")
    assert (done.exit_code, done.stderr) == (130, "interrupted: the arm holds\n")
    cell.world.advance(0.1)
    assert cell.client.status().state == "HOLDING"


def run(cell: Tuned, trial: Trial) -> None:
    """Measure steps alone."""
    measure(cell.client, trial, gain=1e-3, with_press=False, with_controller=False)
