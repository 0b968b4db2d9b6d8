"""controller/plain.as: what can be read off the file, and behaviour beyond the client's test."""

import random
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import oat_from_R
from controller.packet import ZERO_VEC, Packet, VecInt
from controller.packet_table import Com
from controller.plain import (
    PROGRAM,
    START,
    Controller,
    PlainReader,
    PlainSection,
    encode,
    program,
)
from sim.as_language.lint import check_text
from sim.controller.behaviour import Behaviour, pessimistic
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from tests.fakes.controller import PORT, QUICK, RunningController, parsed

TEXT = PROGRAM.read_text(encoding="ascii")
# It stops with E1117 (process time over) where a motion is too short to be planned.
STRICT = QUICK.model_copy(update={"least_segment_s": 0.03, "least_speed_m_s": 0.0012})
CHARS, POLL_S, SAMPLE_S = 63, 0.002, 0.02
FINE = PlainSection(
    position_per_mm=50, oat_per_deg=500, joint_per_deg=250, force_per_N=100, torque_per_Nm=1000,
    gain_p=1000, gain_i=1000,
)  # fmt: skip


class PlainClient:
    """A controller with a tool of 160 mm, and a client with the fine scales of its pl.config."""

    def __init__(self, *, text: str = "", behaviour: Behaviour = STRICT, **sim: Any) -> None:
        """Connect; `text` is the program instead of the cell's."""
        self.network = MemoryNetwork()
        self.controller = RunningController(
            text or program(FINE, Controller(centre_mm=(0.0, 0.0, 160.0))), START,
            behaviour=behaviour, network=self.network, **sim,
        )  # fmt: skip
        self.arm, self.printed = self.controller.arm, self.controller.printed
        assert self.controller.advance(10.0, lambda: PORT in self.network.listeners)
        self.stream = self.network.dial(PORT)
        self.reports: list[Packet] = []
        self.id, self.closed = 0, False
        self._reader = PlainReader(CHARS)
        self.advance(0.1)

    def advance(self, duration_s: float) -> None:
        """Advance the controller, and receive."""
        for _ in range(round(duration_s / POLL_S)):
            self.controller.advance(POLL_S)
            if not self.closed:
                self._receive()

    def _receive(self) -> None:
        try:
            data = self.stream.receive(65536)
        except ConnectionResetError:
            data = b""
        self.closed = data == b""
        self.reports += self._reader.feed(data or b"")

    def until(self, condition: Callable[[], object], within_s: float = 10.0) -> None:
        """Advance until a condition is true."""
        for _ in range(round(within_s / POLL_S)):
            if condition():
                return
            self.advance(POLL_S)
        raise AssertionError(f"not in {within_s} s: {self.controller.machine.stops}")

    def rest(self) -> None:
        """Advance until the arm rests."""
        self.until(lambda: not self.arm.moving)

    def send(self, com: int, param: int = 0, vec: VecInt = ZERO_VEC) -> int:
        """Send a command; return its ID."""
        self.id += 1
        self.stream.send(encode(Packet(self.id, com, param, vec), CHARS))
        return self.id

    def do(self, com: int, param: int = 0, vec: VecInt = ZERO_VEC) -> None:
        """Send a command and wait until it is taken."""
        id_ = self.send(com, param, vec)
        self.until(lambda: self.reports and self.taken == id_)

    @property
    def taken(self) -> int:
        """The ID of the newest 101."""
        return next(packet.id for packet in reversed(self.reports) if packet.com == Com.POSE)

    def height_mm(self) -> float:
        """True height of the flange."""
        return float(self.arm.T_base_flange.translation[2] * 1e3)

    def shifted(self, z: float, turn_deg: float = 0.0) -> VecInt:
        """Return the present pose, shifted and turned along z [mm, deg], as six numbers."""
        T = self.arm.T_base_flange
        oat = oat_from_R(pin.utils.rotate("z", np.radians(turn_deg)) @ T.rotation)
        position = (T.translation * 1e3 + np.array([0.0, 0.0, z])) * FINE.position_per_mm
        numbers = (*position, *(np.degrees(oat) * FINE.oat_per_deg))
        x, y, up, o, a, t = (round(float(value)) for value in numbers)
        return (x, y, up, o, a, t)

    def fastest(self) -> tuple[float, float]:
        """Advance until the arm rests; return the highest speeds of the flange [mm/s, deg/s]."""
        line = turn = 0.0
        self.until(lambda: self.arm.moving)
        while self.arm.moving:
            before = self.arm.T_base_flange
            self.advance(POLL_S)
            motion = before.actInv(self.arm.T_base_flange)
            line = max(line, float(np.linalg.norm(motion.translation)) * 1e3 / POLL_S)
            turned = np.degrees(np.linalg.norm(pin.log3(motion.rotation)))
            turn = max(turn, float(turned) / POLL_S)
        return line, turn

    def press(self, force_N: float, duration_s: float) -> None:
        """Send the reading less a force to press with, along z, for some time."""
        for _ in range(round(duration_s / SAMPLE_S)):
            true = self.arm.true_wrench()
            error = true.force_N - np.array([0.0, 0.0, force_N])
            units = (*(error * FINE.force_per_N), *(true.torque_Nm * FINE.torque_per_Nm))
            a, b, c, d, e, f = (round(float(value)) for value in units)
            self.send(Com.WRENCH, 0, (a, b, c, d, e, f))
            self.advance(SAMPLE_S)


