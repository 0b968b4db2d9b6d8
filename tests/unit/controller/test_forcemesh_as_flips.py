"""The program that ships, with one digit of one packet corrupted in transit: the motion is bounded.

The packet has no checksum, so a spoilt digit inside the six numbers is a good packet with another
number. Here every digit of every field of the commands 1, 2, 4, 5 and 13 becomes every other digit,
or a minus; what the limits of command 10 promise must hold all the same, and for the packets that
follow. A sample of it runs always, all of it with the long tests.
"""

import random
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import rotation_between
from controller.packet import FRAME_STRIDE, Packet, VecInt, encode
from controller.packet_table import Com, next_id
from tests.fakes.controller_talk import LIMITS, SCALES, Talk

TCP_MM = np.array([0.0, 0.0, 160.0])
TCP: VecInt = (0, 0, 8000, 0, 0, 0)
WALL_MM, TURN_DEG, STEP_MM, STEP_DEG, FASTEST_MM_S = 60.0, 30.0, 5.0, 2.0, 200.0
MOTION: VecInt = (15_000, 10_000, 250, 1_000, 2_000, 0)
FEEDBACK: VecInt = (25, 250, 500, 500, 5_000, 250)  # 0.5 mm, 0.5 deg, 50 mm/s, 10 mm, 50 N
GAIN: VecInt = (0, 0, 20_000, 0, 0, 0)
ITERATION_MM, TRAVEL_MM = 0.5, 10.0
SPEEDS: VecInt = (10_000, 10_000, 10_000, 1_500, 0, 0)
PUSH: VecInt = (0, 0, 200, 0, 0, 0)  # 2 N
BLEND = 1.5  # CP adds two motions where one runs into the next
SETTLE_MM, SETTLE_DEG = 0.5, 0.3
WATCHED_S = 0.25
PLACES = [k for k in range(9 * FRAME_STRIDE) if k % FRAME_STRIDE != FRAME_STRIDE - 1]
COMMANDS = (Com.MOVE_POSE, Com.MOVE_JOINTS, Com.WRENCH, Com.SPEEDS, Com.SET_POINT)
SAMPLE = 4  # flips of each command, always


def flips(com: Com) -> list[tuple[int, str]]:
    """Every place and its replacement; the present digit shows when it is sent."""
    rng = random.Random(int(com))
    found = [(place, char) for place in PLACES for char in "0123456789-"]
    rng.shuffle(found)
    return found


@dataclass
class CorruptionBench:
    """A controller, its promised limits, and the farthest that it went since `mark`."""

    talk: Talk = field(default_factory=Talk)
    connections: int = 0

    def __post_init__(self) -> None:
        """Put walls around where the tool is."""
        at = self.talk.T_mm.act(TCP_MM)
        self.low, self.high = at - WALL_MM, at + WALL_MM
        self.centre = self.talk.T_mm
        self.connect()
        self.talk.machine.after_tick.append(self._measure)

    def connect(self) -> None:
        """Greet and set up."""
        corners = []
        for corner in (self.low, self.high):
            x, y, z = (round(float(value)) for value in corner * SCALES[0])
            corners.append((x, y, z, 0, 0, 0))
        if not self.talk.closed:
            self.talk.hang_up()
        self.talk.live(0.2)
        self.talk.hello(limits=FEEDBACK, motion=MOTION, lower=corners[0], upper=corners[1], tcp=TCP)
        self.talk.do(Com.SPEEDS, 0, SPEEDS)
        self.connections += 1
        self.mark()

    def mark(self) -> None:
        """Begin to watch anew: the arm stands, after a hold."""
        self.start = self.before = self.commanded
        self.far_mm = self.turned_deg = self.fastest_mm_s = 0.0

    @property
    def commanded(self) -> pin.SE3:
        """The flange as commanded to the motors, in mm."""
        robot = self.talk.robot
        T = robot.kinematics.flange_pose(robot.queue.q_command)
        return pin.SE3(T.rotation, T.translation * 1e3)

    def _measure(self) -> None:
        """Judge each millisecond: box, turn, speed of the flange; and keep the farthest."""
        T = self.commanded
        tcp = T.act(TCP_MM)
        assert (tcp > self.low - SETTLE_MM).all(), tcp
        assert (tcp < self.high + SETTLE_MM).all(), tcp
        turn = np.degrees(np.linalg.norm(rotation_between(self.start.rotation, T.rotation)))
        assert turn < TURN_DEG + SETTLE_DEG
        step_mm = float(np.linalg.norm(T.translation - self.before.translation))
        assert step_mm < BLEND * FASTEST_MM_S * 1e-3
        self.before = T
        travel = T.translation - self.start.translation
        self.far_mm = max(self.far_mm, float(np.linalg.norm(travel)))
        self.turned_deg = max(self.turned_deg, float(turn))

    def rest(self) -> None:
        """Hold, or connect again where the program has closed; the arm stands."""
        if self.talk.closed:
            self.connect()
        self.talk.send(Com.HOLD)
        self.talk.live(0.25)
        if self.talk.closed:
            self.connect()
        self.mark()

    def send_corrupted(self, com: Com, vec: VecInt, place: int, char: str) -> bool:
        """Send a packet with one character replaced; False when it is the one that stands there."""
        id_ = next_id(self.talk.id)
        good = encode(Packet(id_, com, 0, vec))
        data = good[:place] + char.encode() + good[place + 1 :]
        if data == good:
            return False
        self.talk.id = id_
        self.talk.write(data)
        return True

    def near(self, mm: float) -> VecInt:
        """A pose so many mm from here towards the middle of the box, as turned as at the start."""
        T = self.talk.T_mm
        travel = self.centre.translation - T.translation
        travel = travel / max(1.0, float(np.linalg.norm(travel))) * mm
        return self.talk.pose_vec(pin.SE3(T.rotation, T.translation + travel))


