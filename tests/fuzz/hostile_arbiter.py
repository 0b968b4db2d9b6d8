"""Hostile arbiter: authorised publisher of validly encoded random commands, from a seed.

It reads `robot/state`, so its poses start at the pose of the arm. It follows a pattern for a while
(run, spin, jump, shake, approach a limit, restart repeatedly), and alternates it with noise.
"""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from forcemesh.codec import SCHEMA_VERSION
from forcemesh.messages import RobotState
from forcemesh.topics import ROBOT_COMMAND

MOMENTS_MS = (0, 0, 0, 1, 1, 2, 4, 4, 4, 4, 8)
PURPOSES = ("all", "all", "all", "jog", "back_off")
PLANS = ("run", "spin", "jump", "shake", "edge", "anew", "goals", "feedback", "noise")
ODD = (float("nan"), float("inf"), -1e308, 1e308, 1e9, -5.0, 0.0, 5.0)
PATIENCE = 60
Fields = dict[str, Any]


@dataclass(slots=True)
class TimedMessage:
    """One message, and the delay to the next one."""

    data: bytes
    kind: str
    permitted: bool
    pause_ms: int


class HostileArbiter:
    """Generator of hostile messages."""

    def __init__(
        self, seed: int, cell: str, boot: str, *, speed_m_s: float, speed_rad_s: float
    ) -> None:
        """Prepare for a cell; the speeds are the limits to exceed."""
        self._address = f"{cell}/{ROBOT_COMMAND.key}"
        self._rng = random.Random(seed)
        self._boot, self._speed_m_s, self._speed_rad_s = boot, speed_m_s, speed_rad_s
        self._seq, self._epoch, self._lease, self._goal = 0, seed * 1000 + 1, 1, 0
        self._plan, self._left = "run", 0
        self._p = np.array([0.0, 0.475, 0.377])
        self._q = np.array([1.0, 0.0, 0.0, 0.0])
        self._direction = np.zeros(3)
        self._factor = 1.0
        self._noisy = False
        self._held = 0  # consecutive messages that caused a hold

    def next_message(self, now_ns: int, state: RobotState | None) -> TimedMessage:
        """Return the next message."""
        rng = self._rng
        if self._left <= 0:
            self._plan, self._left = rng.choice(PLANS), rng.randint(20, 400)
            self._factor = rng.choice((0.3, 0.9, 1.0, 1.0, 1.2, 1.5, 3.0, 30.0))
            self._noisy = rng.random() < 0.5  # without noise more commands are accepted
            self._aim(state)
        self._left -= 1
        self._held = self._held + 1 if state is not None and state.hold_reason else 0
        if self._held > PATIENCE:  # it is ignored from now on: restart as a new process
            self._epoch, self._seq, self._lease, self._held = rng.randrange(2**62), 0, 1, 0
        if self._seldom(0.002) or (state is not None and state.hold_reason and rng.random() < 0.2):
            self._lease += 1
            self._aim(state)
        pause_ms = 0 if self._plan == "anew" and rng.random() < 0.8 else rng.choice(MOMENTS_MS)
        if self._seldom(0.004):
            pause_ms = rng.choice((30, 90, 150, 400))
        fields = self._header(now_ns) | self._content(state, max(1, pause_ms) * 1e-3)
        if self._seldom(0.005):
            self._spoil(fields)
        permitted = fields.get("permission") is not None
        try:
            data = msgpack.packb(fields)
        except (OverflowError, ValueError):
            data = b"\xc1"
        if self._seldom(0.005):
            data = data[: rng.randrange(len(data))]
        return TimedMessage(data, str(fields.get("kind")), permitted, pause_ms)

    def _seldom(self, chance: float) -> bool:
        return self._noisy and self._rng.random() < chance

    def _aim(self, state: RobotState | None) -> None:
        if state is not None and self._rng.random() < 0.9:
            self._p, self._q = np.array(state.position_m), np.array(state.orientation_xyzw)
        direction = np.array([self._rng.gauss(0.0, 1.0) for _ in range(3)])
        self._direction = direction / max(float(np.linalg.norm(direction)), 1e-9)

    def _header(self, now_ns: int) -> Fields:
        rng, chance = self._rng, self._rng.random() if self._noisy else 1.0
        self._seq += 1
        seq, stamp_ns = self._seq, now_ns
        if chance < 0.003:
            seq = rng.choice((0, -1, 1, self._seq - 1, self._seq - 50, self._seq + 3, 2**62))
        elif chance < 0.0034:
            self._epoch, self._seq = rng.randrange(2**62), rng.choice((0, 1, 10**6))
            seq = self._seq
        elif chance < 0.006:
            stamp_ns = now_ns + rng.choice((-(10**9), -50_000_000, 10**9, 10**18))
        return {
            "v": SCHEMA_VERSION,
            "topic": self._address,
            "seq": seq,
            "epoch": self._epoch,
            "boot": self._boot,
            "stamp_ns": stamp_ns,
            "sensor_stamp_ns": None,
            "sensor_seq": None,
            "valid": not self._seldom(0.002),
        }

    def _content(self, state: RobotState | None, dt_s: float) -> Fields:
        rng = self._rng
        if self._seldom(0.005):
            return {"kind": rng.choice(("hold", "idle")), "permission": None}
        host = "controller" if self._plan == "feedback" or self._seldom(0.05) else "pc"
        permission = {
            "host": host,
            "lease": self._lease + (rng.randrange(-5, 9) if self._seldom(0.004) else 0),
            "deadline_s": rng.choice((0.1, 0.1, 3600.0, 1e9, 1e300)),
            "ownership": rng.choice((1, -1, 2**31)) if self._seldom(0.01) else 0,
            # For a whole lease: a back-off lease has other limits.
            "purpose": random.Random(self._lease).choice(PURPOSES),
            # Read from the robot, as an authorised publisher can.
            "challenge": 0 if state is None or self._seldom(0.002) else state.challenge,
        }
        if self._seldom(0.005):
            permission["deadline_s"] = rng.choice((1e-3, -1.0, 0.0))
        common: Fields = {"permission": permission, "commander": "operator", "speed": self._speed()}
        kinds = {"goals": self._goals, "feedback": self._feedback, "noise": self._noise}
        make: Callable[[RobotState | None, float], Fields] = kinds.get(self._plan, self._setpoint)
        if self._seldom(0.02):
            make = self._noise
        if self._plan == "anew" and rng.random() < 0.5:
            self._lease += 1
            permission["lease"] = self._lease
            self._aim(state)
        return common | make(state, dt_s)

    def _speed(self) -> Fields:
        rng = self._rng
        return {
            "accel_fraction": rng.choice((1.0, 1.0, 0.5)),
            "decel_fraction": rng.choice((1.0, 0.01)),
            "modular_fraction": rng.choice((1.0, 0.5, 1e-6)),
            "mechanical_m_s": self._speed_m_s * rng.choice((1.0, 1.0, 1.0, 0.5, 1.01, 2.0, 20.0)),
        }

    def _setpoint(self, _state: RobotState | None, dt_s: float) -> Fields:
        rng, step_m = self._rng, self._factor * self._speed_m_s * dt_s
        if self._plan == "spin":
            self._q = _turned(self._q, self._direction * self._factor * self._speed_rad_s * dt_s)
        elif self._plan == "jump":
            if rng.random() < 0.05:
                self._p = self._p + self._direction * rng.choice(
                    (0.005, 0.012, 0.019, 0.021, 0.1, 1.0)
                )
        elif self._plan == "shake":
            if rng.random() < 0.2:
                self._direction = -self._direction
            self._p = self._p + self._direction * step_m
        elif self._plan == "anew":
            offset = self._direction * rng.uniform(0.0, 0.02)
            return {"kind": "setpoint", "pose": _pose(self._p + offset, self._q)}
        else:
            self._p = self._p + self._direction * step_m
        return {"kind": "setpoint", "pose": _pose(self._p, self._q)}

    def _goals(self, state: RobotState | None, _dt_s: float) -> Fields:
        rng = self._rng
        if rng.random() < 0.03:
            self._goal = rng.choice((self._goal + 1, self._goal + 1, -3, 0, 2**40))
        if rng.random() < 0.05:
            self._left -= 20
            return {"kind": "idle"}
        kind = ("pose", "joints", "by")[self._goal % 3]
        again = random.Random(self._goal)  # the same goal under the same id, mostly
        far = again.choice((0.01, 0.05, 0.3, 3.0))
        goal: Fields = {"id": self._goal, "kind": kind, "pose": None, "joint_rad": None}
        if kind == "pose":
            direction = np.array([again.gauss(0.0, far) for _ in range(3)])
            q = _turned(self._q, np.array([again.gauss(0.0, far) for _ in range(3)]))
            goal["pose"] = _pose(self._p + direction, q)
        else:
            joints = np.array([again.gauss(0.0, far) for _ in range(6)])
            if kind == "joints" and state is not None:
                joints = joints + np.array(state.joint_rad)
            goal["joint_rad"] = joints.tolist()
        return {"kind": "goal", "goal": goal}

    def _feedback(self, _state: RobotState | None, _dt_s: float) -> Fields:
        rng = self._rng
        wild = rng.choice((1e-6, 1e-5, 1e-3, 1.0, 1e6))
        names = ("force_p_m_per_N", "force_i_m_per_Ns", "torque_p_rad_per_Nm")
        gains = {name: [wild * rng.random() for _ in range(3)] for name in names}
        far = rng.choice((0.0, 0.01, 0.1, 1.0, 30.0))
        press_N = rng.choice((0.0, 5.0, 30.0, 100.0, 1e4))
        mode = rng.choice(("position", "orientation", "both")) if rng.random() < 0.1 else "both"
        return {
            "kind": "feedback",
            "feedback": {
                "mode": mode,
                "setpoint_force_N": [rng.gauss(0.0, press_N) for _ in range(3)],
                "lever_m": [rng.gauss(0.0, far) for _ in range(3)],
                "gains": gains,
            },
        }

    def _noise(self, state: RobotState | None, dt_s: float) -> Fields:
        rng = self._rng
        kind = rng.choice(("setpoint", "goal", "feedback", "idle", "hold"))
        makers = {"goal": self._goals, "feedback": self._feedback}
        if kind in makers:
            return makers[kind](state, dt_s)
        p = self._p + np.array([rng.gauss(0.0, rng.choice((1e-3, 0.1, 10.0))) for _ in range(3)])
        q = np.array([rng.gauss(0.0, 1.0) for _ in range(4)]) * rng.choice((1.0, 1e-200, 1e200))
        return {"kind": kind, "pose": _pose(p, q)}

    def _spoil(self, fields: Fields) -> None:
        """Replace one field by an unusual number, or remove it."""
        rng, inner = self._rng, fields
        for _ in range(3):
            key = rng.choice(list(inner))
            if isinstance(inner[key], dict) and inner[key]:
                inner = inner[key]
                continue
            if isinstance(inner[key], list):
                inner[key][rng.randrange(len(inner[key]))] = rng.choice(ODD)
            else:
                inner[key] = rng.choice((*ODD, None, True, "x"))
            return


def _pose(p: np.ndarray, q: np.ndarray) -> Fields:
    return {"position_m": p.tolist(), "orientation_xyzw": q.tolist()}


def _turned(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Rotate a quaternion x, y, z, w about the base axes by a small rotation vector."""
    angle = float(np.linalg.norm(w))
    if angle < 1e-12:
        return q
    s = math.sin(0.5 * angle) / angle
    a, b = np.append(w * s, math.cos(0.5 * angle)), q
    x, y, z = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([x, y, z, a[3] * b[3] - a[:3] @ b[:3]])