# --- the text -------------------------------------------------------------------------------------


def test_the_emulator_finds_nothing_in_the_file() -> None:
    """Strict; no name is of the other program, which may be in the same controller."""
    report = check_text(TEXT, PROGRAM.name)
    assert report.exit_code(strict=True) == 0, [str(finding) for finding in report.findings]
    assert not re.search(r"\bfm\.[a-z]", re.sub(r";.*", "", TEXT))


def test_no_subroutine_is_shared_by_two_tasks_and_pc_programs_only_brake() -> None:
    """AS refuses a subroutine that another task is in, and motions in PC programs."""
    bodies = dict(re.findall(r"(?ms)^\.PROGRAM ([\w.]+)\(.*?\)(.*?)^\.END", TEXT))
    for task in ("pl.send", "pl.recv"):
        assert not re.search(r"(?m)^\s*(CALL|LMOVE|JMOVE|BREAK|TOOL|BASE)\b", bodies[task])
    assert set(re.findall(r"(?m)^\s*PCEXECUTE \d: ([\w.]+)", TEXT)) == {"pl.send", "pl.recv"}


# --- behaviour ------------------------------------------------------------------------------------


@pytest.fixture
def client() -> PlainClient:
    """A client over a plate 3 mm below the tool."""
    return PlainClient(gap_m=0.003, stiffness_N_m=3000.0, tilt_deg=3.0)


def test_orientation_feedback_turns_the_tool_onto_a_tilted_plate(client) -> None:
    """Both, Param 0 and 1: 10 N, and no moment about the point of pl.tx, pl.ty, pl.tz."""
    client.send(Com.GAINS, 1, (1000, 1000, 1000, 30_000, 30_000, 30_000))
    client.send(Com.FEEDBACK, 0)
    client.press(10.0, 4.0)
    before = client.arm.true_wrench().torque_Nm
    client.send(Com.FEEDBACK, 1)
    client.press(10.0, 8.0)
    force, torque = client.arm.true_wrench().force_N, client.arm.true_wrench().torque_Nm
    assert client.controller.value("pl.mode") == 3
    assert force[2] == pytest.approx(10.0, abs=1.0)
    assert float(np.linalg.norm(torque)) < 0.3 * float(np.linalg.norm(before))
    assert float(np.linalg.norm(torque)) < 0.02
    tool = client.arm.T_base_tcp.rotation[:, 2]
    assert np.degrees(np.arccos(-tool @ client.arm.plate.normal)) < 0.3


def test_the_proportional_gain_acts_on_the_change_of_the_force(client) -> None:
    """1 mm/N: a step of 2 N displaces by 2 mm, and the first reading by nothing."""
    z = client.height_mm()
    client.send(Com.GAINS, 0, (1000, 1000, 1000, 0, 0, 0))
    client.send(Com.FEEDBACK, 0)
    for force in (500, 700, 700):
        client.do(Com.WRENCH, 0, (0, 0, force, 0, 0, 0))
    client.rest()
    assert client.height_mm() - z == pytest.approx(2.0, abs=0.05)


