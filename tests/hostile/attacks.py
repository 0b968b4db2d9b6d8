"""Nine attacks of unauthorised clients on the bus of a running cell: none may move the arm.

python -m tests.hostile.attacks --cell FILE [--folder CERTIFICATES]

Needs a cell at rest, TLS, and the folder of `forcemesh pki init`, with whose authority it issues
a certificate for an unknown name. It moves the arm by a few degrees first, to record commands
for the replay. Exit code 1 if an attack moved the arm.
"""

import argparse
import datetime as dt
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.security.pki import (
    copy_certificate,
    make_authority,
    make_certificate,
    read_authority,
    write_pair,
)
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import MonotonicClock
from forcemesh.codec import Header, decode, encode
from forcemesh.identity import AUTHORITY, Identity, folder_of
from forcemesh.messages import Goal, Permission, RobotCommand, RobotState
from forcemesh.requests import ArmRequest, Empty, HoldRequest, MoveRequest
from forcemesh.zenoh_settings import client_settings, endpoint_of

SECONDS = 1.0  # of each attack
EVERY_S = 0.02
TRIES = 3  # to connect
MOVED_RAD = 1e-3
STOLEN_LEASE = 1_000_000
OWN_MOVE_RAD = (0.05, 0.0, 0.0, 0.0, 0.0, 0.0)
REPLY_S = 3.0
READY_S = 20.0  # of a cell that has just started


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of an attack."""

    attack: str
    let_in: bool  # whether the hub accepted the connection
    forwarded: int  # messages of the attacker that the bus forwarded
    moved_rad: float
    code: str  # under which the hub, or the cell, reports it

    @property
    def stopped(self) -> bool:
        """Return whether nothing has moved."""
        return self.moved_rad < MOVED_RAD

    def __str__(self) -> str:
        verdict, connection = (
            "ok  " if self.stopped else "FAIL",
            "let in" if self.let_in else "refused",
        )
        passed = f"{self.forwarded} messages forwarded, moved {self.moved_rad:.6f} rad"
        return f"{verdict} {self.attack}: {connection}, {passed}"


class Scene:
    """Cell at rest, observed by a monitor."""

    def __init__(self, cell: CellConfig, monitor: zenoh.Session) -> None:
        """Observe the arm and all commands to it."""
        self.commands: list[bytes] = []
        self.joints: list[tuple[float, ...]] = []
        self.challenge = 0  # of the robot, which any reader of its state can repeat
        self.key = f"{cell.cell}/{topics.ROBOT_COMMAND.key}"
        self.epoch = 2**61 + time.monotonic_ns() % 2**32  # of all forged messages
        self.forged = 0
        self._subscribers = [
            monitor.declare_subscriber(self.key, self._record_command),
            monitor.declare_subscriber(
                f"{cell.cell}/{topics.ROBOT_STATE.key}", self._record_joints
            ),
        ]

    def forge(self, number: int) -> bytes:
        """Return a well-formed command that would rotate the first joint by six degrees."""
        command = RobotCommand(
            kind="goal",
            commander="operator",
            permission=Permission(
                host="pc",
                lease=STOLEN_LEASE,
                deadline_s=0.1,
                ownership=1,
                challenge=self.challenge,
            ),
            goal=Goal(id=STOLEN_LEASE, kind="by", joint_rad=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0)),
        )
        clock, topic = MonotonicClock(), self.key
        stamp_ns = clock.now_ns()
        header = Header(
            seq=number, epoch=self.epoch, boot=clock.boot, stamp_ns=stamp_ns, topic=topic
        )
        return encode(header, command)

    def _record_command(self, sample: zenoh.Sample) -> None:
        data = sample.payload.to_bytes()
        self.commands.append(data)
        with suppress(Exception):
            header, _ = decode(data, RobotCommand, self.key)
            self.forged += header.epoch == self.epoch

    def _record_joints(self, sample: zenoh.Sample) -> None:
        _, state = decode(sample.payload.to_bytes(), RobotState)
        self.challenge = state.challenge
        if state.joint_rad:  # a gateway without a controller has none
            self.joints.append(state.joint_rad)


SendAttack = Callable[[zenoh.Session, Scene], None]


def forging(session: zenoh.Session, scene: Scene) -> None:
    """Publish a forged command repeatedly."""
    _again(lambda number: session.put(scene.key, scene.forge(number)))


def oversize(session: zenoh.Session, scene: Scene) -> None:
    """Publish an oversized message on the client's own key."""
    _again(lambda number: session.put(scene.key, scene.forge(number) + b"\0" * 32_000))


def flood(session: zenoh.Session, scene: Scene) -> None:
    """Publish forged commands at the highest rate."""
    give_up_s, number = time.monotonic() + SECONDS, 0
    while time.monotonic() < give_up_s:
        number += 1
        session.put(scene.key, scene.forge(number))
        if number % 100 == 0:
            time.sleep(0.001)


def replay(session: zenoh.Session, scene: Scene) -> None:
    """Replay the recorded commands in order, at ten times their rate."""
    forwarded = list(scene.commands)
    for data in forwarded:
        session.put(scene.key, data)
        time.sleep(EVERY_S / 50)


class Attack(NamedTuple):
    """Presented certificate, messages, and code of the hub."""

    name: str
    shown: str
    send: SendAttack
    code: str


