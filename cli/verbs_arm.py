"""Verbs for motion permission and stops: arm, back-off, hold, clear, speed."""

from typing import TYPE_CHECKING, Annotated

from typer import Option, echo

from cli.context import (
    INTERRUPTED,
    NOT_WELL,
    CellOption,
    JsonOption,
    cell_of,
    confirmed,
    exit_with_error,
    print_note,
    print_reply,
    waiting,
)
from cli.numbers import from_milli
from forcemesh.errors import RefusedError
from forcemesh.messages import Trip

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell

BACK_OFF_QUESTION = "the arm moves up to 20 mm at 5 mm/s, away from the contact: continue?"
WITHOUT_FORCE_QUESTION = (
    "no force gives a direction: the tool moves 5 mm back along its own axis. "
    "Check the tool: is this path free?"
)
Percent = Annotated[float | None, Option(min=0.1, max=100.0, help="Percent.")]


def arm(
    jog: Annotated[
        bool, Option("--jog", help="For moves only: also without calibration or in contact.")
    ] = False,
    wait: Annotated[
        float,
        Option(min=0.0, max=60.0, help="Longest wait for the preflight checks [s]."),
    ] = 3.0,
    cell: CellOption = None,
) -> None:
    """Run the preflight checks, then enable motion."""
    with cell_of(cell) as client, waiting("preflight"):
        print_reply(client.arm("jog" if jog else "all", within_s=wait))


def back_off(
    *,
    yes: Annotated[bool, Option("--yes", "-y", help="Do not ask for confirmation.")] = False,
    without_force: Annotated[
        bool,
        Option(
            "--without-force",
            help="If no force gives a direction: 5 mm back along the tool's axis; check first.",
        ),
    ] = False,
    cell: CellOption = None,
) -> None:
    """Move an arm slowly out of overload or back into the workspace, at most 20 mm, then hold.

    It moves along the measured force, or straight back into the workspace, at 5 mm/s and without
    rotation, until the load is below half of its limit; the arbiter computes the path. It stops
    when the force rises by 3 N. This is not a safety function.
    """
    with cell_of(cell) as client:
        confirmed(BACK_OFF_QUESTION, yes=yes)
        try:
            end = _back_off_trip(client, without_force=without_force and yes)
        except RefusedError as error:
            if error.code != "no_direction" or yes:
                raise
            print_note(str(error))
            confirmed(WITHOUT_FORCE_QUESTION, yes=False)
            end = _back_off_trip(client, without_force=True)
        is_loaded = client.load_N() is not None
    if end.code != "back_off":
        exit_with_error(f"not free yet: {end.text}", NOT_WELL)
    step = "arm for jog, then `forcemesh retract`" if is_loaded else "arm, when the path is free"
    echo(f"{end.text}; the arm holds: {step}")


def _back_off_trip(client: "ConfiguredCell", *, without_force: bool) -> "Trip":
    try:
        with waiting("backing off"):
            return client.back_off(without_force=without_force)
    except KeyboardInterrupt:
        client.hold("backing off was interrupted")
        exit_with_error("interrupted: a hold was requested", INTERRUPTED)


def hold(
    reason: Annotated[str, Option(help="Reason shown to all clients.")] = "asked to hold",
    cell: CellOption = None,
) -> None:
    """Stop the motion and hold; always accepted. This is not a safety function."""
    with cell_of(cell) as client:
        print_reply(client.hold(reason))


def clear(cell: CellOption = None) -> None:
    """Acknowledge a hold or a fault; the next step is arming."""
    with cell_of(cell) as client:
        print_reply(client.clear())


def speed(
    *,
    accel: Percent = None,
    decel: Percent = None,
    modular: Percent = None,
    mechanical: Annotated[float | None, Option(min=0.001, max=5000.0, help="Speed [mm/s].")] = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Set the speeds of later moves; omitted values are kept. Print all speeds.

    The actual speed is the mechanical speed times the modular percentage.
    """

    def fraction(percent: float | None) -> float | None:
        return None if percent is None else percent / 100.0

    with cell_of(cell) as client:
        now = client.speed(
            accel_fraction=fraction(accel),
            decel_fraction=fraction(decel),
            modular_fraction=fraction(modular),
            mechanical_m_s=from_milli(mechanical),
        )
    if as_json:
        print(now.as_json())
        return
    real_mm_s = 1e3 * now.mechanical_m_s * now.modular_fraction
    echo(
        f"later moves run at {real_mm_s:.1f} mm/s: mechanical {1e3 * now.mechanical_m_s:g} mm/s, "
        f"modular {100.0 * now.modular_fraction:g} %, accel {100.0 * now.accel_fraction:g} %, "
        f"decel {100.0 * now.decel_fraction:g} %"
    )