def test_a_silence_is_not_made_up_for(client) -> None:
    """A reading is integrated over pl.dtmax, 0.1 s, at most: 1 mm/(N s), 5 N, 3 s: 0.5 mm."""
    z = client.height_mm()
    client.send(Com.GAINS, 1, (1000, 1000, 1000, 0, 0, 0))
    client.send(Com.FEEDBACK, 0)
    client.do(Com.WRENCH, 0, (0, 0, 500, 0, 0, 0))
    client.advance(3.0)
    client.do(Com.WRENCH, 0, (0, 0, 500, 0, 0, 0))
    client.advance(0.5)
    assert client.height_mm() - z == pytest.approx(0.5, abs=0.05)


def test_a_motion_ends_force_feedback(client) -> None:
    """Two never command the arm: a reading after a command 3 moves nothing."""
    client.send(Com.FEEDBACK, 0)
    client.do(Com.MOVE_BY_JOINTS, 0, (0, 0, 0, 0, 0, 0))
    assert client.controller.value("pl.mode") == 0


@pytest.mark.parametrize(
    ("com", "param", "id_"),
    [(0, 0, 1), (8, 0, 1), (101, 0, 1), (1, 1, 1), (6, 2, 1), (7, 3, 1), (7, -1, 1), (4, 1, 1)],
)
def test_what_is_no_command_of_the_specification_ends_the_connection(client, com, param, id_):
    """Com 1 to 7; Param 0, but 0 and 1 of command 6, and 0 to 2 of command 7."""
    client.stream.send(encode(Packet(id_, com, param), CHARS))
    client.until(lambda: client.closed)
    assert any("not a packet of commands 1 to 7" in line for line in client.printed)


@pytest.mark.parametrize(
    ("place", "text"),
    [
        *((7 * frame, b"+00001") for frame in range(9)),
        *((7 * frame + 6, b"0") for frame in range(9)),
        (21, b"00E005"),  # a power of ten, which VAL would read
        (28, b"0000 1"),
        (35, b"00001x"),
        (0, b"000000"),  # IDs are from 1
    ],
)
def test_wrong_characters_are_found_in_every_number(client, place, text) -> None:
    """Each number and each space is needed: a packet that is one character off is none."""
    data = bytearray(encode(Packet(1, Com.WRENCH), CHARS))
    data[place : place + len(text)] = text
    client.stream.send(bytes(data))
    client.until(lambda: client.closed)


def test_commands_that_are_not_taken_end_the_connection(client) -> None:
    """The robot program is held on the pendant: 31 wait, the next one is too many."""
    client.controller.machine.pendant.hold()
    for _ in range(40):
        client.send(Com.WRENCH)
    client.until(lambda: client.closed)
    assert any("32 commands wait" in line for line in client.printed)


@pytest.mark.parametrize("com", [Com.MOVE_POSE, Com.FEEDBACK])
def test_a_command_of_a_connection_that_has_ended_is_void(client, com) -> None:
    """Held on the pendant when it came: after RUN it starts nothing."""
    client.controller.machine.pendant.hold()
    client.send(com, 0, client.shifted(z=50.0))
    client.advance(0.2)
    client.stream.close()
    client.closed = True
    client.advance(0.2)
    z = client.height_mm()
    client.controller.machine.pendant.run()
    client.advance(1.0)
    assert client.height_mm() == pytest.approx(z, abs=0.01)
    assert client.controller.value("pl.mode") == 0


@pytest.mark.parametrize("worse", [False, True], ids=["kind", "pessimistic"])
def test_the_arm_stops_at_the_end_of_a_connection_in_both_readings_of_the_manual(worse) -> None:
    """Force feedback in a long slow step, the next one waiting: it stops within 0.1 s."""
    behaviour = pessimistic(QUICK.step_s) if worse else STRICT
    client = PlainClient(behaviour=behaviour, gap_m=0.1)
    client.do(Com.MOVE_BY_JOINTS, 0, (250, 0, 0, 0, 0, 0))  # the first motion is planned
    client.advance(2.0)
    client.send(Com.SPEEDS, 0, (100, 100, 100, 10, 0, 0))
    client.send(Com.GAINS, 1, (30_000, 30_000, 30_000, 0, 0, 0))
    client.send(Com.FEEDBACK, 0)
    for _ in range(4):
        client.send(Com.WRENCH, 0, (0, 0, 2000, 0, 0, 0))
        client.advance(0.05)
    z = client.height_mm()
    client.advance(0.5)
    assert client.height_mm() > z + 2.0
    client.stream.close()
    client.closed = True
    client.advance(0.1)
    q = client.arm.q
    client.advance(1.0)
    assert np.abs(client.arm.q - q).max() < 1e-5


