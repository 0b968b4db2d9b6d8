"""Report page of a calibration: one self-contained HTML file, with its figures."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cli.pages import picture, table, write_page
from cli.payload_tables import found_parameters, is_recommended, undetermined
from common.motion.frames import Array
from common.motion.weight import residual
from identification.evidence import Findings
from services.panel.markup import Html, filled_page, html, joined

MODELS_ON_PAGE = 7
RESIDUAL_HEADER = ["", "poses", "force, mean [N]", "max [N]", "torque, mean [N m]", "max [N m]"]
METHODS = {
    "arm": "the wizard moved the arm",
    "manual": "a person moved the arm",
    "recording": "from a recording",
}
FIT, VERIFY, LIMIT = "#4878a8", "#e08a3c", "#b03030"
AXES_COLOURS = ("#c0504d", "#5a9a4a", "#4878a8")
MOST_BARS = 40
MOST_PLOTTED_POINTS = 1200
STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
}


def save_page(found: Findings, path: Path) -> None:
    """Write the page. Raises DataError when it cannot be written."""
    write_page(page(found), path)


def page(found: Findings) -> Html:
    """Return the page."""
    report = found.report
    return filled_page(
        "cli.calibration",
        "calibration.html",
        title=f"Calibration of {found.section.cell}",
        result=found.verdict.result,
        verdict=found.verdict.text,
        origin=table([], _origin(found)),
        residual_bars=picture("residuals at each pose", residual_bars(found)),
        residuals=table(RESIDUAL_HEADER, _residual_rows(found)),
        parameters=table(["parameter", "value", "standard deviation"], found_parameters(report)),
        conditioning=f"{report['conditioning']:.1f}",
        before_after=picture("readings before and after compensation", before_after(found)),
        attitudes=picture("directions of gravity in sensor axes", attitudes(found)),
        advice=_advice(report),
        models=table(["model", "rms [N]", "rms [N m]", ""], _models(report)),
        remarks=joined(html("<li>{}</li>", line) for line in _remarks(found)),
    )


def _origin(found: Findings) -> list[list[str]]:
    section, report = found.section, found.report
    file_name = Path(report["recording"]).name  # without its folder: both files may be moved
    return [
        ["cell", section.cell],
        ["tool", section.tool or "unnamed"],
        ["sensor", section.sensor or "serial number unknown"],
        ["made at", section.made_at.isoformat(sep=" ")],
        ["revision", section.revision],
        ["method", METHODS[section.method]],
        ["readings", f"{report['rows']} at {report['poses']} poses, {file_name}"],
    ]


def _residual_rows(found: Findings) -> list[list[str]]:
    rows = []
    for name, left in (("fit", found.section.fit), ("verification", found.section.verified)):
        if left is not None:
            forces = [f"{v:.3f}" for v in (left.force_mean_N, left.force_max_N)]
            torques = [f"{v:.4f}" for v in (left.torque_mean_Nm, left.torque_max_Nm)]
            rows.append([name, str(left.poses), *forces, *torques])
    return rows


def _models(report: dict[str, Any]) -> list[list[str]]:
    return [
        [
            model["name"],
            f"{model['rms_force_N']:.4f}",
            f"{model['rms_torque_Nm']:.5f}",
            "used" if model["used"] else "",
        ]
        for model in report["models"][:MODELS_ON_PAGE]
    ]


def _advice(report: dict[str, Any]) -> str:
    advice = report["next_pose"]
    if not is_recommended(advice):
        return "No further pose would reduce the deviation of any parameter considerably."
    down = ", ".join(f"{part:.2f}" for part in advice["down_in_sensor"])
    return (
        f"The most informative next pose has gravity along ({down}) in sensor axes: it would "
        f"reduce the standard deviation of {advice['parameter']} from "
        f"{advice['std_before']:.2g} to {advice['std_after']:.2g}."
    )


def _remarks(found: Findings) -> list[str]:
    report = found.report
    lines = [*found.evidence.notes, *(f"warning: {text}" for text in report["warnings"])]
    lines += [f"left out {len(r['lines'])} readings: {r['reason']}" for r in report["rejected"]]
    lines += undetermined(report)
    return lines or ["none: every reading was used, every parameter is determined"]


# --- figures --------------------------------------------------------------------------------------


def residual_bars(found: Findings) -> Figure:
    """Return the residuals at each fitted and each verification pose, with the limits."""
    figure, ((force, torque),) = _panels(3.4)
    groups = [("fit", found.evidence.fit.residual, FIT)]
    if found.verify_residual is not None:
        groups.append(("verification", found.verify_residual, VERIFY))
    forces = [(label, left.force_N, colour) for label, left, colour in groups]
    torques = [(label, 1e3 * left.torque_Nm, colour) for label, left, colour in groups]
    _bars(force, forces, "residual force [N]", found.bounds.force_N)
    _bars(torque, torques, "residual torque [mN m]", 1e3 * found.bounds.torque_Nm)
    force.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
    return figure


def before_after(found: Findings) -> Figure:
    """Return the components of all readings, measured and with weight and bias compensated."""
    samples = found.evidence.recording.samples(found.evidence.axes)
    payload = found.evidence.fit.payload
    R, F, M = samples.R_base_sensor, samples.force_N, samples.torque_Nm
    residual_N, residual_Nm = residual(payload, R, force_N=F, torque_Nm=M)
    figure, panels = _panels(5.4, rows=2)
    first_row = found.evidence.fit.first_row
    for column, measured, compensated, quantity in (
        (0, F, residual_N, "force [N]"),
        (1, M, residual_Nm, "torque [N m]"),
    ):
        _lines(panels[0, column], measured, first_row, f"measured {quantity}")
        _lines(panels[1, column], compensated, first_row, f"compensated {quantity}")
        panels[1, column].set_xlabel("reading of the fit; thick: mean of each pose")
    panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return figure


def attitudes(found: Findings) -> Figure:
    """Return the directions of gravity in sensor axes, on two hemispheres."""
    figure, (halves,) = _panels(3.9)
    poses = found.evidence.recording.samples(found.evidence.axes).R_base_sensor
    down_in_base = np.array(found.section.payload.gravity_direction_in_base)
    groups = [("fit", down_in_base @ poses[found.evidence.fit.first_row], FIT, "o")]
    if found.evidence.verify is not None:
        down_verified = down_in_base @ found.evidence.verify.R_base_sensor
        groups.append(("verification", down_verified, VERIFY, "s"))
    advised = np.array([found.report["next_pose"]["down_in_sensor"]])
    groups.append(("recommended next pose", advised, LIMIT, "*"))
    for half, sign, title in ((halves[0], 1.0, "towards +z"), (halves[1], -1.0, "towards -z")):
        _globe(half, f"gravity {title} of the sensor")
        for label, down, colour, marker in groups:
            shown = _flat(down[sign * down[:, 2] >= 0.0])
            half.scatter(*shown.T, c=colour, marker=marker, s=48, label=label, zorder=3)
    halves[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=9, frameon=False)
    return figure


def _panels(height: float, rows: int = 1) -> tuple[Figure, Any]:
    """Return a figure with two columns of panels, shape (rows, 2)."""
    with rc_context(STYLE):
        figure = Figure(figsize=(9.2, height), layout="constrained")
        return figure, figure.subplots(rows, 2, squeeze=False, sharex=rows > 1)


def _bars(axes: Axes, groups: list[tuple[str, Array, str]], label: str, limit: float) -> None:
    """Draw a bar for each pose, at most the MOST_BARS largest."""
    start = 1
    for text, values, colour in groups:
        height = values if len(values) <= MOST_BARS else np.sort(values)[::-1][:MOST_BARS]
        axes.bar(np.arange(start, start + len(height)), height, color=colour, label=text)
        start += len(height)
    smallest = min(limit, *(values.min() for _, values, _ in groups))
    axes.set_yscale("log")  # residuals of a good fit are far below the limit
    axes.yaxis.set_major_formatter("{x:g}")
    axes.axhline(limit, color=LIMIT, linewidth=1.2, linestyle="--")
    axes.text(start - 0.4, limit, f"limit {limit:g}", color=LIMIT, ha="right", va="bottom")
    axes.set(xlabel="pose", ylabel=label, xlim=(0.3, start - 0.3))
    largest = max(limit, *(values.max() for _, values, _ in groups))
    axes.set_ylim(max(0.5 * smallest, 1e-4 * limit), 2.0 * largest)
    axes.grid(visible=False, axis="x")


def _lines(axes: Axes, values: Array, first_row: npt.NDArray[np.intp], label: str) -> None:
    """Draw three components, and their mean over each used pose as a thick line."""
    places = np.arange(0, len(values), 1 + len(values) // MOST_PLOTTED_POINTS)
    bounds = np.append(first_row, len(values))
    for name, colour, column in zip("xyz", AXES_COLOURS, values.T, strict=True):
        axes.plot(places, column[places], color=colour, linewidth=0.5, alpha=0.35)
        means = [column[a:b].mean() for a, b in pairwise(bounds)]
        axes.stairs(means, bounds, color=colour, linewidth=1.8, label=name, baseline=None)
    axes.set_ylabel(label)


def _globe(axes: Axes, title: str) -> None:
    """Draw an equal-area hemisphere seen along z, with circles every 30 degrees from the pole."""
    for angle_deg, width in ((30, 0.5), (60, 0.5), (90, 1.2)):
        radius = np.sqrt(2.0) * np.sin(np.radians(angle_deg) / 2.0)
        axes.add_patch(Circle((0, 0), radius, fill=False, color="#888888", linewidth=width))
    axes.plot([-1, 1], [0, 0], color="#bbbbbb", linewidth=0.5)
    axes.plot([0, 0], [-1, 1], color="#bbbbbb", linewidth=0.5)
    axes.text(1.03, 0.0, "x", va="center")
    axes.text(0.0, 1.03, "y", ha="center")
    axes.set(title=title, aspect="equal", xlim=(-1.15, 1.15), ylim=(-1.15, 1.2))
    axes.set_axis_off()


def _flat(down: Array) -> Array:
    """Return unit vectors of a hemisphere in the plane (Lambert equal-area projection)."""
    return np.asarray(down[:, :2] / np.sqrt(1.0 + np.abs(down[:, 2:])))
