"""Hostile external client that uses only Zenoh and MessagePack, without importing forcemesh.

It sends hostile requests and messages to a running cell, first while the arm is armed, then while
it is held, and requests holds repeatedly.
"""

import json
import math
import random
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from operator import sub
from typing import Any

import msgpack
import zenoh

ROLES = ("hub", "robot", "sensor", "wrench", "regulator", "arbiter")
PATIENCE_S = 90.0  # of a loaded machine
MOVED_RAD = 1e-3
SPEED_M_S = 0.6  # no demo moves so fast; its limit is 0.25 m/s
HOLD_S = 5.0  # until a hold must be reported, on a loaded machine
ROUND = 100  # attacks between two tries of hold
PLAYED_BOOT = "another boot"  # of a recording that is played back (playback.py)

LATE_SHARE = 0.1
ALWAYS = {"request/hold", "request/force/stop"}  # executed at any age
OWNED = ("request/force/start", "request/force/gains", "request/force/path")  # only by its owner
ENDING = {"request/hold"}  # would end the armed state under attack
POSE = {"position_m": (0.0, 0.5, 0.4), "orientation_xyzw": (1.0, 0.0, 0.0, 0.0)}
ANGLES = (0.0, 0.02, 0.0, 0.0, 0.0, 0.0)
GAIN = (1e-6, 1e-6, 1e-6)
REQUESTS: dict[str, dict[str, Any]] = {
    "request/arm": {"purpose": "all"},
    "request/hold": {"reason": "stop"},
    "request/clear": {},
    "request/move": {"kind": "pose", "pose": POSE, "joint_rad": ANGLES, "speed_m_s": 0.02},
    "request/speed": {"accel_fraction": 0.5, "mechanical_m_s": 0.05, "modular_fraction": 1.0},
    "request/force/start": {"mode": "position", "setpoint_N": 5.0, "law": "plain", "host": "pc"},
    "request/force/stop": {},
    "request/force/gains": {"force_p_m_per_N": GAIN, "torque_i_rad_per_Nms": GAIN},
    "request/force/path": {"points_m": ((0.0, 0.5, 0.3),), "speed_m_s": 0.01, "append": True},
    "request/tare": {},
    "request/calibration": {"calibration_json": "{}"},
    "request/record/start": {"label": "x", "past": False},
    "request/record/stop": {},
}
NUMBERS = (
    0.0, -0.0, 5e-324, 1.0, -1.0, 1e6, -1e6, 1e200, -1e200, 1e308, -1e308, math.inf, -math.inf,
    math.nan, 0, -1, 2**31, 2**63, 2**64 - 1, -(2**63),
)  # fmt: skip
ODD: tuple[Any, ...] = (
    *NUMBERS, None, True, "", "x" * 501, "x" * 5000, "\0", "../..", b"", b"\xff" * 40, (), {},
    (0.0,) * 70, {"kind": "pose"},
)  # fmt: skip
JUNK = (b"", b"\xc1", b"\x80", b"\x93\x01\x02\x03", b"\x91" * 3000, b"\xdf\xff\xff\xff\xff",
        b"\xdd\xff\xff\xff\xff", b"\xa5ab", b"\0" * 16_000, b"\0" * 100_000)  # fmt: skip


