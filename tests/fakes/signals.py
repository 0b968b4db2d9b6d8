"""Section `signals` of a cell file for tests: outputs with each kind of permission, an input."""

from typing import Any

NAMED: dict[str, dict[str, Any]] = {
    "gripper_close": {"output": 9, "set_by": ["operator", "program"]},
    "lamp": {"output": 10, "set_by": ["operator"], "while_held": True},
    "motor": {"output": 11},  # reported only
    "part": {"input": 1001},
}
ALL_OFF = dict.fromkeys(NAMED, False)
FOLLOWING = {"signals": NAMED, "sim.inputs_follow": {"part": "lamp"}}
