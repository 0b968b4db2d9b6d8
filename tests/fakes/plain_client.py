"""A client of plain.as with scales, over a real socket; it may send any bytes."""

import socket
from typing import Any

import numpy as np
import pinocchio as pin

from common.motion.frames import oat_from_R
from controller.packet import ZERO_VEC, Packet, VecInt
from controller.packet_table import Com
from controller.plain import Controller, PlainReader, PlainSection, encode, program
from sim.controller.behaviour import Behaviour
from tests.fakes.plain_controller import QUICK, PlainController

POLL_S = 0.002
SAMPLE_S = 0.02


class PlainClient:
    """A controller, and one client with the scales of its pl.config."""

    def __init__(
        self, plain: PlainSection, *, text: str = "", behaviour: Behaviour = QUICK, **sim: Any
    ) -> None:
        """Start both; the tool is 160 mm long. `text` is the program instead of the cell's."""
        self.plain = plain
        text = text or program(plain, Controller(centre_mm=(0.0, 0.0, 160.0)))
        self.controller = PlainController(text, behaviour, **sim)
        self.dial()
        self.advance(0.1)

    def dial(self) -> None:
        """Connect."""
        self.reports: list[Packet] = []
        self.id, self.closed = 0, False
        self._reader = PlainReader(self.plain.packet_chars)
        self._socket = socket.create_connection(("127.0.0.1", self.controller.port))
        self._socket.setblocking(False)

    def hang_up(self) -> None:
        """Close the connection."""
        self._socket.close()
        self.closed = True

    def close(self) -> None:
        """End both."""
        self.hang_up()
        self.controller.close()

    # --- time -------------------------------------------------------------------------------------

    def advance(self, duration_s: float) -> None:
        """Advance the controller, and receive."""
        for _ in range(round(duration_s / POLL_S)):
            self.controller.advance(POLL_S)
            self._receive()

    def _receive(self) -> None:
        if self.closed:
            return
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return
        except ConnectionResetError:
            data = b""
        if data:
            self.reports += self._reader.feed(data)
        else:
            self.hang_up()

    def until(self, condition: Any, within_s: float = 10.0) -> None:
        """Advance until a condition is true."""
        for _ in range(round(within_s / POLL_S)):
            if condition():
                return
            self.advance(POLL_S)
        raise AssertionError(f"not in {within_s} s: {self.controller.machine.stops}")

    def until_closed(self) -> None:
        """Wait until the controller has closed the connection."""
        self.until(lambda: self.closed)

    # --- commands and reports ---------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        """Send any bytes."""
        self._socket.sendall(data)

    def send(self, com: int, param: int = 0, vec: VecInt = ZERO_VEC) -> int:
        """Send a command; return its ID."""
        self.id += 1
        self.write(encode(Packet(self.id, com, param, vec), self.plain.packet_chars))
        return self.id

    def do(self, com: int, param: int = 0, vec: VecInt = ZERO_VEC) -> None:
        """Send a command and wait until it is taken."""
        id_ = self.send(com, param, vec)
        self.until(lambda: self.reports and self.last(Com.POSE).id == id_)

    def last(self, com: Com) -> Packet:
        """Return the newest report of a kind."""
        return next(packet for packet in reversed(self.reports) if packet.com == com)

    def height_mm(self) -> float:
        """True height of the flange."""
        return float(self.controller.arm.T_base_flange.translation[2] * 1e3)

    def shifted(self, z: float, turn_deg: float = 0.0) -> VecInt:
        """Return the present pose, shifted and turned along z [mm, deg], as six numbers."""
        T = self.controller.arm.T_base_flange
        R = pin.utils.rotate("z", np.radians(turn_deg)) @ T.rotation
        position = (T.translation * 1e3 + np.array([0.0, 0.0, z])) * self.plain.position_per_mm
        oat = np.degrees(oat_from_R(R)) * self.plain.oat_per_deg
        x, y, up, o, a, t = (round(float(value)) for value in (*position, *oat))
        return (x, y, up, o, a, t)

    def fastest(self) -> tuple[float, float]:
        """Advance until the arm rests; return the highest speeds of the flange [mm/s, deg/s]."""
        arm, line, turn = self.controller.arm, 0.0, 0.0
        self.until(lambda: arm.moving)
        while arm.moving:
            before = arm.T_base_flange
            self.advance(POLL_S)
            motion = before.actInv(arm.T_base_flange)
            line = max(line, float(np.linalg.norm(motion.translation)) * 1e3 / POLL_S)
            turned = np.degrees(np.linalg.norm(pin.log3(motion.rotation)))
            turn = max(turn, float(turned) / POLL_S)
        return line, turn

    def press(self, force_N: float, duration_s: float) -> None:
        """Send the reading less a force to press with, along z, for some time."""
        for _ in range(round(duration_s / SAMPLE_S)):
            force, torque = self.controller.wrench()
            error = [force[0], force[1], force[2] - force_N]
            units = [round(each * self.plain.force_per_N) for each in error]
            units += [round(each * self.plain.torque_per_Nm) for each in torque]
            a, b, c, d, e, f = units
            self.send(Com.WRENCH, 0, (a, b, c, d, e, f))
            self.advance(SAMPLE_S)
