"""Verbs that move the arm, or stop it: arm, hold, clear, move, speed."""

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.context import NO_ANSWER, NOT_WELL, REFUSED, CellOption, ask, client_of, fail
from cli.numbers import JOINTS, NEGATIVE_NUMBERS, POSE, parse_vector

if TYPE_CHECKING:
    from common.endpoints import Bus
    from common.messages import Speed, Vec6
    from common.requests import MoveRequest

move = typer.Typer(
    no_args_is_help=True, help="Move the flange or the joints; waits until it is there."
)

POLL_S = 0.02
TAKEN_S = 0.5  # so long the arbiter must have named another goal, or none, before it is believed
HEARD_WITHIN_S = 2.0
INTERRUPTED = 130

SpeedOption = Annotated[
    float | None,
    typer.Option("--speed", min=0.001, max=5000.0, help="Speed [mm/s]; else that of `speed`."),
]
AskerOption = Annotated[
    Literal["operator", "program"],
    typer.Option("--as", help="Who asks: a person takes the arm from a program."),
]
NoWait = Annotated[bool, typer.Option("--no-wait", help="Do not wait until it is there.")]
Percent = Annotated[float | None, typer.Option(min=0.1, max=100.0, help="Percent.")]


def arm(
    jog: Annotated[
        bool, typer.Option("--jog", help="For moves alone: without calibration and in contact too.")
    ] = False,
    cell: CellOption = None,
) -> None:
    """Let motion begin, after the preflight."""
    from common import topics
    from common.requests import ArmRequest

    with client_of(cell) as (_, bus):
        ask(bus, topics.ARM, ArmRequest(purpose="jog" if jog else "all"))


def hold(
    reason: Annotated[str, typer.Option(help="What everybody will read.")] = "asked to hold",
    cell: CellOption = None,
) -> None:
    """Stop the motion and hold; always accepted. This is not a safety function."""
    from common import topics
    from common.requests import HoldRequest

    with client_of(cell) as (_, bus):
        ask(bus, topics.HOLD, HoldRequest(reason=reason[:400]))


def clear(cell: CellOption = None) -> None:
    """Acknowledge a hold or a fault; arming is the next step."""
    from common import topics
    from common.requests import Empty

    with client_of(cell) as (_, bus):
        ask(bus, topics.CLEAR, Empty())


def speed(
    *,
    accel: Percent = None,
    decel: Percent = None,
    modular: Percent = None,
    mechanical: Annotated[
        float | None, typer.Option(min=0.001, max=5000.0, help="Speed [mm/s].")
    ] = None,
    cell: CellOption = None,
) -> None:
    """Set the speeds of the moves to come; what is left out keeps its value.

    The real speed is the mechanical one times the modular percentage.
    """
    from common import topics

    changes = {"accel": accel, "decel": decel, "modular": modular}
    update = {f"{name}_fraction": v / 100.0 for name, v in changes.items() if v is not None}
    if mechanical is not None:
        update["mechanical_m_s"] = mechanical / 1e3
    with client_of(cell) as (_, bus):
        wanted = type(now := _speed_now(bus)).model_validate({**now.model_dump(), **update})
        ask(bus, topics.SPEED, wanted)


@move.command("to", context_settings=NEGATIVE_NUMBERS)
def move_to(
    pose: Annotated[str, typer.Argument(metavar="X,Y,Z,O,A,T", help="Flange, mm and degrees.")],
    *,
    speed: SpeedOption = None,
    asker: AskerOption = "operator",
    no_wait: NoWait = False,
    cell: CellOption = None,
) -> None:
    """Move the flange to a pose in base: position [mm], Kawasaki's O, A, T [degrees]."""
    numbers = parse_vector(pose, POSE)
    from common.convert import record_of
    from common.frames import Oat, R_from_oat
    from common.frames import pose as pose_from
    from common.requests import MoveRequest

    position_m = tuple(value / 1e3 for value in numbers[:3])
    oat = Oat(*(math.radians(angle) for angle in numbers[3:]))
    record = record_of(pose_from(position_m, R_from_oat(oat)))
    request = MoveRequest(kind="pose", pose=record, speed_m_s=_m_s(speed), commander=asker)
    _move(request, no_wait, cell)


@move.command("joints", context_settings=NEGATIVE_NUMBERS)
def move_joints(
    joints: Annotated[str, typer.Argument(metavar="J1,..,J6", help="Joint angles [degrees].")],
    *,
    speed: SpeedOption = None,
    asker: AskerOption = "operator",
    no_wait: NoWait = False,
    cell: CellOption = None,
) -> None:
    """Move the joints to angles [degrees]."""
    joint_rad = _radians(joints)
    from common.requests import MoveRequest

    request = MoveRequest(
        kind="joints", joint_rad=joint_rad, speed_m_s=_m_s(speed), commander=asker
    )
    _move(request, no_wait, cell)