def change(value: Any, rng: random.Random) -> Any:
    """Return a value with one part of it replaced by an odd one."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        name = rng.choice(sorted(value))
        return {**value, name: change(value[name], rng)}
    if isinstance(value, tuple) and value and rng.random() < 0.8:
        at = rng.randrange(len(value))
        return (*value[:at], change(value[at], rng), *value[at + 1 :])
    return rng.choice(ODD)


def corrupted(fields: dict[str, Any], cell: str, key: str, rng: random.Random) -> bytes:
    """Return a request or message with one or several errors."""
    chance = rng.random()
    if chance < 0.1:
        return rng.choice(JUNK)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        changed = change(fields, rng)
        fields = changed if isinstance(changed, dict) else {**fields, "": changed}
    if chance < 0.3:
        fields = {**fields, "v": rng.choice((0, 1, 2, 3, -1, "2", None))}
    if chance < 0.4:
        fields = {**fields, "topic": rng.choice((key, f"other/{key}", f"{cell}/{key}", "", 7))}
    try:
        data = bytes(msgpack.packb(fields))
    except (ValueError, OverflowError):
        return b"\xc1"
    return data[: rng.randrange(len(data))] if chance > 0.95 else data


class HostileClient:
    """Client that receives all topics of a cell, and publishes hostile messages."""

    def __init__(self, session: zenoh.Session, cell: str, seed: int) -> None:
        """Subscribe to all topics."""
        self.session, self.cell = session, cell
        self.rng = random.Random(seed)
        self.newest: dict[str, dict[str, Any]] = {}
        self.received_s: dict[str, float] = {}
        self.fastest_m_s, self.late_executed = 0.0, 0
        self.owned, self.taken_over = 0, 0  # force control of a client, and by another one
        self.replies: Counter[str] = Counter()
        self.record: Callable[[str, dict[str, Any]], None] | None = None  # of every message
        self._lock = threading.Lock()
        self._epochs: set[int] = set()  # of the cell's own publishers: all others are ours
        self._own = True
        self._subscriber = session.declare_subscriber(f"{cell}/**", self._receive)

    def _receive(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).partition("/")[2]
        try:
            fields = msgpack.unpackb(sample.payload.to_bytes())
        except (ValueError, msgpack.UnpackException):
            return
        if not isinstance(fields, dict) or not isinstance(fields.get("epoch"), int):
            return
        if fields["boot"] == PLAYED_BOOT:
            return
        with self._lock:
            if self.record is not None:
                self.record(str(sample.key_expr), fields)
            if self._own:
                self._epochs.add(fields["epoch"])
            elif fields["epoch"] not in self._epochs:
                return
            if key == "robot/state":
                self._check_speed(self.newest.get(key), fields)
            self.newest[key], self.received_s[key] = fields, time.monotonic()

    def _check_speed(self, before: dict[str, Any] | None, now: dict[str, Any]) -> None:
        if before is None or now["stamp_ns"] - before["stamp_ns"] < 3_000_000:
            return  # steps that were delayed in transit are not fast
        travel_m = math.dist(before["position_m"], now["position_m"])
        speed_m_s = travel_m / ((now["stamp_ns"] - before["stamp_ns"]) * 1e-9)
        self.fastest_m_s = max(self.fastest_m_s, speed_m_s)

    def ready(self) -> dict[str, int]:
        """Wait for the health of every process; return their process ids."""
        self.until_received({f"{role}/health" for role in ROLES} | {"robot/state"})
        self.until_received({"arbiter/status"})
        self._own = False
        return {role: self.newest[f"{role}/health"]["pid"] for role in ROLES}

    def until_received(self, expected: set[str]) -> None:
        """Wait for a message of each topic."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not expected <= set(self.newest):
            if time.monotonic() > give_up_s:
                raise TimeoutError(f"never received: {sorted(expected - set(self.newest))}")
            time.sleep(0.1)

    def ask(self, key: str, data: bytes, timeout_s: float = 0.5) -> dict[str, Any] | None:
        """Send a request, again while no server is found (after a reconnect); return the reply."""
        give_up_s = time.monotonic() + timeout_s
        while (left_s := give_up_s - time.monotonic()) > 0.0:
            replies = list(self.session.get(f"{self.cell}/{key}", payload=data, timeout=left_s))
            for reply in replies:
                if reply.ok is not None:
                    fields = msgpack.unpackb(reply.ok.payload.to_bytes())
                    self.replies[str(fields["code"])] += 1
                    return dict(fields)
            if replies:
                break
            time.sleep(0.02)
        self.replies["no answer"] += 1
        return None

    def attack(self, *, forge: bool) -> None:
        """Send one hostile request or message; forged ones may resemble those of a publisher."""
        if self.rng.random() < LATE_SHARE:
            self._late()
            return
        if self.rng.random() < 0.5:
            self._message(forge=forge)
            return
        key = self.rng.choice(sorted(REQUESTS if forge else REQUESTS.keys() - ENDING))
        data = corrupted(REQUESTS[key], self.cell, key, self.rng)
        if key == "request/arm":  # a valid one would correctly be accepted
            data = corrupted({"purpose": "none"}, self.cell, key, self.rng)
        self.ask(key, data, 0.3)

    def _late(self) -> None:
        """Send a request that its client no longer waits for; count it if it is executed."""
        key = self.rng.choice(sorted(REQUESTS.keys() - ALWAYS))
        sent = {"boot": self.newest["arbiter/status"]["boot"], "wait_s": 2.0}
        sent["stamp_ns"] = time.monotonic_ns() - 3_000_000_000
        reply = self.ask(key, bytes(msgpack.packb({**REQUESTS[key], **sent})), 0.3)
        self.late_executed += bool(reply and reply["accepted"])

    def two_clients(self) -> None:
        """Start force control as one client; count what another one may change."""
        start = {**REQUESTS["request/force/start"], "client": "first"}
        reply = self.ask("request/force/start", bytes(msgpack.packb(start)), HOLD_S)
        if reply and reply["accepted"]:
            self.owned += 1
            for key in OWNED:
                other = bytes(msgpack.packb({**REQUESTS[key], "client": "second"}))
                reply = self.ask(key, other, HOLD_S)
                self.taken_over += not reply or reply["code"] != "busy"
        self.ask("request/force/stop", b"\x80", HOLD_S)

    def _message(self, *, forge: bool) -> None:
        """Publish on a topic of another publisher; unless forged, no reader can accept it."""
        key = self.rng.choice(sorted(self.newest))
        fields = {**self.newest[key], "epoch": self.rng.choice((1, 2, 2**62))}
        if not forge:
            fields["topic"] = f"other/{key}"
        data = corrupted(fields, self.cell, key, self.rng)
        if not forge and len(data) > 4 and f"{self.cell}/{key}".encode() in data:
            data = data[:-1]
        self.session.put(f"{self.cell}/{key}", data)

    def hold_works(self) -> bool:
        """Send a malformed hold request; return whether the arm is held soon after."""
        bad = (b"", b"\xc1", msgpack.packb({"v": 9}), msgpack.packb({"reason": "x" * 5000}))
        reply = None
        give_up_s = time.monotonic() + HOLD_S
        while reply is None and time.monotonic() < give_up_s:
            reply = self.ask("request/hold", bytes(self.rng.choice(bad)), HOLD_S)
        since_s = time.monotonic()
        held = False
        while not held and time.monotonic() < give_up_s + HOLD_S:
            is_new = self.received_s["robot/command"] > since_s
            held = is_new and self.newest["robot/command"]["permission"] is None
            time.sleep(0.01)
        if reply is None or not reply["accepted"] or not held:
            state = self.newest["arbiter/status"]["state"]
            print(f"hold: answered {reply}, held {held}, {state}", file=sys.stderr)
            return False
        return True

    def armed(self) -> bool:
        """Clear, tare and arm, as an operator does; return whether the arm is armed."""
        give_up_s = time.monotonic() + 2 * HOLD_S
        while not (armed := self._armed()) and time.monotonic() < give_up_s:
            time.sleep(0.5)
        return armed

    def _armed(self) -> bool:
        reply = None
        for key in ("request/hold", "request/clear", "request/tare", "request/arm"):
            time.sleep(0.05)
            reply = self.ask(key, b"\x80", HOLD_S)
        return bool(reply and reply["accepted"])

    def joints(self) -> tuple[float, ...]:
        """Return the last published joint angles of the robot [rad]."""
        return tuple(self.newest["robot/state"]["joint_rad"])


