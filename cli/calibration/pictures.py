"""Figures of a calibration report: residuals, compensation, attitudes."""

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from common.motion.frames import Array
from common.motion.weight import residual
from identification.evidence import Findings

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


def residual_bars(found: Findings) -> Figure:
    """Return the residuals at each fitted and each verification pose, with the limits."""
    figure, ((force, torque),) = _panels(3.4)
    groups = [("fit", found.evidence.fit.residual, FIT)]
    if found.verify_residual is not None:
        groups.append(("verification", found.verify_residual, VERIFY))
    forces = [(label, residual.force_N, colour) for label, residual, colour in groups]
    torques = [(label, 1e3 * residual.torque_Nm, colour) for label, residual, colour in groups]
    _bars(force, forces, "residual force [N]", found.bounds.force_N)
    _bars(torque, torques, "residual torque [mN m]", 1e3 * found.bounds.torque_Nm)
    force.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
    return figure


def before_after(found: Findings) -> Figure:
    """Return the components of all readings, measured and with weight and bias compensated."""
    samples = found.evidence.recording.samples(found.evidence.axes)
    payload = found.evidence.fit.payload
    R, F, M = samples.R_base_sensor, samples.force_N, samples.torque_Nm
    residual_N, residual_Nm = residual(payload, R, force_N=F, torque_Nm=M, time_s=samples.time_s)
    figure, panels = _panels(5.4, rows=2)
    first_row = found.evidence.fit.first_row
    for column, (measured, compensated, unit) in enumerate(
        ((F, residual_N, "N"), (M, residual_Nm, "N m"))
    ):
        kind = ("force", "torque")[column]
        _lines(panels[0, column], measured, first_row, f"measured {kind} [{unit}]")
        _lines(panels[1, column], compensated, first_row, f"compensated {kind} [{unit}]")
        panels[1, column].set_xlabel("reading of the fit; thick: mean of each pose")
    panels[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return figure


def attitudes(found: Findings) -> Figure:
    """Return the directions of gravity in sensor axes, on two hemispheres."""
    figure, (halves,) = _panels(3.9)
    poses = found.evidence.recording.samples(found.evidence.axes).R_base_sensor
    groups = [("fit", -poses[found.evidence.fit.first_row][:, 2, :], FIT, "o")]
    if found.evidence.verify is not None:
        down_verified = -found.evidence.verify.R_base_sensor[:, 2, :]
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
    for axis in range(3):
        axes.plot(places, values[places, axis], color=AXES_COLOURS[axis], linewidth=0.5, alpha=0.35)
        bounds = np.append(first_row, len(values))
        means = [values[a:b, axis].mean() for a, b in pairwise(bounds)]
        colour = AXES_COLOURS[axis]
        axes.stairs(means, bounds, color=colour, linewidth=1.8, label="xyz"[axis], baseline=None)
    axes.set_ylabel(label)


def _globe(axes: Axes, title: str) -> None:
    """Draw an equal-area hemisphere seen along z, with circles every 30 degrees from the pole."""
    angle_rad = np.linspace(0.0, 2.0 * np.pi, 121)
    for angle_deg in (30, 60, 90):
        radius = np.sqrt(2.0) * np.sin(np.radians(angle_deg) / 2.0)
        width = 1.2 if angle_deg == 90 else 0.5
        axes.plot(
            radius * np.cos(angle_rad), radius * np.sin(angle_rad), color="#888888", linewidth=width
        )
    axes.plot([-1, 1], [0, 0], color="#bbbbbb", linewidth=0.5)
    axes.plot([0, 0], [-1, 1], color="#bbbbbb", linewidth=0.5)
    axes.text(1.03, 0.0, "x", va="center")
    axes.text(0.0, 1.03, "y", ha="center")
    axes.set(title=title, aspect="equal", xlim=(-1.15, 1.15), ylim=(-1.15, 1.2))
    axes.set_axis_off()


def _flat(down: Array) -> Array:
    """Return unit vectors of a hemisphere in the plane (Lambert equal-area projection)."""
    return np.asarray(down[:, :2] / np.sqrt(1.0 + np.abs(down[:, 2:])))
