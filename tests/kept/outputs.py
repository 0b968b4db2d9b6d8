"""Kept outputs of a run, in terms that do not depend on the names on the wire.

Numbers: for each stream the sum, and the sum weighted by position, of every WINDOW messages, so
that a change of one number of one message is detected. Events: every value that is not a measured
number, each time that it changes. Both use names of this file; when a field of a message is
renamed, its name changes in the functions below, and the kept files do not.
"""

import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from common.motion.frames import Array
from controller.packet import Packet
from controller.packet_table import Com
from forcemesh import messages as m
from forcemesh import topics
from forcemesh.codec import decode
from tests.kept.rig import KeptRig

FOLDER = Path(__file__).parent / "outputs"
WINDOW = 40  # messages
MOST_APART = 1e-9  # N, N m, m, rad
ROUNDING = WINDOW * 2.0**-53  # of a sum; a packet's numbers are large, and processors differ
NS_PER_MS = 1_000_000
HELD_ID = 4  # index of the ID in the program's health

Row = list[float]
ANY_SIDE = (0.83, 0.41, 0.29, 0.23)  # normal of a plane that no orientation of a run lies in


class Kept(NamedTuple):
    """Outputs of one run."""

    numbers: dict[str, Array]  # stream: rows of (count, sums, weighted sums)
    events: list[str]  # in order: time [ms], source, content


class Content(NamedTuple):
    """Content of one message: numbers by stream, and the rest."""

    numbers: dict[str, Row]
    rest: tuple[Any, ...]


# --- content of each message ----------------------------------------------------------------------


def wrench(record: m.WrenchAtTcp) -> Content:
    """Return the environment's wrench, and its validity."""
    numbers = {"wrench": [*record.force_N, *record.torque_Nm]} if record.valid else {}
    name = f"{record.calibration}, tared" if record.tared else record.calibration
    return Content(numbers, (record.valid, record.code, record.calibrated, name))


def regulator(record: m.RegulatorTarget) -> Content:
    """Return the proposed pose or feedback, and its errors."""
    numbers = _pose("regulator pose", record.pose) | _feedback(
        "regulator feedback", record.feedback
    )
    if record.valid:
        numbers["regulator errors"] = [*record.error_force_N, *record.error_torque_Nm]
    if record.path_left_m is not None:
        numbers["path left"] = [record.path_left_m]
    request = (record.mode, record.host, record.law, record.setpoint_N)
    return Content(numbers, (record.valid, record.code, *request, record.contact))


def arbiter(record: m.RobotCommand) -> Content:
    """Return the command to the robot, and its permission."""
    numbers = _pose("command pose", record.pose) | _feedback("command feedback", record.feedback)
    goal, permission = record.goal, record.permission
    if goal is not None:
        numbers |= _pose("command goal", goal.pose)
        numbers |= {} if goal.joint_rad is None else {"command joints": [*goal.joint_rad]}
    who = None if permission is None else (permission.host, permission.lease, permission.ownership)
    why = None if permission is None else permission.purpose
    speed = tuple(record.speed.as_dict().values())
    return Content(numbers, (record.kind, record.commander, who, why, speed, record.limited))


def status(record: m.ArbiterStatus) -> Content:
    """Return who may move the arm, and the causes of its stop."""
    who = (
        record.state,
        record.commander,
        record.next_commander,
        record.lease,
        record.ownership,
        record.armed_for,
    )
    return Content({}, (*who, tuple(trip.code for trip in record.trips), len(record.not_ready)))


def robot(record: m.RobotState) -> Content:
    """Return the pose of the arm, the pose sent to it, and the cause of a hold."""
    numbers = {"joints": [*(record.joint_rad or (0.0,) * 6)]} | _pose("sent", record.sent)
    numbers["flange"] = [*record.position_m, *_one_sign(record.orientation_xyzw)]
    status, own = record.status, record.status.kawasaki or m.KawasakiStatus()
    ready = status.kawasaki is None and status.ready
    bits = [ready or bit for bit in (own.motor_power, own.repeat_mode, own.teach_lock_off)]
    bits += [ready or own.program_running, status.moving]
    bits += [status.feedback in (mode, "both") for mode in ("position", "orientation")]
    bits += [status.held, own.watchdog_latched, own.target_refused, own.error]
    flags = "".join(str(int(bit)) for bit in bits)
    taken = None if record.accepted is None else record.accepted.ownership
    goal = (record.goal.id, record.goal.state)
    return Content(
        numbers, (flags, own.error_code, goal, record.hold_code, taken, record.link.connected)
    )


def _one_sign(quaternion: m.Quaternion) -> Row:
    """Return the quaternion, or its negative, which is the same rotation.

    With w > 0, as published, rounding decides the sign of the flange above a tool that points down.
    """
    side = sum(part * axis for part, axis in zip(quaternion, ANY_SIDE, strict=True))
    return [math.copysign(1.0, side) * part for part in quaternion]


