"""Verbs `payload fit` and `payload check`: identification of the payload from a recording."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument, Option, Typer

from cli.context import one_line_errors, print_note

if TYPE_CHECKING:
    from identification.recording import WrenchAxes

app = Typer(no_args_is_help=True, help="Payload and sensor bias from recordings.")

AxesOption = Literal["auto", "sensor", "base"]
RecordingArgument = Annotated[
    Path,
    Argument(metavar="RECORDING", help="CSV with t,x,y,z,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz."),
]
Axes = Annotated[AxesOption, Option(help="Axes of the recorded wrench; auto: detect.")]
Json = Annotated[bool, Option("--json", help="Print one JSON object.")]


@app.command()
def fit(  # noqa: PLR0917 - options of a verb, given by name
    recording: RecordingArgument,
    wrench_axes: Axes = "auto",
    gravity: Annotated[
        tuple[float, float, float] | None,
        Option(
            metavar="X Y Z",
            help="Nominal direction of gravity in the base, unless another fits far better.",
        ),
    ] = None,
    out: Annotated[Path | None, Option(help="Write the payload to this YAML file.")] = None,
    as_json: Json = False,
) -> None:
    """Fit mass, centre of mass and bias from static poses, free of contact."""
    with one_line_errors():
        import numpy as np

        from cli.payload_tables import print_fit
        from common.config.payload import DOWN, save
        from forcemesh.records import checked_unit
        from identification.identify import identify_recording
        from identification.installation.check import judge_recording
        from identification.installation.terms import ExpectedInstallation
        from identification.recording import read_recording
        from identification.report import fit_report

        data = read_recording(recording)
        down = DOWN if gravity is None else checked_unit(gravity, "--gravity")
        axes, found, reason = identify_recording(data, named_axes(wrench_axes), down)
        report = fit_report(data, axes, found)
        expected = ExpectedInstallation(down_in_base=np.array(down))
        # A payload can explain some wrong axes: the residual alone does not reveal them.
        installation = judge_recording(data, axes, expected)[1]
        if installation.rejection_reason is not None:
            report["warnings"].append(installation.rejection_reason)
        if out is not None:
            save(found.payload, out)
    if reason:
        print_note(reason)
    for warning in report["warnings"]:
        print_note(f"warning: {warning}")
    if out is not None:
        print_note(f"payload written to {out}")
    if as_json:
        print(json.dumps(report, allow_nan=False))
    else:
        print_fit(report)


@app.command()
def check(
    recording: RecordingArgument,
    payload: Annotated[Path, Option(help="Payload file that `fit --out` wrote.")],
    wrench_axes: Axes = "auto",
    as_json: Json = False,
) -> None:
    """Print the force and torque that a payload leaves unexplained in a recording."""
    with one_line_errors():
        from common.config.payload import Payload
        from forcemesh.yaml_file import read_model
        from identification.recording import read_recording
        from identification.report import check_report

        data, known = read_recording(recording), read_model(Payload, payload)
        axes = named_axes(wrench_axes)
        if axes is None:
            from identification.identify import axes_of

            axes, reason = axes_of(data, known)
            print_note(reason)
        report = check_report(data, axes, known)
        other_report = check_report(data, "sensor" if axes == "base" else "base", known)
    _warn_of_other_axes(report, other_report)
    if as_json:
        print(json.dumps(report, allow_nan=False))
    else:
        _print_check(report)


def named_axes(option: AxesOption) -> "WrenchAxes | None":
    """Return the axes that an option names; None: detect them."""
    return None if option == "auto" else option


def _warn_of_other_axes(used_report: dict[str, Any], other_report: dict[str, Any]) -> None:
    """Warn when the axes that were not used explain the recording far better."""
    keys = ("residual_force_N_mean", "residual_torque_Nm_mean")
    if all(used_report[key] > 2.0 * other_report[key] for key in keys):
        print_note(
            f"warning: residual {used_report[keys[0]]:.3g} N, {used_report[keys[1]]:.3g} N m in "
            f"{used_report['wrench_axes']} axes, but only {other_report[keys[0]]:.3g} N, "
            f"{other_report[keys[1]]:.3g} N m in {other_report['wrench_axes']} axes: "
            f"use --wrench-axes {other_report['wrench_axes']}"
        )


def _print_check(report: dict[str, Any]) -> None:
    from rich.table import Table

    from cli.tables import print_table, table_console

    title = f"{report['recording']}: {report['rows']} rows, wrench in {report['wrench_axes']} axes"
    table = Table("residual", "mean", "max", "line of the max", title=title)
    for label, key, line in (
        ("force (N)", "residual_force_N", "worst_force_line"),
        ("torque (N m)", "residual_torque_Nm", "worst_torque_line"),
    ):
        mean, largest = report[f"{key}_mean"], report[f"{key}_max"]
        table.add_row(label, f"{mean:.4f}", f"{largest:.4f}", str(report[line]))
    print_table(table_console(), table)
