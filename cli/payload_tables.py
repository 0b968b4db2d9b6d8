"""Tables of a fit for `payload fit` and `calibrate`."""

from typing import Any

from rich.table import Table

from cli.tables import print_table, table_console
from common.config.payload import DOWN

Vector = list[float]
MODELS_SHOWN = 6
MOST_REMAINING_SHARE = 0.97  # a pose that reduces the deviation less than this is not recommended


def print_fit(report: dict[str, Any]) -> None:
    """Print a report of `fit_report` on the terminal."""
    console = table_console()
    title = (
        f"{report['recording']}: {report['poses']} poses, wrench in {report['wrench_axes']} axes"
    )
    table = Table("parameter", "value", "standard deviation", title=title)
    for row in found_parameters(report):
        table.add_row(*row)
    for each in (table, _pose_table(report), _model_table(report)):
        print_table(console, each)
    for line in remarks(report):
        console.print(line, markup=False)


def found_parameters(report: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return the identified parameters: name with unit, value, standard deviation if known."""
    rows = [("mass (kg)", f"{report['mass_kg']:.4f}", f"{report['mass_std_kg']:.4f}")]
    for label, key, std_key, scale, digits in (
        ("centre of mass (mm)", "com_m", "com_std_m", 1e3, 2),
        ("bias force (N)", "bias_force_N", "bias_force_std_N", 1.0, 3),
        ("bias torque (N m)", "bias_torque_Nm", "bias_torque_std_Nm", 1.0, 4),
        ("mounting (mrad)", "mounting_rotation_rad", "mounting_rotation_std_rad", 1e3, 2),
        ("gain of force", "force_gain", "force_gain_std", 1.0, 4),
    ):
        if report[std_key] is not None:
            value, std = (_joined(report[each], scale, digits) for each in (key, std_key))
            rows.append((label, value, std))
    down = report["gravity_direction_in_base"]
    if report["gravity_tilt_std_rad"] is not None or tuple(down) != DOWN:
        std_rad = report["gravity_tilt_std_rad"]
        value = _joined(down, 1.0, 4)
        std = "" if std_rad is None else f"{1e3 * std_rad:.2f} mrad"
        rows.append(("gravity direction in base", value, std))
    return rows


def remarks(report: dict[str, Any]) -> list[str]:
    """Return remarks: rejected rows, uncertain parameters, and the best next pose."""
    lines = [f"rejected {len(r['lines'])} rows: {r['reason']}" for r in report["rejected"]]
    lines += undetermined(report)
    advice = report["next_pose"]
    if is_recommended(advice):
        lines.append(
            "record next: gravity along "
            f"({_joined(advice['down_in_sensor'], 1.0, 2)}) in sensor axes; "
            f"standard deviation of {advice['parameter']} {advice['std_after']:.2g} "
            f"instead of {advice['std_before']:.2g}"
        )
    return lines


def undetermined(report: dict[str, Any]) -> list[str]:
    """Return a remark for each parameter that the poses determine poorly, or not at all."""
    lines = [f"poorly determined by these poses: {line}" for line in report["unsure"]]
    return lines + [
        f"not determined by this recording: {line}" for line in report["not_identified"]
    ]


def is_recommended(advice: dict[str, Any]) -> bool:
    """Return whether the best next pose would reduce a standard deviation noticeably."""
    return bool(advice["std_after"] <= MOST_REMAINING_SHARE * advice["std_before"])


def _pose_table(report: dict[str, Any]) -> Table:
    shown = report["residuals"]
    title = "residual of each pose"
    if len(shown) > 20:  # a long recording: only the worst are of interest
        shown = sorted(shown, key=lambda row: row["force_N"], reverse=True)[:20]
        title = f"residual of the 20 worst of {report['poses']} poses"
    table = Table("line", "force (N)", "torque (N m)", title=title)
    for row in shown:
        table.add_row(str(row["line"]), f"{row['force_N']:.3f}", f"{row['torque_Nm']:.4f}")
    table.add_section()
    for label, key in (("mean", "residual_{}_mean"), ("max", "residual_{}_max"), ("rms", "rms_{}")):
        force, torque = report[key.format("force_N")], report[key.format("torque_Nm")]
        table.add_row(label, f"{force:.3f}", f"{torque:.4f}")
    return table


def _model_table(report: dict[str, Any]) -> Table:
    table = Table("model", "rms N", "N m", "left out N", "N m", "")
    table.title = "models: rms residual, and rms of leave-one-out cross-validation"
    for model in report["models"][:MODELS_SHOWN]:
        table.add_row(
            model["name"],
            _number(model["rms_force_N"], 3),
            _number(model["rms_torque_Nm"], 4),
            _number(model["leave_one_out_force_N"], 3),
            _number(model["leave_one_out_torque_Nm"], 4),
            "used" if model["used"] else "",
        )
    return table


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _joined(values: Vector, scale: float, digits: int) -> str:
    return "  ".join(f"{scale * value:.{digits}f}" for value in values)
