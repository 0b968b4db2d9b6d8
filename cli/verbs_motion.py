"""Verbs that let the arm move, or stop it: arm, hold, clear, speed."""

from typing import Annotated

import typer

from cli.context import CellOption, JsonOption, cell_of, tell, waiting

Percent = Annotated[float | None, typer.Option(min=0.1, max=100.0, help="Percent.")]


def arm(
    jog: Annotated[
        bool, typer.Option("--jog", help="For moves alone: without calibration and in contact too.")
    ] = False,
    wait: Annotated[
        float,
        typer.Option(min=0.0, max=60.0, help="Wait so long [s] for a preflight that needs time."),
    ] = 3.0,
    cell: CellOption = None,
) -> None:
    """Let motion begin, after the preflight."""
    with cell_of(cell) as client, waiting("preflight"):
        tell(client.arm("jog" if jog else "all", within_s=wait))


def hold(
    reason: Annotated[str, typer.Option(help="What everybody will read.")] = "asked to hold",
    cell: CellOption = None,
) -> None:
    """Stop the motion and hold; always accepted. This is not a safety function."""
    with cell_of(cell) as client:
        tell(client.hold(reason))


def clear(cell: CellOption = None) -> None:
    """Acknowledge a hold or a fault; arming is the next step."""
    with cell_of(cell) as client:
        tell(client.clear())


def speed(
    *,
    accel: Percent = None,
    decel: Percent = None,
    modular: Percent = None,
    mechanical: Annotated[
        float | None, typer.Option(min=0.001, max=5000.0, help="Speed [mm/s].")
    ] = None,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Set the speeds of the moves to come; what is left out keeps its value. Print them all.

    The real speed is the mechanical one times the modular percentage.
    """

    def fraction(percent: float | None) -> float | None:
        return None if percent is None else percent / 100.0

    with cell_of(cell) as client:
        now = client.speed(
            accel_fraction=fraction(accel),
            decel_fraction=fraction(decel),
            modular_fraction=fraction(modular),
            mechanical_m_s=None if mechanical is None else mechanical / 1e3,
        )
    if as_json:
        print(now.model_dump_json())
        return
    real_mm_s = 1e3 * now.mechanical_m_s * now.modular_fraction
    typer.echo(
        f"moves run at {real_mm_s:.1f} mm/s: mechanical {1e3 * now.mechanical_m_s:g} mm/s, modular "
        f"{100.0 * now.modular_fraction:g} %, accel {100.0 * now.accel_fraction:g} %, "
        f"decel {100.0 * now.decel_fraction:g} %"
    )