def test_a_client_that_does_not_read_loses_its_connection() -> None:
    """The sender's time-out is the end of the connection, also without a character from it."""
    client = PlainClient()
    assert client.controller.value("pl.link") == 1
    assert client.controller.advance(10.0, lambda: client.controller.value("pl.lost") == 1)


def test_a_joint_motion_moves_the_flange_no_faster_than_its_speed(client) -> None:
    """50 % of 200 mm/s, for 20 degrees of JT1 at 0.5 m; AS takes mm/s for a share of 100 %."""
    client.send(Com.SPEEDS, 0, (100, 100, 50, 200, 0, 0))
    client.send(Com.MOVE_BY_JOINTS, 0, (20 * 250, 0, 0, 0, 0, 0))
    line_mm_s, _ = client.fastest()
    assert 80.0 < line_mm_s < 102.0


@pytest.mark.parametrize("com", [Com.MOVE_POSE, Com.MOVE_BY_JOINTS])
def test_a_pure_turn_is_limited_in_degrees_per_second(client, com) -> None:
    """One degree counts as 1.75 mm: 50 mm/s is 28.6 deg/s, where MM/S of AS limits nothing."""
    client.do(Com.MOVE_POSE, 0, client.shifted(z=60.0))
    client.rest()
    by_joint = (0, 0, 0, 0, 0, -50 * 250)
    client.send(com, 0, by_joint if com == Com.MOVE_BY_JOINTS else client.shifted(0.0, 50.0))
    _, turn_deg_s = client.fastest()
    assert 20.0 < turn_deg_s < 1.02 * 50.0 / 1.75


def press_at_random(client: PlainClient, mode: int) -> tuple[float, float]:
    """Run force feedback at 40 mm/s with readings each 4 to 20 ms; return travel and turn [deg]."""
    draw, arm = random.Random(mode), client.arm
    client.send(Com.SPEEDS, 0, (100, 100, 100, 40, 0, 0))
    for param, gain in ((0, 200), (1, 2000)):
        client.send(Com.GAINS, param, (gain, gain, gain, gain, gain, gain))
    for param in (0, 1):
        if mode & (1 << param):
            client.send(Com.FEEDBACK, param)
    client.advance(0.2)
    travel_mm = turned_deg = 0.0
    for _ in range(100):
        force = [round(draw.gauss(300.0, 300.0)) for _ in range(3)]
        torque = [round(draw.gauss(500.0, 500.0)) for _ in range(3)]
        if client.taken == client.id:
            client.send(Com.WRENCH, 0, (*force, *torque))  # type: ignore[arg-type]
        before = arm.T_base_flange
        client.advance(draw.uniform(0.004, 0.02))
        motion = before.actInv(arm.T_base_flange)
        travel_mm += float(np.linalg.norm(motion.translation)) * 1e3
        turned_deg += float(np.degrees(np.linalg.norm(pin.log3(motion.rotation))))
    return travel_mm, turned_deg


@pytest.mark.parametrize("ahead", [1, 3])
@pytest.mark.parametrize("mode", [1, 2, 3])
def test_force_feedback_of_any_reading_is_planned_in_time(ahead: int, mode: int) -> None:
    """No E1117, and never faster than command 5."""
    client = PlainClient(behaviour=STRICT.model_copy(update={"motions_ahead": ahead}))
    begin_ns = client.controller.machine.now_ns
    travel_mm, turned_deg = press_at_random(client, mode)
    seconds = (client.controller.machine.now_ns - begin_ns) * 1e-9
    assert client.controller.machine.control.error is None
    assert client.controller.value("pl.mode") == mode
    if mode & 1:
        assert 5.0 < travel_mm < 42.0 * seconds + turned_deg * 160.0 / 57.3
    assert (1.0 < turned_deg < 42.0 / 1.75 * seconds) if mode > 1 else turned_deg < 0.1


