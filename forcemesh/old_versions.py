"""Upgrade of recorded messages of older schema versions to the fields of the present one.

Version 1: an address is the key alone. Version 2: it names the cell too. Version 3: `robot/state`
has a status for any robot, its hold as a whole `Trip` and one angle per joint; `ownership` was
`turn`; the law of hand guiding is `admittance`, it was `guide`.
"""

from collections.abc import Callable
from typing import Any

from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import CONTROLLER_BITS

Fields = dict[str, Any]

NEEDED = ("motor_power", "repeat_mode", "teach_lock_off", "program_running")
FORBIDDEN = ("watchdog_latched", "error")
MODES = {(True, False): "position", (False, True): "orientation", (True, True): "both"}


def upgraded(fields: Fields, key: str) -> Fields:
    """Return the fields of a message of version 1 or 2 as version 3 has them."""
    upgrade = UPGRADES.get(key)
    return fields if upgrade is None else fields | upgrade(fields)


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


def _regulator_target(fields: Fields) -> Fields:
    return {"law": "admittance"} if fields.get("law") == "guide" else {}


def _owned(part: Any) -> Any:
    return part | {"ownership": part.get("turn", 0)} if isinstance(part, dict) else part


UPGRADES: dict[str, Callable[[Fields], Fields]] = {
    "robot/state": _robot_state,
    "robot/command": _robot_command,
    "arbiter/status": _owned,
    "regulator/target": _regulator_target,
}
