"""Codec of recorded messages: older schema versions are upgraded to the fields of the present one.

Version 1: an address is the key alone. Version 2: it names the cell too. Version 3: `robot/state`
has a status for any robot, its hold as a whole `Trip` and one angle per joint; `ownership` was
`turn`. A robot state and a permission of before the challenge get one; compliant axes of a target
were `admittance` or `free`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from forcemesh.codec import SCHEMA_VERSION, Header, pack, unpack
from forcemesh.errors import MessageError, MisroutedError
from forcemesh.faults import FAULTS, tripped
from forcemesh.force_task import GUIDED, parse_task
from forcemesh.messages import CONTROLLER_BITS, Message

M = TypeVar("M", bound=Message)
Fields = dict[str, Any]

READABLE_VERSIONS = (1, 2, SCHEMA_VERSION)
OLD_CHALLENGE = 1  # of a recording from before the challenge: a replayed arbiter arms with it

NEEDED = ("motor_power", "repeat_mode", "teach_lock_off", "program_running")
FORBIDDEN = ("watchdog_latched", "error")
MODES = {(True, False): "position", (False, True): "orientation", (True, True): "both"}


def decode_recorded(data: bytes, message_type: type[M], key: str) -> tuple[Header, M]:
    """Return header and message of a recording of this or an older schema version.

    Raise MisroutedError when they carry another key, of any cell, and MessageError as `decode`.
    """
    fields = unpack(data, READABLE_VERSIONS)
    header = Header.from_dict(fields)
    written_for = header.topic if header.v == 1 else header.topic.partition("/")[2]
    if written_for != key:
        raise MisroutedError(f"addressed to {header.topic[:80]!r}, but recorded as {key}")
    return header, message_type.from_dict(_upgraded(fields, key))


def readdressed(data: bytes, address: str) -> bytes:
    """Return a recorded message with a new address and the fields of the present schema version.

    Bytes that need no change or are no message are unchanged.
    """
    try:
        fields = unpack(data, READABLE_VERSIONS)
    except MessageError:
        return data
    if fields.get("v") not in READABLE_VERSIONS:
        return data
    now = {"v": SCHEMA_VERSION, "topic": address}
    upgraded = _upgraded(fields, address.partition("/")[2]) | now
    return data if upgraded == fields else pack(upgraded)


def upgraded_request(key: str, fields: Fields) -> Fields:
    """Return the fields of a recorded request in the words of today."""
    if key != "request/force/start":
        return fields
    mode, task = fields.get("mode", "position"), fields.get("task")
    if fields.get("law") in ("admittance", "guide") and mode in GUIDED:
        return fields | {"law": "plain", "task": parse_task(GUIDED[mode]).as_dict()}
    return fields | {"task": task | _axes(task)} if isinstance(task, dict) else fields


def _upgraded(fields: Fields, key: str) -> Fields:
    """Return the fields as the present schema version has them."""
    upgrade = UPGRADES.get(key)
    if upgrade is not None and fields.get("v") != SCHEMA_VERSION:
        fields = fields | upgrade(fields)
    if key == "regulator/target":
        return fields | _axes(fields)
    if key == "robot/state":
        return {"challenge": OLD_CHALLENGE} | fields
    if key == "robot/command" and isinstance(permission := fields.get("permission"), dict):
        return fields | {"permission": {"challenge": OLD_CHALLENGE} | permission}
    return fields


def _robot_state(fields: Fields) -> Fields:
    bits = fields.get("status")
    if not isinstance(bits, dict):
        return {}
    feedback = bool(bits.get("position_feedback")), bool(bits.get("orientation_feedback"))
    reason, code = fields.get("hold_reason"), fields.get("hold_code")
    known = code if code in FAULTS else "robot_holds"
    return {
        "status": {
            "ready": all(bits.get(bit) for bit in NEEDED) and not any(map(bits.get, FORBIDDEN)),
            "moving": bool(bits.get("moving")),
            "held": bool(bits.get("held")),
            "feedback": MODES.get(feedback),
            "kawasaki": {name: bits.get(name, False) for name in CONTROLLER_BITS}
            | {"error_code": fields.get("error_code", 0)},
        },
        "hold": tripped(known, reason).as_dict() if isinstance(reason, str) and reason else None,
        "accepted": _owned(fields.get("accepted")),
    }


def _robot_command(fields: Fields) -> Fields:
    return {"permission": _owned(fields.get("permission"))}


def _axes(fields: Fields) -> Fields:
    axes = fields.get("axes")
    return {"axes": [*map(_axis, axes)]} if isinstance(axes, list | tuple) else {}


def _axis(part: Any) -> Any:
    is_old = isinstance(part, dict) and part.get("control") in ("admittance", "free")
    return part | {"control": "compliant"} if is_old else part


def _owned(part: Any) -> Any:
    return part | {"ownership": part.get("turn", 0)} if isinstance(part, dict) else part


UPGRADES: dict[str, Callable[[Fields], Fields]] = {
    "robot/state": _robot_state,
    "robot/command": _robot_command,
    "arbiter/status": _owned,
}
