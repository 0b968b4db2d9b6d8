"""`forcemesh payload`: fit what hangs below the sensor from a recording, and check a recording."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from services.wrench.recording import WrenchAxes

app = typer.Typer(no_args_is_help=True, help="Payload and sensor bias from recordings.")

Vector = list[float]
MODELS_SHOWN = 6  # beside the plain one


class AxesOption(StrEnum):
    """Axes in which a recording holds its wrench."""

    AUTO = "auto"
    SENSOR = "sensor"
    BASE = "base"


RecordingArgument = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="CSV with t,x,y,z,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz.",
        show_default=False,
    ),
]
Axes = Annotated[AxesOption, typer.Option(help="Axes of the recorded wrench; auto: find out.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.command()
def fit(
    recording: RecordingArgument,
    wrench_axes: Axes = AxesOption.AUTO,
    out: Annotated[Path | None, typer.Option(help="Write the payload to this YAML file.")] = None,
    as_json: Json = False,
) -> None:
    """Fit mass, centre of mass and bias from static poses, free of contact."""
    with _one_line_errors():
        from common.payload import save
        from services.wrench.identification import identify_recording
        from services.wrench.recording import read_recording
        from services.wrench.report import fit_report

        data = read_recording(recording)
        axes, found, reason = identify_recording(data, _named(wrench_axes))
        report = fit_report(data, axes, found)
        if out is not None:
            save(found.payload, out)
    if reason:
        _say(reason)
    for warning in report["warnings"]:
        _say(f"warning: {warning}")
    if out is not None:
        _say(f"payload written to {out}")
    if as_json:
        print(json.dumps(report, allow_nan=False))
    else:
        _print_fit(report)


@app.command()
def check(
    recording: RecordingArgument,
    payload: Annotated[Path, typer.Option(help="Payload file that `fit --out` wrote.")],
    wrench_axes: Axes = AxesOption.AUTO,
    as_json: Json = False,
) -> None:
    """Print the force and torque that a payload leaves unexplained in a recording."""
    with _one_line_errors():
        from common.payload import load
        from services.wrench.recording import read_recording
        from services.wrench.report import check_report

        data, known = read_recording(recording), load(payload)
        axes = _named(wrench_axes)
        if axes is None:
            from services.wrench.identification import axes_of

            axes, reason = axes_of(data, known)
            _say(reason)
        report = check_report(data, axes, known)
        other = check_report(data, "sensor" if axes == "base" else "base", known)
    _warn_of_other_axes(report, other)
    if as_json:
        print(json.dumps(report, allow_nan=False))
    else:
        _print_check(report)


def _named(option: AxesOption) -> "WrenchAxes | None":
    if option is AxesOption.AUTO:
        return None
    return "sensor" if option is AxesOption.SENSOR else "base"


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """Turn an error of the user's data into one line on standard error and exit code 2."""
    from common.errors import DataError

    try:
        yield
    except DataError as error:
        _say(f"error: {error}")
        raise typer.Exit(2) from error


def _say(text: str) -> None:
    typer.echo(text, err=True)


def _warn_of_other_axes(taken: dict[str, Any], other: dict[str, Any]) -> None:
    """Say so when the axes that were not taken explain the recording far better."""
    keys = ("residual_force_N_mean", "residual_torque_Nm_mean")
    if all(taken[key] > 2.0 * other[key] for key in keys):
        _say(
            f"warning: residual {taken[keys[0]]:.3g} N, {taken[keys[1]]:.3g} N·m in "
            f"{taken['wrench_axes']} axes, but only {other[keys[0]]:.3g} N, "
            f"{other[keys[1]]:.3g} N·m in {other['wrench_axes']} axes: "
            f"use --wrench-axes {other['wrench_axes']}"
        )


