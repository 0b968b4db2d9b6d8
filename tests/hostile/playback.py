"""Playback of a whole recording: no command of a life that is over moves an arm.

Every message of a simulated cell that is armed and moves is recorded, and played back on its own
keys and under another boot, so that the age of its messages counts from their receipt: into another
start of the cell, armed, and to a robot that has known no arbiter.
"""

import sys
import time
from collections import Counter
from collections.abc import Callable
from operator import sub
from pathlib import Path
from typing import Any

import msgpack

from common.config.cell import CellConfig
from tests.hostile.client import (
    HOLD_S,
    MOVED_RAD,
    PATIENCE_S,
    PLAYED_BOOT,
    ROLES,
    HostileClient,
)
from tests.hostile.target import client_of

MOVE = {"kind": "by", "joint_rad": (0.05, 0.0, 0.0, 0.0, 0.0, 0.0)}
MOVES_S = 2.0
GOOD_S = 1.5  # until the inputs have been valid for a second
Recording = list[tuple[float, str, dict[str, Any]]]  # time [s], key, fields


def recorded_job(client: HostileClient) -> Recording:
    """Arm and move the arm as an operator does; return every message of the cell."""
    client.until_received({f"{role}/health" for role in ROLES})
    time.sleep(GOOD_S)
    recording: Recording = []
    client.record = lambda key, fields: recording.append((time.monotonic(), key, fields))
    if not in_time(lambda: client.armed() and moves(client)):
        sys.exit(f"nothing to play back: the arm did not move, replies {dict(client.replies)}")
    time.sleep(MOVES_S)
    if not in_time(client.hold_works):
        sys.exit("nothing to play back: the arm was not held")
    client.record = None
    return recording


def moves(client: HostileClient) -> bool:
    """Request a move; return whether it is accepted."""
    reply = client.ask("request/move", bytes(msgpack.packb(MOVE)), HOLD_S)
    return bool(reply and reply["accepted"])


def in_time(succeeds: Callable[[], bool]) -> bool:
    """Return whether an action succeeds; on a loaded machine it is repeated."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not (success := succeeds()) and time.monotonic() < give_up_s:
        time.sleep(0.5)
    return success


def played_back(client: HostileClient, recording: Recording) -> dict[str, Any]:
    """Publish a recording; return the joint motion, and the robot's holds by code."""
    rest, moved_rad, holds = client.joints(), 0.0, Counter[str]()
    began_s, first_s = time.monotonic(), recording[0][0]
    for at_s, key, fields in recording:
        time.sleep(max(0.0, at_s - first_s - (time.monotonic() - began_s)))
        client.session.put(key, bytes(msgpack.packb({**fields, "boot": PLAYED_BOOT})))
        moved_rad = max(moved_rad, *map(abs, map(sub, client.joints(), rest)))
        holds[(client.newest["robot/state"]["hold"] or {"code": ""})["code"]] += 1
    return {"moved_rad": moved_rad, "holds": dict(holds)}


def play_back(cell: CellConfig, path: Path) -> dict[str, Any]:
    """Record a moving cell; play it into a new start of the cell, and to a robot alone."""
    with client_of(cell, path) as client:
        recording = recorded_job(client)
    with client_of(cell, path) as client:
        client.ready()
        time.sleep(GOOD_S)
        armed = in_time(client.armed)
        in_a_cell = played_back(client, recording)
    with client_of(cell, path, roles=frozenset({"hub", "robot"})) as client:
        client.until_received({"robot/state"})
        alone = played_back(client, recording)
    permitted = Counter(fields["kind"] for *_, fields in recording if fields.get("permission"))
    return {
        "messages": len(recording),
        "permitted": dict(permitted),
        "armed": armed,
        "in_a_cell": in_a_cell,
        "robot_alone": alone,
    }


def is_unaffected(found: dict[str, Any]) -> bool:
    """Return whether a recording with commands has moved nothing."""
    moved_rad = max(found[run]["moved_rad"] for run in ("in_a_cell", "robot_alone"))
    executed = "" in found["robot_alone"]["holds"]
    is_proof = found["armed"] and found["permitted"].get("goal", 0) > 0
    return bool(is_proof and moved_rad < MOVED_RAD and not executed)