def while_armed(outsider: HostileClient, count: int) -> tuple[list[bool], int]:
    """Attack an arm that may move; return results of the holds, and the times it was armed."""
    holds, armed = [], 0
    for number in range(count):
        if number % ROUND == 0:
            time.sleep(1.5)  # until the inputs have been valid for a second
            armed += outsider.armed()
            outsider.two_clients()
        outsider.attack(forge=False)
        if number % ROUND == ROUND - 1:
            holds.append(outsider.hold_works())
    return holds, armed


def while_held(outsider: HostileClient, count: int) -> tuple[list[bool], float]:
    """Attack an arm that must not move; return results of the holds, and the joint motion."""
    holds, moved_rad = [outsider.hold_works()], 0.0
    time.sleep(1.0)  # until it is at rest
    rest = outsider.joints()
    for number in range(count):
        outsider.attack(forge=True)
        if number % ROUND == ROUND - 1:
            holds.append(outsider.hold_works())
        moved_rad = max(moved_rad, *map(abs, map(sub, outsider.joints(), rest)))
    return holds, moved_rad


def attack_cell(outsider: HostileClient, count: int) -> dict[str, Any]:
    """Send `count` hostile requests and messages; return the results."""
    pids = outsider.ready()
    holds, armed = while_armed(outsider, count // 2)
    more, moved_rad = while_held(outsider, count - count // 2)
    holds += more
    time.sleep(3.0)
    holds.append(outsider.hold_works())
    now_s = time.monotonic()
    silent = [r for r in ROLES if now_s - outsider.received_s[f"{r}/health"] > 3.0]
    other = [r for r in ROLES if outsider.newest[f"{r}/health"]["pid"] != pids[r]]
    broken = [r for r in ROLES if outsider.newest[f"{r}/health"]["code"] == "internal"]
    return {
        "sent": count,
        "processes_ended": sorted({*silent, *other}),
        "unforeseen_errors": broken,
        "moved_while_held_rad": moved_rad,
        "times_armed": armed,
        "fastest_m_s": outsider.fastest_m_s,
        "late_executed": outsider.late_executed,
        "force_owned": outsider.owned,
        "force_taken_over": outsider.taken_over,
        "holds": len(holds),
        "holds_that_worked": sum(holds),
        "replies": dict(outsider.replies),
    }


def is_unaffected(found: dict[str, Any]) -> bool:
    """Return whether the attacks had no effect."""
    return bool(
        not found["processes_ended"]
        and not found["unforeseen_errors"]
        and found["moved_while_held_rad"] < MOVED_RAD
        and found["fastest_m_s"] < SPEED_M_S
        and found["late_executed"] == 0
        and found["times_armed"] > 0
        and found["force_owned"] > 0
        and found["force_taken_over"] == 0
        and found["holds_that_worked"] == found["holds"]
    )


def connected(endpoint: str) -> zenoh.Session:
    """Return a session on a hub."""
    config = {
        "mode": "client",
        "connect": {
            "endpoints": [endpoint],
            "timeout_ms": round(1e3 * PATIENCE_S),
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        },
        "scouting": {"multicast": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
