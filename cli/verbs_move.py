"""Verbs that move the arm and wait for the end of the move: move to, joints, by; jog; retract."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option, Typer, echo

from cli.context import (
    INTERRUPTED,
    CellOption,
    cell_of,
    confirmed,
    exit_with_error,
    one_line_errors,
    waiting,
)
from cli.numbers import (
    JOINTS,
    NEGATIVE_NUMBERS,
    POSE,
    SEVEN_JOINTS,
    check_angle,
    from_milli,
    parse_number,
    parse_vector,
)
from forcemesh.messages import MAY_MOVE, ZERO3, Asker, PoseRecord, RobotState
from forcemesh.requests import MoveRequest

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell
    from forcemesh.client import Move

move = Typer(
    no_args_is_help=True, help="Move the flange or the joints and wait for the end of the move."
)

JOG_AXES = ("x", "y", "z", "rx", "ry", "rz", "j1", "j2", "j3", "j4", "j5", "j6", "j7")

SpeedOption = Annotated[
    float | None,
    Option("--speed", min=0.001, max=5000.0, help="Speed [mm/s]; default: as set by `speed`."),
]
CommanderOption = Annotated[
    Asker,
    Option("--as", help="Commander; an operator takes the arm from a program."),
]
Yes = Annotated[bool, Option("--yes", "-y", help="Do not ask when the tool is loaded.")]
NoWait = Annotated[bool, Option("--no-wait", help="Do not wait for the end.")]


@move.command("to", context_settings=NEGATIVE_NUMBERS)
def move_to(
    pose: Annotated[str, Argument(metavar="X,Y,Z,O,A,T", help="Flange pose [mm, degrees].")],
    *,
    speed: SpeedOption = None,
    commander: CommanderOption = "operator",
    no_wait: NoWait = False,
    yes: Yes = False,
    cell: CellOption = None,
) -> None:
    """Move the flange to a pose in base: position [mm], Kawasaki's O, A, T [degrees]."""
    x, y, z, o, a, t = parse_vector(pose, POSE)
    from forcemesh.client.ask import request_in_bounds
    from forcemesh.client.rotations import from_oat_deg

    record = PoseRecord(
        position_m=(x / 1e3, y / 1e3, z / 1e3), orientation_xyzw=from_oat_deg((o, a, t))
    )
    request = MoveRequest(
        kind="pose", pose=record, speed_m_s=from_milli(speed), commander=commander
    )
    with one_line_errors():
        request_in_bounds(request)
    _request_move(request, cell, no_wait=no_wait, yes=yes)


def _add_joint_verb(kind: Literal["joints", "by"], summary: str) -> None:
    """Add the verb of a kind of joint move to `move`."""

    @move.command(kind, help=summary, context_settings=NEGATIVE_NUMBERS)
    def verb(
        joints: Annotated[str, Argument(metavar="J1,..,J6", help="Joint angles [degrees].")],
        *,
        speed: SpeedOption = None,
        commander: CommanderOption = "operator",
        no_wait: NoWait = False,
        yes: Yes = False,
        cell: CellOption = None,
    ) -> None:
        named = SEVEN_JOINTS if joints.count(",") == len(JOINTS.names) else JOINTS
        angles_deg = parse_vector(joints, named)
        for name, angle_deg in zip(named.names, angles_deg, strict=True):
            check_angle(angle_deg, name)
        joint_rad = tuple(math.radians(angle) for angle in angles_deg)
        request = MoveRequest(
            kind=kind, joint_rad=joint_rad, speed_m_s=from_milli(speed), commander=commander
        )
        _request_move(request, cell, no_wait=no_wait, yes=yes)


_add_joint_verb("joints", "Move the joints to angles [degrees].")
_add_joint_verb("by", "Move the joints by angles [degrees] relative to their present position.")


