"""What is kept of a run, in terms that outlive the names on the wire.

Numbers: for each stream the sum, and the sum weighted by place, of every WINDOW messages, so that a
change of one number of one message shows. Events: whatever is no measured number, each time that it
changes. Both are told in words of this file; when a field of a message is renamed, its name changes
in the lines below that read it, and nothing that is kept does.
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
from tests.kept.player import Player

FOLDER = Path(__file__).parent / "outputs"
WINDOW = 40  # messages
MOST_APART = 1e-9  # N, N m, m, rad
NS_PER_MS = 1_000_000
HELD_ID = 4  # which number of the program's health names an ID

Row = list[float]


class Kept(NamedTuple):
    """Outputs of one run."""

    numbers: dict[str, Array]  # stream: rows of (count, sums, weighted sums)
    events: list[str]  # in order: when [ms], of what, what


class Said(NamedTuple):
    """One message: numbers by stream, and the rest."""

    numbers: dict[str, Row]
    rest: tuple[Any, ...]


# --- what is read of each message -----------------------------------------------------------------


def wrench(said: m.WrenchAtTcp) -> Said:
    """The environment's wrench, and whether it may be relied on."""
    numbers = {"wrench": [*said.force_N, *said.torque_Nm]} if said.valid else {}
    return Said(numbers, (said.valid, said.code, said.calibrated, said.calibration))


def regulator(said: m.RegulatorTarget) -> Said:
    """The pose or the feedback that is proposed, and the errors that it follows."""
    numbers = _pose("regulator pose", said.pose) | _feedback("regulator feedback", said.feedback)
    if said.valid:
        numbers["regulator errors"] = [*said.error_force_N, *said.error_torque_Nm]
    if said.path_left_m is not None:
        numbers["path left"] = [said.path_left_m]
    asked = (said.mode, said.host, said.law, said.setpoint_N)
    return Said(numbers, (said.valid, said.code, *asked, said.contact))


def arbiter(said: m.RobotCommand) -> Said:
    """What is let through, and under which permission."""
    numbers = _pose("command pose", said.pose) | _feedback("command feedback", said.feedback)
    goal, permission = said.goal, said.permission
    if goal is not None:
        numbers |= _pose("command goal", goal.pose)
        numbers |= {} if goal.joint_rad is None else {"command joints": [*goal.joint_rad]}
    who = None if permission is None else (permission.host, permission.lease, permission.ownership)
    why = None if permission is None else permission.purpose
    speed = tuple(said.speed.model_dump().values())
    return Said(numbers, (said.kind, said.commander, who, why, speed, said.limited))


def status(said: m.ArbiterStatus) -> Said:
    """Who may move the arm, and what stopped it."""
    who = (
        said.state,
        said.commander,
        said.next_commander,
        said.lease,
        said.ownership,
        said.armed_for,
    )
    return Said({}, (*who, tuple(trip.code for trip in said.trips), len(said.not_ready)))


def robot(said: m.RobotState) -> Said:
    """Where the arm is, what it was sent, and why it holds."""
    numbers = {"joints": [*(said.joint_rad or (0.0,) * 6)]} | _pose("sent", said.sent)
    numbers["flange"] = [*said.position_m, *said.orientation_xyzw]
    status, own = said.status, said.status.kawasaki or m.KawasakiStatus()
    ready = status.kawasaki is None and status.ready
    bits = [ready or bit for bit in (own.motor_power, own.repeat_mode, own.teach_lock_off)]
    bits += [ready or own.program_running, status.moving]
    bits += [status.feedback in (mode, "both") for mode in ("position", "orientation")]
    bits += [status.held, own.watchdog_latched, own.target_refused, own.error]
    flags = "".join(str(int(bit)) for bit in bits)
    taken = None if said.accepted is None else said.accepted.ownership
    goal = (said.goal.id, said.goal.state)
    return Said(numbers, (flags, own.error_code, goal, said.hold_code, taken, said.link.connected))


def _pose(name: str, pose: m.PoseRecord | None) -> dict[str, Row]:
    return {} if pose is None else {name: [*pose.position_m, *pose.orientation_xyzw]}


def _feedback(name: str, said: m.Feedback | None) -> dict[str, Row]:
    if said is None:
        return {}
    gains = [number for three in said.gains.model_dump().values() for number in three]
    return {name: [*said.setpoint_force_N, *said.lever_m, *gains]}


READ: dict[str, Callable[[Any], Said]] = {
    topics.WRENCH.key: wrench,
    topics.REGULATOR_TARGET.key: regulator,
    topics.ROBOT_COMMAND.key: arbiter,
    topics.ARBITER_STATUS.key: status,
    topics.ROBOT_STATE.key: robot,
}
KEY_TOPICS = {topic.key: topic for topic in topics.TOPICS if topic.key in READ}


# --- keeping --------------------------------------------------------------------------------------


def kept_of(player: Player) -> Kept:
    """Return what is kept of a run that was played."""
    rows: dict[str, list[Row]] = {}
    events: list[tuple[int, str]] = []
    for key, tap in player.taps.items():
        last: tuple[Any, ...] | None = None
        while (data := tap.take()) is not None:
            header, message = decode(data, KEY_TOPICS[key].message)
            said = READ[key](message)
            for name, row in said.numbers.items():
                rows.setdefault(name, []).append(row)
            if said.rest != last:
                last = said.rest
                events.append((header.stamp_ns, f"{key} {last}"))
    for at_ns, key, accepted, code in player.replies:
        events.append((at_ns, f"{key} {'granted' if accepted else 'refused'} {code}"))
    for at_ns, who, packet in player.packets:
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
    """Return the numbers of a packet, without its ID and the one it names: they begin anywhere."""
    named = HELD_ID if packet.com == Com.HEALTH else None
    return [packet.param, *(value for place, value in enumerate(packet.vec) if place != named)]


def windows(rows: list[Row]) -> Array:
    """Return for each WINDOW of rows how many they are, their sum, and their sum by place."""
    found = []
    for first in range(0, len(rows), WINDOW):
        part = np.array(rows[first : first + WINDOW], dtype=float)
        place = np.arange(1, len(part) + 1) / WINDOW
        found.append([len(part), *part.sum(axis=0), *(place @ part)])
    return np.array(found)


def differences(kept: Kept, now: Kept) -> list[str]:
    """Return in words where a run is not what was kept, first things first."""
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
        if not (apart <= MOST_APART).all():
            window, column = np.argwhere(~(apart <= MOST_APART))[0]
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
    """Store what is kept of a run."""
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(FOLDER / f"{name}.npz", **kept.numbers)  # type: ignore[arg-type]
    text = json.dumps(kept.events, indent=0, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


def read(name: str) -> Kept:
    """Return what was stored of a run."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        numbers = {key: np.array(stored[key]) for key in stored.files}
    return Kept(numbers, json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8")))