@move.command("by", context_settings=NEGATIVE_NUMBERS)
def move_by(
    joints: Annotated[str, typer.Argument(metavar="J1,..,J6", help="Joint angles [degrees].")],
    *,
    speed: SpeedOption = None,
    asker: AskerOption = "operator",
    no_wait: NoWait = False,
    cell: CellOption = None,
) -> None:
    """Move the joints by angles [degrees] from where they are."""
    joint_rad = _radians(joints)
    from common.requests import MoveRequest

    request = MoveRequest(kind="by", joint_rad=joint_rad, speed_m_s=_m_s(speed), commander=asker)
    _move(request, no_wait, cell)


def _radians(text: str) -> "Vec6":
    a, b, c, d, e, f = (math.radians(angle) for angle in parse_vector(text, JOINTS))
    return (a, b, c, d, e, f)


def _m_s(speed_mm_s: float | None) -> float | None:
    return None if speed_mm_s is None else speed_mm_s / 1e3


def _move(request: "MoveRequest", no_wait: bool, cell: Path | None) -> None:
    """Ask for a move and wait until it is done; Ctrl-C while waiting asks for a hold."""
    from common import topics
    from common.requests import HoldRequest

    with client_of(cell) as (_, bus):
        watcher = _GoalWatcher(bus)
        reply = ask(bus, topics.MOVE, request)
        if no_wait:
            return
        try:
            watcher.wait(int(reply.value or 0))
        except KeyboardInterrupt:
            ask(bus, topics.HOLD, HoldRequest(reason="move was interrupted"))
            raise typer.Exit(INTERRUPTED) from None


class _GoalWatcher:
    """Follows one goal through `robot/state` until it is done."""

    def __init__(self, bus: "Bus") -> None:
        from common import topics

        self._clock = bus.clock
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        self._mine_s = 0.0  # when the arbiter named this goal last

    def wait(self, goal_id: int) -> None:
        """Return when the goal is done; end the verb when it will not be."""
        from rich.console import Console

        started_s = heard_s = self._mine_s = time.monotonic()
        began = False
        with Console(stderr=True).status(f"goal {goal_id}") as live:
            while True:
                self._clock.sleep_s(POLL_S)
                now_s = time.monotonic()
                robot = self._robot.read(self._clock.now_ns())
                if robot.fresh is None:
                    if now_s - heard_s > HEARD_WITHIN_S:
                        fail(f"lost sight of the arm: {robot.fault}", NO_ANSWER)
                    continue
                heard_s, goal = now_s, robot.fresh.goal
                x, y, z = (1e3 * value for value in robot.fresh.position_m)
                live.update(f"goal {goal_id}: flange at {x:.1f}, {y:.1f}, {z:.1f} mm")
                state = goal.state if goal.id == goal_id else "none"
                if state == "done":
                    break
                if state == "refused" and began:
                    fail(f"the move ended before its goal: {goal.reason}", NOT_WELL)
                if state == "refused":
                    fail(f"refused (goal): {goal.reason}", REFUSED)
                began = began or state == "running"
                self._end_when_stopped(goal_id, now_s)
        where = f"{x:.2f}, {y:.2f}, {z:.2f} mm"
        typer.echo(f"done in {time.monotonic() - started_s:.2f} s: flange at {where}")

    def _end_when_stopped(self, goal_id: int, now_s: float) -> None:
        """End when the arm was stopped, or somebody else has it: this goal is not coming back."""
        status = self._arbiter.read(self._clock.now_ns()).fresh
        if status is None or status.goal_id == goal_id:
            self._mine_s = now_s
            return
        why = "; ".join(trip.text for trip in status.trips) or "no reason given"
        if status.state in ("HOLDING", "FAULT"):
            fail(f"the move ended before its goal: the arbiter is {status.state}: {why}", NOT_WELL)
        if now_s - self._mine_s > TAKEN_S:
            fail(f"the move ended before its goal: {why}", NOT_WELL)


def _speed_now(bus: "Bus") -> "Speed":
    """Return the speeds that the arbiter sends along now."""
    from common import topics
    from common.errors import BusError

    reader = bus.reader(topics.ROBOT_COMMAND)
    give_up_s = time.monotonic() + HEARD_WITHIN_S
    while (command := reader.read(bus.clock.now_ns()).message) is None:
        if time.monotonic() > give_up_s:
            raise BusError(f"nothing on {topics.ROBOT_COMMAND.key} within {HEARD_WITHIN_S:g} s")
        time.sleep(POLL_S)
    return command.speed