def jog(
    axis: Annotated[
        str, Argument(metavar="AXIS", help="x, y, z, rx, ry, rz, or a joint: j1 to j7.")
    ],
    distance: Annotated[str, Argument(metavar="BY", help="Distance [mm] or angle [degrees].")],
    *,
    frame: Annotated[
        Literal["base", "tool"], Option(help="Frame of x, y, z; rotations are about the TCP.")
    ] = "base",
    speed: SpeedOption = None,
    yes: Yes = False,
    cell: CellOption = None,
) -> None:
    """Jog along or about one axis, or one joint, and wait for the end of the move.

    It asks first when the tool is loaded, and stops when the force rises by limits.move_rise_N.
    """
    if axis not in JOG_AXES:
        exit_with_error(f"unknown axis {axis!r}: choose from {', '.join(JOG_AXES)}")
    amount = parse_number(distance, "BY")
    if axis not in "xyz":
        check_angle(amount, "BY")

    with cell_of(cell) as client:
        _ask_when_loaded(client, yes=yes)
        if axis.startswith("j"):
            joints, jogged = client.config.robot.joints, int(axis[1:])
            if jogged > joints:
                exit_with_error(f"{axis}: the arm has {joints} joints")
            angles = (math.radians(amount) if i == jogged else 0.0 for i in range(1, joints + 1))
            request = MoveRequest(kind="by", joint_rad=tuple(angles), speed_m_s=from_milli(speed))
        else:
            turns = axis.startswith("r")
            size = math.radians(amount) if turns else amount / 1e3
            x, y, z = (size if name == axis[-1] else 0.0 for name in "xyz")
            parts = (ZERO3, (x, y, z)) if turns else ((x, y, z), ZERO3)
            pose = client.move.jogged(*parts, axes=frame)
            request = MoveRequest(kind="pose", pose=pose, speed_m_s=from_milli(speed))
        _wait_for_move(client, client.move.begin(request))


def retract(
    distance: Annotated[
        float, Argument(metavar="BY", min=0.1, max=200.0, help="Distance [mm].")
    ] = 10.0,
    *,
    speed: Annotated[float, Option("--speed", min=0.001, max=50.0, help="Speed [mm/s].")] = 10.0,
    cell: CellOption = None,
) -> None:
    """Leave a contact: stop force feedback, then move straight back along the tool's axis."""
    with cell_of(cell) as client:
        if client.target.reading().fresh is not None and client.status().state in MAY_MOVE:
            client.force.stop()
        pose = client.move.jogged((0.0, 0.0, -distance / 1e3), axes="tool")
        request = MoveRequest(kind="pose", pose=pose, speed_m_s=speed / 1e3)
        _wait_for_move(client, client.move.begin(request))
        load_N = client.load_N()
        echo("the tool is free" if load_N is None else f"residual load {load_N:.1f} N")


def _ask_when_loaded(client: "ConfiguredCell", *, yes: bool) -> None:
    load_N = client.load_N()
    if load_N is not None:
        limit_N = client.config.limits.move_rise_N
        loaded = f"the tool is loaded with {load_N:.1f} N"
        confirmed(f"{loaded}; a rise of {limit_N:g} N stops the move. Move?", yes=yes)


def _request_move(request: "MoveRequest", cell: Path | None, *, no_wait: bool, yes: bool) -> None:
    """Request a move and wait for its end; Ctrl-C while waiting requests a hold."""
    with cell_of(cell) as client:
        _ask_when_loaded(client, yes=yes)
        goal = client.move.begin(request)
        echo(f"move accepted: goal {goal.id}")
        if not no_wait:
            _wait_for_move(client, goal)


def _wait_for_move(client: "ConfiguredCell", goal: "Move") -> None:
    began_ns = client.session.clock.now_ns()
    with waiting(f"moving to goal {goal.id}") as live:

        def show(robot: "RobotState") -> None:
            live.update(f"moving to goal {goal.id}: flange at {_position_text(robot, 1)}")

        try:
            robot = goal.wait(timeout_s=float("inf"), progress=show)
        except KeyboardInterrupt:
            exit_with_error("interrupted: a hold was requested", INTERRUPTED)
    took_s = (client.session.clock.now_ns() - began_ns) / 1e9
    echo(f"move finished in {took_s:.2f} s: flange at {_position_text(robot, 2)}")


def _position_text(robot: "RobotState", digits: int) -> str:
    x, y, z = (1e3 * value for value in robot.position_m)
    return f"{x:.{digits}f}, {y:.{digits}f}, {z:.{digits}f} mm"
