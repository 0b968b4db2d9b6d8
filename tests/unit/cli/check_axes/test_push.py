"""`forcemesh check axes`: a scripted person follows the prompts; a recording is judged."""

import json
import re
from functools import partial

import numpy as np
import pytest

from cli.check_axes.push import PushTest
from common.bus.configured_cell import ConfiguredCell
from forcemesh import topics
from forcemesh.requests import ArmRequest
from identification.errors import CalibrationError
from identification.installation.axis_fit import SIGNED
from identification.installation.terms import ExpectedInstallation
from launch.virtual_cell import VirtualCell
from sim.robot.ft_sensor import FtSample
from tests.fakes import verb_calls
from tests.fakes.bench import CELL, DEMO, HALF_CELL
from tests.fakes.installations import recorded

NS_PER_S = 1e9
BEGIN_S, END_S = 0.4, 1.2  # after the prompt
AXES = {"+x": (1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "straight up": (0.0, 0.0, 1.0)}


class Person:
    """Person who follows the prompts and pushes the tip of the tool, some degrees off."""

    def __init__(self, cell: VirtualCell, wiring=SIGNED[0], *, size_N=10.0) -> None:
        """Set the wiring of the sensor's channels."""
        self.cell, self.size_N = cell, size_N
        self.notes: list[str] = []
        self.push = np.zeros(6)  # force and torque on the sensor, base axes
        self.began_ns = 0
        self.prompts_to_ignore = 0  # number of prompts not followed
        sensor = cell.arm.ft_sensor
        sensor.wiring[:3, :3] = sensor.wiring[3:, 3:] = wiring
        self.wiring = wiring
        sensor.disturb = self._disturb

    def note(self, text: str) -> None:
        """Read a line; push when it requests a push."""
        self.notes.append(text)
        if not re.match(r"(push|twist) the t", text):
            return
        if self.prompts_to_ignore:
            self.prompts_to_ignore -= 1
            return
        self.began_ns = self.cell.clock.now_ns()
        self.push = np.zeros(6)
        if text.startswith("twist"):
            self.push[5] = 0.6
            return
        direction = next(np.array(v) for name, v in AXES.items() if name in text)
        force = self.size_N * (direction + np.array([0.1, -0.15, 0.1]))
        T_tcp, T_sensor = self.cell.arm.T_base_tcp, self._T_sensor()
        self.push[:3] = force
        self.push[3:] = np.cross(T_tcp.translation - T_sensor.translation, force)

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Check the progress."""
        assert 0.0 <= done_s <= total_s
        assert text

    def _T_sensor(self):
        return self.cell.arm.T_base_flange * CELL.sensor.T_flange_sensor.pose

    def _disturb(self, sample: FtSample) -> FtSample:
        since_s = (self.cell.clock.now_ns() - self.began_ns) / NS_PER_S
        if not self.began_ns or not BEGIN_S < since_s < END_S:
            return sample
        R_T = self._T_sensor().rotation.T
        force, torque = (self.wiring @ R_T @ v for v in (self.push[:3], self.push[3:]))
        return FtSample(
            sample.force_N + force, sample.torque_Nm + torque, sample.status, sample.counter
        )


def client_of(cell: VirtualCell) -> ConfiguredCell:
    """Return a client of the cell."""
    return ConfiguredCell(CELL, bus=cell.client)


def pushed(cell, person):
    """Return the result of the whole test."""
    return PushTest(client_of(cell), person, within_s=3.0).run(ExpectedInstallation.of(CELL))


@pytest.fixture
def cell() -> VirtualCell:
    """A running cell that is not armed."""
    world = VirtualCell(HALF_CELL)
    world.advance(1.2)
    return world


def test_correct_pushes_confirm_a_correct_wiring(cell) -> None:
    """Four prompts, four confirmations, no remedy; the arm does not move.

    The test waits until the hands leave the tool, and repeats a prompt that is not followed.
    """
    person = Person(cell)
    person.push, person.began_ns = np.full(6, 2.0), cell.clock.now_ns()
    person.prompts_to_ignore = 1
    found = pushed(cell, person)
    assert any("no push +x within 3 s" in note for note in person.notes)
    assert found.verdict == "right", [str(f) for f in found.findings]
    assert not found.unidentified
    assert sum(note.endswith("right") for note in person.notes) == 4
    assert not cell.arm.moving


def test_the_push_test_is_refused_for_an_armed_arm(cell) -> None:
    """It is refused at once, with the command that ends the arming."""
    test = PushTest(client_of(cell), Person(cell))
    assert cell.client.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
    cell.advance(0.1)
    with pytest.raises(CalibrationError, match="forcemesh hold"):
        test.run(ExpectedInstallation.of(CELL))


run = partial(verb_calls.run, "check", "axes", "--cell", DEMO)


@pytest.mark.parametrize("axes", ["sensor", "base"])
def test_a_right_recording_ends_with_zero(tmp_path, axes) -> None:
    """The axes of the recording are identified and printed."""
    result = run("--from", recorded(tmp_path / "a.csv", wrench_axes=axes))
    assert result.exit_code == 0, result.output
    assert "right: axes, signs and units are those of the cell file" in result.stdout
    assert f"in {axes} axes" in result.stdout


def test_a_wrong_recording_gives_the_finding_and_the_remedy(tmp_path) -> None:
    """Exit code 1, the finding, and the remedy below it."""
    result = run("--from", recorded(tmp_path / "a.csv", SIGNED[2]))
    assert result.exit_code == 1
    assert "Fy shows -y" in result.stdout
    assert "-> in the driver or the adapter: remap Fy = -Fy" in result.stdout


def test_json_is_one_object_with_the_numbers(tmp_path) -> None:
    """Verdict, findings with code and remedy, wiring, evidence."""
    result = run("--from", recorded(tmp_path / "a.csv", SIGNED[18]), "--json")
    tree = json.loads(result.stdout)
    assert tree["verdict"] == "wrong"
    assert tree["findings"][0]["code"] == "mounting"
    assert tree["findings"][0]["remedy"].startswith("write sensor.T_flange_sensor.oat_deg: [")
    assert tree["force_channels_show"] == SIGNED[18].tolist()
    assert tree["evidence"]["poses"] == 8
