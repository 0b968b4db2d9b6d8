"""A client written from the specification alone drives plain.as over a real TCP socket.

The client takes nothing of ours: nine numbers of six characters, commands a) to g), whole mm,
degrees, N and N m. The sensor is the simulated arm's own contact force, in base axes.
"""

import socket
from collections.abc import Callable, Iterator

import pytest

from controller.plain import PROGRAM, START
from sim.controller.network import SocketNetwork
from tests.fakes.controller import RunningController

pytestmark = pytest.mark.realtime

ZERO = [0, 0, 0, 0, 0, 0]


class SpecificationClient:
    """Sections 1.2 to 1.4 of the specification, with `gap` after each number."""

    def __init__(self, port: int, wait: Callable[[], object], gap: str = " ") -> None:
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._wait, self._gap, self._buffer = wait, gap, ""
        self._n = 9 * (6 + len(gap))
        self.id = self.taken = 0
        self.pose: list[int] = []
        self.joints: list[int] = []
        self.closed = False

    def send(self, com: int, param: int, vec: list[int]) -> int:
        """Send a command; return its ID."""
        self.id += 1
        numbers = [self.id, com, param, *vec]
        self.write("".join(f"{number:06d}{self._gap}" for number in numbers))
        return self.id

    def write(self, text: str) -> None:
        """Send characters."""
        self._socket.sendall(text.encode("ascii"))

    def receive(self) -> None:
        """Append what came to the buffer, and cut packets from it."""
        self._wait()
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return
        self.closed = data == b""
        self._buffer += data.decode("ascii")
        while len(self._buffer) >= self._n:
            text, self._buffer = self._buffer[: self._n], self._buffer[self._n :]
            step = 6 + len(self._gap)
            id_, com, _, *vec = [int(text[k : k + 6]) for k in range(0, self._n, step)]
            if com == 101:
                self.taken, self.pose = id_, vec
            if com == 102:
                self.joints = vec

    def until(self, condition: Callable[[], object], polls: int = 10_000) -> None:
        """Receive until a condition is true."""
        for _ in range(polls):
            if condition():
                return
            self.receive()
        raise AssertionError("not in time", self.pose, self.joints, self.taken)

    def end(self) -> None:
        """Close the connection."""
        self._socket.close()


class Bench:
    """Controller and client, on the clock of the test."""

    def __init__(self, controller: RunningController, gap: str = " ") -> None:
        self.controller = controller
        self.client = SpecificationClient(controller.port, lambda: controller.advance(0.002), gap)
        self.client.until(lambda: self.client.joints)

    def rest(self) -> None:
        """Wait until the arm is at rest and its pose has been reported."""
        assert self.controller.advance(10.0, lambda: not self.controller.arm.moving)
        for _ in range(100):
            self.client.receive()

    def press(self, press_N: int, seconds: float) -> float:
        """Send the reading less the force to press with for some time; return the force then."""
        force, torque = [0.0] * 3, [0.0] * 3
        for _ in range(round(seconds / 0.02)):
            true = self.controller.arm.true_wrench()
            force, torque = true.force_N.tolist(), true.torque_Nm.tolist()
            error = [force[0], force[1], force[2] - press_N, *torque]
            self.client.send(4, 0, [round(each) for each in error])
            for _ in range(10):
                self.client.receive()
        return force[2]

    def end(self) -> None:
        """End both."""
        self.client.end()
        self.controller.machine.tcp.close_all()


@pytest.fixture(params=["63 characters", "54 characters"])
def bench(request) -> Iterator[Bench]:
    """The shipped program, over a soft plate 3 mm below the tool."""
    spaced = request.param == "63 characters"
    text = PROGRAM.read_text(encoding="ascii")
    text = text if spaced else text.replace("  pl.w=7 ", "  pl.w=6 ")
    network = SocketNetwork(port=0)
    controller = RunningController(
        text, START, network=network, stiffness_N_m=3000.0, gap_m=0.003
    )  # fmt: skip
    made = Bench(controller, " " if spaced else "")
    yield made
    made.end()


def test_it_moves_to_a_pose_to_joint_angles_and_by_joint_rotations(bench):
    """Commands a, b, c in whole mm and degrees; the speeds of e."""
    client = bench.client
    client.send(5, 0, [100, 100, 50, 200, 0, 0])
    x, y, z, o, a, t = client.pose
    client.send(1, 0, [x + 20, y, z + 30, o, a, t])
    client.until(lambda: client.pose[:3] == [x + 20, y, z + 30])
    bench.rest()
    target = [client.joints[0] + 5, *client.joints[1:5], client.joints[5] - 12]
    client.send(2, 0, target)
    client.until(lambda: client.joints == target)
    bench.rest()
    id_ = client.send(3, 0, [-4, 0, 3, 0, 0, 7])
    client.until(lambda: client.joints == [target[0] - 4, target[1], target[2] + 3, *target[3:5],
                                           target[5] + 7])  # fmt: skip
    assert client.taken == id_


def test_it_presses_and_releases_by_force_feedback(bench):
    """Commands f, g and d: 10 N, then zero; Param 2 ends it, and a reading then moves nothing."""
    client = bench.client
    client.send(6, 0, ZERO)
    client.send(6, 1, [1, 1, 1, 0, 0, 0])
    client.send(7, 0, ZERO)
    assert bench.press(10.0, 6.0) == pytest.approx(10.0, abs=1.0)
    assert bench.press(0.0, 6.0) == pytest.approx(0.0, abs=1.0)
    client.send(7, 2, ZERO)
    bench.rest()
    q = bench.controller.arm.q
    for _ in range(20):
        client.send(4, 0, [0, 0, 10, 0, 0, 0])
        bench.rest()
    assert abs(bench.controller.arm.q - q).max() < 1e-5


@pytest.mark.parametrize("text", ["00001x", "1e0001"])
def test_wrong_characters_end_the_connection_and_the_motion(bench, text):
    """Never guess a new start: the client is disconnected, the terminal shows the packet."""
    client = bench.client
    x, y, z, o, a, t = client.pose
    client.send(1, 0, [x, y, z + 100, o, a, t])
    client.until(lambda: client.pose[2] >= z + 20)
    gap = client._gap
    client.write(gap.join(["000002", "000003", "000000", text, *5 * ["000000"]]) + gap)
    client.until(lambda: client.closed)
    assert any(f"connection closed: 000002{gap}" in line for line in bench.controller.printed)
    assert bench.controller.advance(0.5, lambda: not bench.controller.arm.moving)
    assert bench.controller.arm.T_base_flange.translation[2] * 1e3 < z + 60
    client.end()
    bench.client = SpecificationClient(bench.controller.port, client._wait, gap)
    bench.client.until(lambda: bench.client.joints)
    assert bench.client.taken == 0