def _print_fit(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    title = (
        f"{report['recording']}: {report['poses']} poses, wrench in {report['wrench_axes']} axes"
    )
    table = Table("parameter", "value", "standard deviation", title=title)
    table.add_row("mass (kg)", f"{report['mass_kg']:.4f}", f"{report['mass_std_kg']:.4f}")
    for label, key, std_key, scale, digits in (
        ("centre of mass (mm)", "com_m", "com_std_m", 1e3, 2),
        ("bias force (N)", "bias_force_N", "bias_force_std_N", 1.0, 3),
        ("bias torque (N·m)", "bias_torque_Nm", "bias_torque_std_Nm", 1.0, 4),
        ("mounting (mrad)", "mounting_rotation_rad", "mounting_rotation_std_rad", 1e3, 2),
        ("gain of force", "force_gain", "force_gain_std", 1.0, 4),
        ("gain of torque", "torque_gain", "torque_gain_std", 1.0, 4),
    ):
        if report[std_key] is not None:
            table.add_row(
                label, _joined(report[key], scale, digits), _joined(report[std_key], scale, digits)
            )
    if report["gravity_tilt_std_rad"] is not None or report["gravity_direction_in_base"][2] > 0:
        std = report["gravity_tilt_std_rad"]
        table.add_row(
            "gravity direction in base",
            _joined(report["gravity_direction_in_base"], 1.0, 4),
            "" if std is None else f"{1e3 * std:.2f} mrad",
        )
    if report["drift"] is not None:
        drift = report["drift"]
        table.add_row("drift of force (N)", _joined(drift["force_N"], 1.0, 3), "")
        table.add_row("drift of torque (N·m)", _joined(drift["torque_Nm"], 1.0, 4), "")
    console.print(table)
    console.print(_pose_table(report))
    console.print(_model_table(report))
    for line in _remarks(report):
        console.print(line, markup=False)


def _remarks(report: dict[str, Any]) -> list[str]:
    """Return what is left to say: what was left out, what is unsure, and what to record next."""
    lines = [f"left out {len(r['lines'])} rows: {r['reason']}" for r in report["rejected"]]
    lines += [f"hardly told by these poses: {line}" for line in report["unsure"]]
    lines += [f"not told by this recording: {line}" for line in report["untold"]]
    advice = report["next_pose"]
    lines.append(
        "record next: gravity along "
        f"({_joined(advice['down_in_sensor'], 1.0, 2)}) in sensor axes; "
        f"{advice['parameter']} would be sure to {advice['std_after']:.2g} "
        f"instead of {advice['std_before']:.2g}"
    )
    return lines


def _pose_table(report: dict[str, Any]) -> Any:
    from rich.table import Table

    shown = report["residuals"]
    title = "residual of each pose"
    if len(shown) > 20:  # a long recording: the worst are what one looks for
        shown = sorted(shown, key=lambda row: row["force_N"], reverse=True)[:20]
        title = f"residual of the 20 worst of {report['poses']} poses"
    table = Table("line", "force (N)", "torque (N·m)", title=title)
    for row in shown:
        table.add_row(str(row["line"]), f"{row['force_N']:.3f}", f"{row['torque_Nm']:.4f}")
    table.add_section()
    for label, key in (("mean", "residual_{}_mean"), ("max", "residual_{}_max"), ("rms", "rms_{}")):
        force, torque = report[key.format("force_N")], report[key.format("torque_Nm")]
        table.add_row(label, f"{force:.3f}", f"{torque:.4f}")
    return table


def _model_table(report: dict[str, Any]) -> Any:
    from rich.table import Table

    table = Table("model", "rms N", "N·m", "left out N", "N·m", "cond.", "verdict")
    table.title = "models tried: rms residual, and rms on poses left out of the fit"
    plain, *richer = report["models"]
    best = sorted(richer, key=lambda model: model["evidence"], reverse=True)
    for model in (plain, *best[:MODELS_SHOWN]):
        table.add_row(
            model["name"],
            _number(model["rms_force_N"], 3),
            _number(model["rms_torque_Nm"], 4),
            _number(model["leave_one_out_force_N"], 3),
            _number(model["leave_one_out_torque_Nm"], 4),
            _number(model["conditioning"], 1),
            model["verdict"],
        )
    return table


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _print_check(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    title = f"{report['recording']}: {report['rows']} rows, wrench in {report['wrench_axes']} axes"
    table = Table("residual", "mean", "max", "line of the max", title=title)
    for label, key, line in (
        ("force (N)", "residual_force_N", "worst_force_line"),
        ("torque (N·m)", "residual_torque_Nm", "worst_torque_line"),
    ):
        mean, worst = report[f"{key}_mean"], report[f"{key}_max"]
        table.add_row(label, f"{mean:.4f}", f"{worst:.4f}", str(report[line]))
    console = Console()
    console.print(table)
    if report["drift"] != "none":
        still = report["residual_force_N_mean_without_drift"]
        console.print(f"drift of the fit: {report['drift']}; without it {still:.4f} N mean")


def _joined(values: Vector, scale: float, digits: int) -> str:
    return "  ".join(f"{scale * value:.{digits}f}" for value in values)
