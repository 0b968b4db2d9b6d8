"""Writes docs/arbitration.md from the arbiter's tables: `python -m tools.arbitration_page`."""

from pathlib import Path

from common.motion.back_off import (
    BLIND_M,
    FARTHEST_M,
    LEAST_FORCE_N,
    MUST_FALL_N,
    RISE_N,
    SPEED_M_S,
    RISE_Nm,
)
from forcemesh.faults import FAULTS
from forcemesh.messages import MAY_MOVE
from services.arbiter.ownership import REST_S, SETTLE_WITHIN_S
from services.arbiter.ranks import RANKS
from services.arbiter.states import CLEARS, MEANS, TABLE
from services.arbiter.stops import REACTIONS, RETREAT_FROM

PAGE = Path(__file__).resolve().parent.parent / "docs" / "arbitration.md"
WHO = {
    "none": "nobody",
    "regulator": "force feedback, on the PC or in the controller, whoever started it",
    "program": "a script: `forcemesh move ... --as program`, or `commander` in the request",
    "operator": "a person: `forcemesh move ...`",
}
HEAD = """# Who commands the arm, and how far

Made from the tables in `services/arbiter` by `make readme`. Nothing here is a safety function.

## States

One table, [`states.py`](../services/arbiter/states.py); nothing else changes the state.

```mermaid
stateDiagram-v2
    [*] --> BOOT
"""
RANKS_TEXT = f"""
## Ranks and turns

One commander at a time. A higher rank takes the arm from a lower one; the same or a lower rank is
refused with `busy` and the name of who has it. `hold` is taken from anybody, always.

| rank | commander | who |
|---:|---|---|
{{ranks}}
- A **lease** is opened when a person arms, and dies with every stop: nothing under it moves again.
  The tether is fastened where the arm was armed, and stays there for the whole lease.
- A **turn** is opened each time that somebody's command ends. Its number goes to the robot in every
  permission and comes back in `robot/state`. The robot refuses leases and turns that go back.
- Whoever takes the arm waits in SETTLING until the robot says, under the new turn, that it has been
  at rest for {REST_S * 1e3:g} ms and for three of its own reports. Then a move begins from there, and
  set points begin at the measured pose at zero speed. So no hand-over jumps. An arm that is not at
  rest within {SETTLE_WITHIN_S:g} s is held (`handover`).
- Who had the arm is told: the state leaves ACTIVE at once, `trips` holds `preempted` with both
  names, and stays while the new owner commands; `next_commander` says who waits.
- Force feedback that was interrupted does not come back by itself: it is started anew.
- A new start with another host is a hand-over as well.

## Reactions

| code | rule | reaction |
|---|---:|---|
"""
REACTIONS_TEXT = f"""| every other one | | hold |

- **hold**: the permission is taken away at once; the robot brakes and holds where it is.
- **fade**: set points that the regulator streams come to rest at `limits.accel_m_s2`, then hold. A
  place counts as left when the arm could not be braked in front of it any more, so the fade ends
  inside. What is not streamed is held at once, and so is a fade when something worse comes.
- **retreat**: only with `force.retreat_m` (at most 2 mm, at most 10 mm/s): from {RETREAT_FROM:.0%} of a
  ceiling on the tool goes back along its axis, while the wrench is valid, pushes against the press
  and stays below the whole ceiling; then hold. The trip tells both the force and the way back.
- A code of kind FAULT is a hold at once, latched until its cause is mended.

An arm that holds above the ceiling of force or torque, or outside the workspace, is not armed, for jog
neither. A person frees it with `forcemesh back-off` (`request/back_off`, common/motion/back_off.py): the arbiter
arms it for one goal of its own, and the robot's process takes no other than the one that it computes
itself, from its own readings.

- Along the measured force, or straight back into the workspace; at most {FARTHEST_M * 1e3:g} mm at
  {SPEED_M_S * 1e3:g} mm/s, no turn, nowhere more outside than it is.
- The ceilings are a ratchet: force and torque may rise {RISE_N:g} N and {RISE_Nm:g} N m above their least so
  far. A force that does not fall by {MUST_FALL_N:g} N over half the way is no contact: it ends.
- It ends below half of the ceilings, or inside the workspace, and holds.
- Where no force can be followed (no valid wrench, no calibration, less than {LEAST_FORCE_N:g} N, or one that
  pulls the tool forward) it asks a second time, and goes {BLIND_M * 1e3:g} mm back along the tool's axis;
  that is possible without a sensor, and out of FAULT, too.

A move may add `limits.move_rise_N` to the least force since it began, where the calibration holds.

## Limits

All in the section `limits` of the cell file, each with a ceiling in the code above which a cell file
is not loaded; the rules are pure functions in `common/motion/limits.py` and `common/motion/rate_limiter.py`. The
robot's own process keeps them again (`common/motion/last_check.py`).

| limit | what it is about | when it is met |
|---|---|---|
| `workspace_min_m`, `workspace_max_m`, `planes` | the TCP, measured and wished for; a plane's normal points inside | hold or fade |
| `robot.joint_min_deg`, `joint_max_deg` | wished for and measured (half a degree of slack) | refused; hold |
| `joint_speed_share` of `robot.joint_speed_max_deg_s` | measured joints, mean of 100 ms | fade, hold |
| `step_m`, `step_deg` | from the measured pose to the set point | hold |
| `speed_m_s`, `speed_deg_s` | set points; of moves the speed that is asked for | limited; refused |
| `accel_m_s2`, `accel_deg_s2` | set points | limited: the set points catch up |
| the same speed over any 250 ms, with a margin of a quarter | set points: a flood of commands gains nothing | hold (`rate`) |
| `tether_m`, `tether_deg` | the flange, from where it was armed | hold or fade; refused |
| `force_N`, `torque_Nm` | the wrench at the TCP, length of the vector | hold, or retreat |
| `move_rise_N` | the force in a move, above its least since the move began | hold |
"""


def page() -> str:
    """Return the page."""
    arrows = [
        f"    {state} --> {then}: {event}\n"
        for state, row in TABLE.items()
        for event, then in row.items()
    ]
    states = [
        f"| {state} | {'yes' if state in MAY_MOVE else ''} | {MEANS[state]} | {CLEARS[state]} |\n"
        for state in TABLE
    ]
    ranks = [f"| {rank} | {name} | {WHO[name]} |\n" for name, rank in RANKS.items()]
    reactions = [f"| `{code}` | {FAULTS[code].rule} | {how} |\n" for code, how in REACTIONS.items()]
    return "".join(
        [
            HEAD,
            *arrows,
            "```\n\n| state | may move | what it is | what leads on |\n|---|---|---|---|\n",
            *states,
            RANKS_TEXT.format(ranks="".join(ranks)),
            *reactions,
            REACTIONS_TEXT,
        ]
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
