"""Verb `forecast`: what force control will do on a contact, before the arm is armed."""

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument, Option, echo

from cli.context import CellOption, JsonOption, find_cell_file, one_line_errors, print_note

if TYPE_CHECKING:
    from common.config.cell import CellConfig
    from tuning.forecast import ForceForecast, ForceJob
    from tuning.forecast_text import ForecastRow


def forecast(
    force: Annotated[float, Argument(metavar="NEWTON", min=0.0, max=1000.0, help="Set point.")],
    *,
    stiffness: Annotated[
        float | None,
        Option(min=1.0, max=1e7, help="Of the contact [N/m]; default: contact.stiffness_N_m."),
    ] = None,
    law: Annotated[
        Literal["plain", "adaptive"] | None, Option(help="Default: that of the cell file.")
    ] = None,
    host: Annotated[Literal["pc", "controller"], Option(help="Loop host.")] = "pc",
    speed: Annotated[
        float, Option(min=0.1, max=1000.0, help="Feed across the surface [mm/s].")
    ] = 20.0,
    slope: Annotated[
        float, Option(min=0.1, max=80.0, help="Steepest slope of the surface [degrees].")
    ] = 10.0,
    as_json: JsonOption = False,
    cell: CellOption = None,
) -> None:
    """Forecast settling, peak force and following error of a press, from the cell file and a map.

    Needs no hub, nothing moves. A forecast that breaks a limit prints a warning; a job that the map
    does not cover is refused with what is outside.
    """
    with one_line_errors():
        from common.config.load import load_cell
        from tuning import forecast as model
        from tuning.forecast_text import rows, warnings

        loaded = load_cell(find_cell_file(cell))
        job = model.ForceJob(
            force, stiffness, law, host=host, feed_m_s=speed / 1e3, slope_deg=slope
        )
        found = model.forecast(loaded, job)
        table, broken = rows(loaded, job, found), list(warnings(loaded, job, found))
    if as_json:
        print(json.dumps(_as_tree(loaded, job, found) | {"warnings": broken}))
        return
    _print_table(loaded, job, found, table)
    for text in (found.not_followed, *broken):
        if text:
            print_note(text)


def _as_tree(cell: "CellConfig", job: "ForceJob", found: "ForceForecast") -> dict[str, Any]:
    """Return a forecast for JSON, in SI units."""

    def pair(name: str) -> list[float] | None:
        interval = getattr(found, name)
        return None if interval is None else [interval.low, interval.high]

    return {
        "cell": cell.cell,
        "law": found.law,
        "stiffness_N_m": found.stiffness_N_m,
        "loop_delay_s": cell.plant.tau_s,
        "setpoint_N": job.setpoint_N,
        "feed_m_s": job.feed_m_s,
        "slope_deg": job.slope_deg,
        "settling_s": pair("settling_s"),
        "peak_N": pair("peak_N"),
        "follow_error_N": pair("follow_error_N"),
        "not_followed": found.not_followed,
        "force_limit_N": cell.limits.force_N,
    }


def _print_table(
    cell: "CellConfig", job: "ForceJob", found: "ForceForecast", rows: "list[ForecastRow]"
) -> None:
    from rich.table import Table

    from cli.tables import print_table, table_console

    echo(
        f"cell {cell.cell}: {job.setpoint_N:g} N on {found.stiffness_N_m:.3g} N/m, law "
        f"{found.law}, {1e3 * cell.plant.tau_s:.0f} ms of delay in the loop"
    )
    table = Table("quantity", "forecast", "limit", "verdict")
    for row in rows:
        interval = row.interval
        text = "-" if interval is None else f"{interval.low:.3g} to {interval.high:.3g} {row.unit}"
        limit = "" if row.limit is None else f"{row.limit:.3g} {row.unit}"
        table.add_row(row.quantity, text, limit, row.verdict)
    print_table(table_console(), table)