def _pose(name: str, pose: m.PoseRecord | None) -> dict[str, Row]:
    return {} if pose is None else {name: [*pose.position_m, *pose.orientation_xyzw]}


def _feedback(name: str, record: m.Feedback | None) -> dict[str, Row]:
    if record is None:
        return {}
    gains = [number for three in record.gains.as_dict().values() for number in three]
    return {name: [*record.setpoint_force_N, *record.lever_m, *gains]}


READ: dict[str, Callable[[Any], Content]] = {
    topics.WRENCH.key: wrench,
    topics.REGULATOR_TARGET.key: regulator,
    topics.ROBOT_COMMAND.key: arbiter,
    topics.ARBITER_STATUS.key: status,
    topics.ROBOT_STATE.key: robot,
}
KEY_TOPICS = {topic.key: topic for topic in topics.TOPICS if topic.key in READ}


# --- keeping --------------------------------------------------------------------------------------


def kept_of(rig: KeptRig) -> Kept:
    """Return the kept outputs of a run."""
    rows: dict[str, list[Row]] = {}
    events: list[tuple[int, str]] = []
    for key, tap in rig.taps.items():
        last: tuple[Any, ...] | None = None
        while (data := tap.take()) is not None:
            header, message = decode(data, KEY_TOPICS[key].message)
            content = READ[key](message)
            for name, row in content.numbers.items():
                rows.setdefault(name, []).append(row)
            if content.rest != last:
                last = content.rest
                events.append((header.stamp_ns, f"{key} {last}"))
    for at_ns, key, accepted, code in rig.replies:
        events.append((at_ns, f"{key} {'granted' if accepted else 'refused'} {code}"))
    for at_ns, who, packet in rig.packets:
        name = f"{who} {int(packet.com)}"
        if name not in rows:
            events.append((at_ns, f"{name} for the first time"))
        rows.setdefault(name, []).append(_numbers_of(packet))
    events.sort()
    return Kept(
        {name: windows(each) for name, each in sorted(rows.items())},
        [f"{(at_ns - events[0][0]) / NS_PER_MS:.0f} {text}" for at_ns, text in events],
    )


def _numbers_of(packet: Packet) -> Row:
    """Return the numbers of a packet without its ID and the ID in it, whose start value varies."""
    named = HELD_ID if packet.com == Com.HEALTH else None
    return [packet.param, *(value for place, value in enumerate(packet.vec) if place != named)]


def windows(rows: list[Row]) -> Array:
    """Return for each WINDOW of rows the count, the sum, and the sum weighted by position."""
    found = []
    for first in range(0, len(rows), WINDOW):
        part = np.array(rows[first : first + WINDOW], dtype=float)
        place = np.arange(1, len(part) + 1) / WINDOW
        found.append([len(part), *part.sum(axis=0), *(place @ part)])
    return np.array(found)


def differences(kept: Kept, now: Kept) -> list[str]:
    """Return the differences of a run from its kept outputs as texts, the first ones first."""
    found = [
        f"event {number}: it was {was!r}, and is {what!r}"
        for number, (was, what) in enumerate(_side_by_side(kept.events, now.events))
        if was != what
    ][:3]
    for name in sorted(kept.numbers.keys() | now.numbers.keys()):
        was, what = kept.numbers.get(name), now.numbers.get(name)
        if was is None or what is None or was.shape != what.shape:
            found.append(f"{name}: {_size(was)} windows were kept, and are {_size(what)}")
            continue
        apart = np.abs(was - what)
        is_same = apart <= MOST_APART + ROUNDING * np.abs(was)
        if not is_same.all():
            window, column = np.argwhere(~is_same)[0]
            most = float(np.nanmax(apart)) if np.isfinite(apart).any() else math.nan
            found.append(f"{name}: from window {window} on, column {column}; by {most:.3g} at most")
    return found


def _side_by_side(a: list[str], b: list[str]) -> Iterable[tuple[str, str]]:
    longest = max(len(a), len(b))
    pad = ["nothing"] * longest
    return zip((a + pad)[:longest], (b + pad)[:longest], strict=True)


def _size(rows: Array | None) -> int:
    return 0 if rows is None else len(rows)


def write(name: str, kept: Kept) -> None:
    """Store the kept outputs of a run."""
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(FOLDER / f"{name}.npz", **kept.numbers)  # type: ignore[arg-type]
    text = json.dumps(kept.events, indent=0, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


def read(name: str) -> Kept:
    """Return the stored outputs of a run."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        numbers = {key: np.array(stored[key]) for key in stored.files}
    return Kept(numbers, json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8")))