_benches: list[CorruptionBench] = []


def bench() -> CorruptionBench:
    """One controller for all of them; a new one after a test has failed."""
    if not _benches:
        _benches.append(CorruptionBench())
    return _benches[0]


def try_goal(bench: CorruptionBench, com: Com, place: int, char: str) -> None:
    """A spoilt goal: anywhere in the box, no faster and no farther turned than is allowed."""
    a, b, c, d, e, f = (round(float(q) * SCALES[2]) for q in np.degrees(bench.talk.robot.q))
    vec = bench.near(1.0) if com == Com.MOVE_POSE else (a, b, c, d, e, f)
    if bench.send_corrupted(com, vec, place, char):
        bench.talk.live(WATCHED_S, beat=True)


def try_speed(bench: CorruptionBench, place: int, char: str) -> None:
    """A spoilt speed, and a goal behind it."""
    if bench.send_corrupted(Com.SPEEDS, SPEEDS, place, char) and not bench.talk.closed:
        bench.talk.send(Com.MOVE_POSE, 0, bench.near(8.0))
        bench.talk.live(WATCHED_S, beat=True)
        assert bench.far_mm < 8.0 + SETTLE_MM
    if not bench.talk.closed:
        bench.talk.send(Com.SPEEDS, 0, SPEEDS)


def try_set_point(bench: CorruptionBench, place: int, char: str) -> None:
    """A spoilt set point of a stream: one step aside at most, and those behind it go on."""
    talk = bench.talk
    vec = bench.near(1.0)
    talk.send(Com.SET_POINT, 0, bench.near(0.0))
    spoilt = bench.send_corrupted(Com.SET_POINT, vec, place, char)
    if spoilt:
        talk.live(0.05, beat=True)
    if spoilt and not talk.closed:
        talk.send(Com.SET_POINT, 0, vec)
        talk.live(WATCHED_S, beat=True)
    # Where Com itself was spoilt it is a goal, with the goal's own limits.
    if not FRAME_STRIDE <= place < 2 * FRAME_STRIDE:
        assert bench.far_mm < 1.0 + STEP_MM + SETTLE_MM
        assert bench.turned_deg < STEP_DEG + SETTLE_DEG


def try_wrench(bench: CorruptionBench, place: int, char: str) -> None:
    """A corrupted wrench of force feedback: an iteration and its return, and never its travel."""
    talk = bench.talk
    talk.start_feedback(1, gains_i=GAIN)
    for _ in range(3):
        talk.send(Com.WRENCH)
        talk.live(0.02)
    before = bench.commanded
    if bench.send_corrupted(Com.WRENCH, PUSH, place, char):
        for _ in range(5):
            talk.live(0.02)
            if not talk.closed:
                talk.send(Com.WRENCH)
        travel = float(np.linalg.norm(bench.commanded.translation - before.translation))
        # 14 for 4 is a set point that stays: pressed on until the stop, at 50 mm/s at most.
        most = ITERATION_MM if not FRAME_STRIDE <= place < 2 * FRAME_STRIDE else TRAVEL_MM
        assert travel < most + 0.1
    if not talk.closed:
        talk.send(Com.FEEDBACK, 2)


def run(com: Com, chosen: list[tuple[int, str]]) -> None:
    """Spoil one packet after another."""
    for place, char in chosen:
        try:
            corrupt(bench(), com, place, char)
        except BaseException as error:
            _benches.clear()
            error.add_note(f"command {int(com)}, character {place + 1} becomes {char!r}")
            raise


def corrupt(bench: CorruptionBench, com: Com, place: int, char: str) -> None:
    """Corrupt one packet, and measure the motion."""
    bench.rest()
    if com in {Com.MOVE_POSE, Com.MOVE_JOINTS}:
        try_goal(bench, com, place, char)
    elif com == Com.SPEEDS:
        try_speed(bench, place, char)
    elif com == Com.SET_POINT:
        try_set_point(bench, place, char)
    else:
        try_wrench(bench, place, char)
    assert bench.talk.machine.stops == []


@pytest.mark.parametrize("com", COMMANDS)
def test_a_spoilt_digit_moves_no_more_than_the_limits_allow(com: Com) -> None:
    """A few of each command, of the numbers that matter most: their first digits."""
    first = [(place, char) for place, char in flips(com) if place > 20 and place % FRAME_STRIDE < 3]
    run(com, first[:SAMPLE])


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("com", COMMANDS)
def test_no_spoilt_digit_moves_more_than_the_limits_allow(com: Com) -> None:
    """Every digit of every field."""
    run(com, flips(com))


def test_the_limits_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same with a controller without walls: the judge finds the prevented motions."""
    loose = CorruptionBench()
    monkeypatch.setattr(loose.talk, "hello", lambda **_: Talk.hello(loose.talk, limits=LIMITS))
    loose.connect()
    loose.talk.send(Com.MOVE_POSE, 0, loose.talk.shifted_vec(z=160.0))
    with pytest.raises(AssertionError):
        loose.talk.live(2.0, beat=True)
