"""Generator of docs/arbitration.md from the arbiter's tables: `python -m tools.arbitration_page`."""

from pathlib import Path

from common.motion.back_off import (
    BLIND_M,
    LEAST_BACK_OFF_FORCE_N,
    LONGEST_BACK_OFF_M,
    MUST_FALL_N,
    RISE_N,
    SPEED_M_S,
    RISE_Nm,
)
from common.motion.permission import RANKS
from forcemesh.faults import FAULTS
from forcemesh.messages import MAY_MOVE
from services.arbiter.commanders import REST_S, SETTLE_WITHIN_S
from services.arbiter.states import CLEARS, MEANS, TABLE
from services.arbiter.stream import REACTIONS, RETREAT_FROM

PAGE = Path(__file__).resolve().parent.parent / "docs" / "arbitration.md"
WHO = {
    "none": "no commander",
    "regulator": "force feedback, on the PC or in the controller, whichever client started it",
    "program": "a script: `forcemesh move ... --as program`, or `commander` in the request",
    "operator": "a person: `forcemesh move ...`",
}
HEAD = """# Arbitration and limits

This page describes which client may command the arm, and the limits of its motion. It is made from the
tables in `services/arbiter` by `make readme`. Nothing here is a safety function.

## States

The state machine is one table, [`states.py`](../services/arbiter/states.py); nothing else changes the state.

```mermaid
stateDiagram-v2
    [*] --> BOOT
"""
RANKS_TEXT = f"""
## Ranks and ownership

One commander at a time. A higher rank takes the arm from a lower one; the same or a lower rank is
refused with `busy` and the name of the owner. `hold` is accepted from every client, always.

| rank | commander | meaning |
|---:|---|---|
{{ranks}}
- A **lease** starts when a person arms, and ends with every stop: no command under it moves the arm again.
  The tether is centred at the pose of arming for the whole lease.
- The robot's process draws a **challenge**, a number, at its start and after each dead lease, and publishes it in
  `robot/state`. Arming takes it, and every permission of the lease repeats it. A permission with another one is
  refused (`no_lease`): a stream of yesterday, of another cell, of before a restart. So a recording moves no arm.
- An **ownership** starts each time the command of a client ends. Its number (`turn`) is sent to the robot in every
  permission and returned in `robot/state`. The robot refuses leases and ownerships with a lower number.
- A new owner waits in SETTLING until the robot reports, under the new ownership, that it has been
  at rest for {REST_S * 1e3:g} ms and for three of its own reports. Then a move starts from there, and
  set points start at the measured pose at zero speed, so the hand-over is bumpless. An arm that is not at
  rest within {SETTLE_WITHIN_S:g} s is held (`handover`).
- The previous owner is notified: the state leaves ACTIVE at once, `trips` contains `preempted` with both
  names while the new owner commands; `next_commander` names the waiting client.
- Force control has an owner of its own, of a rank and a client ([bus](bus.md#requests)): another client of the same or a
  lower rank cannot change its set point, gains or path. A move of either rank still takes the arm from it.
- Interrupted force feedback does not resume automatically: it must be started again.
- A new start with another host is a hand-over as well.

## Reactions

| code | rule | reaction |
|---|---:|---|
"""
REACTIONS_TEXT = f"""| all others | | hold |

- **hold**: the permission is revoked at once; the robot brakes and holds where it is.
- **fade**: set points that the regulator streams come to rest at `limits.accel_m_s2`, then hold. A
  boundary counts as crossed once the arm could no longer be braked before it, so the fade ends
  inside. Motion that is not streamed is held at once, and so is a fade when a more severe fault occurs.
- **retreat**: only with `force.retreat_m` (at most 2 mm, at most 10 mm/s): from {RETREAT_FROM:.0%} of a
  ceiling the tool moves back along its axis, while the wrench is valid, opposes the press
  and stays below the full ceiling; then hold. The trip reports both the force and the return travel.
- A code of kind FAULT is an immediate hold, latched until its cause is remedied.

An arm that holds above the ceiling of force or torque, or outside the workspace, cannot be armed, not even for
jog. A person frees it with `forcemesh back-off` (`request/back_off`, common/motion/back_off.py): the arbiter
arms it for one goal of its own, and the robot's process accepts only the goal that it computes
itself, from its own readings.

- Along the measured force, or straight back into the workspace; at most {LONGEST_BACK_OFF_M * 1e3:g} mm at
  {SPEED_M_S * 1e3:g} mm/s, no rotation, in no axis farther outside than it is.
- The ceilings only decrease (ratchet): force and torque may rise {RISE_N:g} N and {RISE_Nm:g} N m above their minimum so
  far. A force that does not fall by {MUST_FALL_N:g} N over half the travel is not a contact force: the motion ends.
- The motion ends below half of the ceilings, or inside the workspace, and the arm holds.
- If there is no force direction to follow (no valid wrench, no calibration, less than {LEAST_BACK_OFF_FORCE_N:g} N, or one that
  pulls the tool forward) the command asks for a second confirmation, and moves the tool {BLIND_M * 1e3:g} mm back along its axis;
  this is possible without a sensor, and from FAULT, too.

During a move the force may rise by `limits.move_rise_N` above its minimum since the start, if the calibration is valid.

## Limits

All limits are in the section `limits` of the cell file, each with a ceiling in the code above which a cell file
is not loaded; the rules are pure functions in `common/motion/limits.py` and `common/motion/rate_limiter.py`. The
robot's own process enforces them again (`common/motion/last_check.py`).

| limit | applies to | reaction |
|---|---|---|
| `workspace_min_m`, `workspace_max_m`, `planes` | the TCP, measured and commanded; a plane's normal points inside | hold or fade |
| `robot.joint_min_deg`, `joint_max_deg` | commanded and measured (half a degree of tolerance) | refused; hold |
| `joint_speed_share` of `robot.joint_speed_max_deg_s` | measured joints, mean of 100 ms | fade, hold |
| four fifths of that, and full joint speed in 125 ms | set points, by the model of the arm | slowed near a singularity; hold (`acceleration`, `joint_speed`, `unreachable`) |
| `step_m`, `step_deg` | from the measured pose to the set point | hold |
| `speed_m_s`, `speed_deg_s` | set points; the requested speed of moves | limited; refused |
| `accel_m_s2`, `accel_deg_s2` | set points, over the time between the wrenches that they follow | limited: the set points catch up later |
| the same speed over any 250 ms, with a margin of a quarter | set points: independent of the command rate | hold (`rate`) |
| `tether_m`, `tether_deg` | the flange, from where it was armed | hold or fade; refused |
| `force_N`, `torque_Nm` | the wrench at the TCP, magnitude of the vector | hold, or retreat |
| `move_rise_N` | the force in a move, above its minimum since the start of the move | hold |
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
            "```\n\n| state | may move | meaning | recovery |\n|---|---|---|---|\n",
            *states,
            RANKS_TEXT.format(ranks="".join(ranks)),
            *reactions,
            REACTIONS_TEXT,
        ]
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