def test_without_the_least_segment_the_planner_stops_with_e1117() -> None:
    """What the pacing is for: with segments of 1 ms the same controller stops."""
    client = PlainClient(text=program(FINE, Controller(least_segment_s=0.001)))
    press_at_random(client, 1)
    assert str(client.controller.machine.control.error).startswith("(E1117)")


def test_a_rotation_by_zero_stops_without_going_back(client) -> None:
    """The joints count from rest, not from where they were when it came."""
    client.send(Com.SPEEDS, 0, (100, 100, 100, 250, 0, 0))
    client.do(Com.MOVE_POSE, 0, client.shifted(z=150.0))
    client.advance(0.4)
    client.send(Com.MOVE_BY_JOINTS)
    heights = []
    for _ in range(200):
        client.advance(0.002)
        heights.append(client.height_mm())
    assert heights[-1] > heights[0] + 1.0
    assert max(heights) - heights[-1] < 0.1


def test_a_scale_that_the_pose_does_not_fit_sends_nothing() -> None:
    """Never clipped: the terminal names it, and no report comes."""
    text = program(FINE, Controller()).replace("  pl.sj=250 ", "  pl.sj=9999 ")
    client = PlainClient(text=text)
    client.advance(0.5)
    assert client.reports == []
    assert any("does not fit into six characters" in line for line in client.printed)


# --- what the program changes ---------------------------------------------------------------------

TOOL = pin.SE3(pin.utils.rotate("x", 0.3), np.array([0.01, -0.02, 0.15]))
BASE = pin.SE3(pin.utils.rotate("z", -0.5), np.array([0.1, 0.2, -0.3]))
USERS = {"cp": False, "abs.speed": True, "qtool": True}


def users_settings(machine: Machine) -> None:
    """Set what a user may have: TOOL, BASE, and the switches that the program needs otherwise."""
    machine.robot.T_flange_tcp, machine.robot.T_base_shift = TOOL, BASE
    machine.hardware.switches.update(USERS)


def are_the_users(machine: Machine) -> bool:
    """Return whether they are the user's, the frames to a float's precision."""
    robot, switches = machine.robot, machine.hardware.switches
    frames = ((robot.T_flange_tcp, TOOL), (robot.T_base_shift, BASE))
    same = all(np.allclose(is_.homogeneous, was.homogeneous, atol=1e-6) for is_, was in frames)
    return same and all(switches[name] == value for name, value in USERS.items())


@pytest.mark.parametrize("end", ["quit", "restore", "started again, then quit"])
def test_the_end_puts_back_tool_base_and_switches(end: str) -> None:
    """pl.quit=1; EXECUTE pl.restore after an abort; a run after an abort keeps the user's."""
    controller = RunningController(TEXT, START, prepare=users_settings)
    machine = controller.machine
    switches = machine.hardware.switches
    assert controller.advance(1.0, lambda: switches["cp"])
    controller.advance(1.0)
    assert [switches[name] for name in USERS] == [True, False, False]
    if end != "quit":
        machine.pendant.abort()
        assert controller.advance(10.0, lambda: machine.robot_task.state == "idle")
        machine.pendant.execute("pl.restore" if end == "restore" else START)
        controller.advance(1.0)
    if end != "restore":
        machine.memory.write("pl.quit", 1.0)
    assert controller.advance(10.0, lambda: machine.robot_task.state == "idle")
    assert are_the_users(machine)
    assert not any(task.active for task in machine.tasks)


@pytest.mark.parametrize("number", [1, 2])
def test_another_program_in_a_slot_is_reported_and_never_aborted(number: int) -> None:
    """It may guard something: pl.main ends and changes nothing."""

    def occupied(machine: Machine) -> None:
        users_settings(machine)
        machine.load(parsed(TEXT + ".PROGRAM guard()\n  WAIT 1==2\n.END\n"))
        machine.control.start_pc(number, "guard")

    controller = RunningController(TEXT, START, prepare=occupied)
    controller.advance(1.0)
    assert f"another program is in {number}" in " ".join(" ".join(controller.printed).split())
    assert controller.machine.tasks[number].state == "running"
    assert controller.machine.robot_task.state == "idle"
    assert are_the_users(controller.machine)