ATTACKS = (
    Attack("no certificate", "none", forging, "no_certificate"),
    Attack("foreign authority", "foreign", forging, "foreign_certificate"),
    Attack("unknown name", "unknown", forging, "unknown_name"),
    Attack("right name, forbidden key", "regulator", forging, "forbidden"),
    Attack("oversize", "arbiter", oversize, "too_long"),
    Attack("flood", "monitor", flood, "forbidden"),
    Attack("plain TCP", "plain", forging, "not_encrypted"),
    Attack("replay, with the arbiter's stolen key", "arbiter", replay, ""),
    Attack("second writer of the arbiter's key", "wrench", forging, "forbidden"),
)


def attack_all(cell: CellConfig, folder: Path) -> Iterator[Outcome]:
    """Try every attack on a running cell, one after the other."""
    endpoint = endpoint_of(cell)
    with tempfile.TemporaryDirectory() as scratch:
        unknown, foreign = Path(scratch, "unknown"), Path(scratch, "foreign")
        _make_attack_certificates(cell, folder, unknown, foreign)
        who = {"unknown": Identity("unknown", unknown), "foreign": Identity("arbiter", foreign)}
        watching = client_settings(endpoint, "monitor", Identity("monitor", folder).settings())
        with _session(watching) as monitor:
            scene = Scene(cell, monitor)
            with open_bus(cell, topics.CLIENT) as bus:
                _move_a_little(bus, scene)
            for attack in ATTACKS:
                identity = who.get(attack.shown, Identity(attack.shown, folder))
                yield _attack(attack, _settings(attack.shown, identity, endpoint), scene)


def _attack(attack: Attack, settings: dict[str, object], scene: Scene) -> Outcome:
    scene.joints.clear()
    forged = scene.forged
    commands = len(scene.commands)
    let_in = True
    try:
        with _session(settings) as session:
            attack.send(session, scene)
    except zenoh.ZError:
        let_in = False
        time.sleep(EVERY_S)
    time.sleep(0.3)  # for delayed messages
    forwarded = scene.forged - forged
    del scene.commands[commands:]
    moved = max((math.dist(joints, scene.joints[0]) for joints in scene.joints), default=math.inf)
    return Outcome(attack.name, let_in, forwarded, moved, attack.code)


def _settings(shown: str, identity: Identity, endpoint: str) -> dict[str, object]:
    if shown == "plain":
        return client_settings(f"tcp/{endpoint.partition('/')[2]}", shown, {})
    if shown == "none":
        security = {"root_ca_certificate": str(identity.authority)}
        return client_settings(endpoint, shown, security)
    return client_settings(endpoint, shown, identity.settings())


def _make_attack_certificates(cell: CellConfig, folder: Path, unknown: Path, foreign: Path) -> None:
    """Issue a certificate for an unknown name, and an arbiter's by another authority."""
    now, hosts = dt.datetime.now(dt.UTC), ["localhost"]
    ours, theirs = read_authority(folder), make_authority("elsewhere", now)
    for authority, name, target in ((ours, "unknown", unknown), (theirs, "arbiter", foreign)):
        pair = make_certificate(authority, name, cell.cell, hosts=hosts, days=1, now=now)
        write_pair(target, name, pair, owner=None)
        copy_certificate(folder, target, AUTHORITY, owner=None)


def _move_a_little(bus: Bus, scene: Scene) -> None:
    """Move the arm once, as an operator does, to record commands for the replay."""
    requests: list[tuple[Any, Any]] = [
        (topics.HOLD, HoldRequest(reason="before the attacks")),
        (topics.CLEAR, Empty()),
        (topics.ARM, ArmRequest(purpose="jog")),
        (topics.MOVE, MoveRequest(kind="by", joint_rad=OWN_MOVE_RAD)),
    ]
    for request, message in requests:
        give_up_s = time.monotonic() + READY_S
        while (reply := bus.ask(request, message, REPLY_S)).code == "not_ready":
            if time.monotonic() > give_up_s:
                break
            time.sleep(0.2)
        if not reply.accepted:
            sys.exit(f"{request.key} was refused ({reply.code}): {reply.text}")
        time.sleep(0.2)
    time.sleep(2.0)
    bus.ask(topics.HOLD, HoldRequest(reason="the attacks begin"), REPLY_S)
    if not any(_permits(data) for data in scene.commands):
        sys.exit("no command with a permission was received: nothing to replay")
    time.sleep(0.5)


def _permits(data: bytes) -> bool:
    return decode(data, RobotCommand)[1].permission is not None


def _again(send: Callable[[int], object]) -> None:
    give_up_s, number = time.monotonic() + SECONDS, 0
    while time.monotonic() < give_up_s:
        number += 1
        send(number)
        time.sleep(EVERY_S)


def _opened(config: zenoh.Config, tries: int) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        if tries == 1:
            raise
        return _opened(config, tries - 1)  # may fail on a busy machine


@contextmanager
def _session(settings: dict[str, object]) -> Iterator[zenoh.Session]:
    session = _opened(zenoh.Config.from_json5(json.dumps(settings)), TRIES)
    try:
        yield session
    finally:
        with suppress(zenoh.ZError):
            session.close()


def main() -> int:
    """Try all attacks, print the results."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.attacks", description=__doc__)
    parser.add_argument("--cell", required=True)
    parser.add_argument("--folder", type=Path)
    given = parser.parse_args()
    cell = load_cell(given.cell)
    wrong = 0
    for outcome in attack_all(cell, given.folder or folder_of(cell)):
        wrong += not outcome.stopped
        print(outcome, flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
