"""The pictures of a calibration's report, as SVG text: residuals, before and after, attitudes."""

from io import StringIO
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cli.calibration.evidence import Findings
from common.frames import Array
from common.payload import residual

FIT, VERIFY, LIMIT = "#4878a8", "#e08a3c", "#b03030"
AXES_COLOURS = ("#c0504d", "#5a9a4a", "#4878a8")
MOST_BARS = 40
STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "svg.hashsalt": "forcemesh",  # the same calibration, the same picture
}


def residual_bars(found: Findings) -> Figure:
    """Return what is left at each pose of the fit, and at each fresh one, beside the limits."""
    figure = _figure(3.4)
    force, torque = figure.subplots(1, 2)
    groups = [("fit", found.fit_left, FIT)]
    if found.verify_left is not None:
        groups.append(("verification", found.verify_left, VERIFY))
    forces = [(label, left.force_N, colour) for label, left, colour in groups]
    torques = [(label, 1e3 * left.torque_Nm, colour) for label, left, colour in groups]
    _bars(force, forces, "force left (N)", found.bounds.force_N)
    _bars(torque, torques, "torque left (mN·m)", 1e3 * found.bounds.torque_Nm)
    force.legend(loc="upper left", fontsize=9, frameon=False)
    return figure


def before_after(found: Findings) -> Figure:
    """Return the force components of all readings, as read and with weight and bias taken off."""
    samples = found.evidence.recording.samples(found.evidence.axes)
    payload = found.evidence.fit.payload
    R, F, M = samples.R_base_sensor, samples.force_N, samples.torque_Nm
    left_N, left_Nm = residual(payload, R, force_N=F, torque_Nm=M, time_s=samples.time_s)
    figure = _figure(5.2)
    panels = figure.subplots(2, 2, sharex=True)
    for column, (read, left, unit) in enumerate(((F, left_N, "N"), (M, left_Nm, "N·m"))):
        kind = ("force", "torque")[column]
        _lines(panels[0, column], read, f"{kind} as read ({unit})")
        _lines(panels[1, column], left, f"{kind} compensated ({unit})")
        panels[1, column].set_xlabel("reading of the fit")
    panels[0, 0].legend(loc="upper left", ncols=3, fontsize=9, frameon=False)
    return figure


def attitudes(found: Findings) -> Figure:
    """Return the directions of gravity in sensor axes, on the two halves of the sphere."""
    figure = _figure(3.9)
    halves = figure.subplots(1, 2)
    poses = found.evidence.recording.samples(found.evidence.axes).R_base_sensor
    groups = [("fit", -poses[found.evidence.fit.first_row][:, 2, :], FIT, "o")]
    if found.evidence.verify is not None:
        fresh = -found.evidence.verify.R_base_sensor[:, 2, :]
        groups.append(("verification", fresh, VERIFY, "s"))
    advised = np.array([found.report["next_pose"]["down_in_sensor"]])
    groups.append(("next pose advised", advised, LIMIT, "*"))
    for half, sign, title in ((halves[0], 1.0, "towards +z"), (halves[1], -1.0, "towards -z")):
        _globe(half, f"gravity {title} of the sensor")
        for label, down, colour, marker in groups:
            shown = _flat(down[sign * down[:, 2] >= 0.0])
            half.scatter(*shown.T, c=colour, marker=marker, s=48, label=label, zorder=3)
    halves[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=9, frameon=False)
    return figure


def svg_of(figure: Figure) -> str:
    """Return a figure as SVG text, its letters as outlines: it needs nothing from outside."""
    out = StringIO()
    with rc_context(STYLE):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _figure(height: float) -> Figure:
    with rc_context(STYLE):
        return Figure(figsize=(9.2, height), layout="constrained")


def _bars(axes: Axes, groups: list[tuple[str, Array, str]], label: str, limit: float) -> None:
    """Draw a bar for each pose; of very many the largest."""
    start = 1
    for text, values, colour in groups:
        height = values if len(values) <= MOST_BARS else np.sort(values)[::-1][:MOST_BARS]
        axes.bar(np.arange(start, start + len(height)), height, color=colour, label=text)
        start += len(height)
    axes.axhline(limit, color=LIMIT, linewidth=1.2, linestyle="--")
    axes.text(start - 0.4, limit, f"limit {limit:g}", color=LIMIT, ha="right", va="bottom")
    axes.set(xlabel="pose", ylabel=label, xlim=(0.3, start - 0.3))
    axes.set_ylim(0.0, 1.2 * max(limit, *(values.max() for _, values, _ in groups)))
    axes.grid(visible=False, axis="x")


def _lines(axes: Axes, values: Array, label: str) -> None:
    for axis in range(3):
        axes.plot(values[:, axis], color=AXES_COLOURS[axis], linewidth=0.9, label="xyz"[axis])
    axes.set_ylabel(label)


def _globe(axes: Axes, title: str) -> None:
    """Draw half a sphere seen along z, areas kept: circles each 30 degrees from the pole."""
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    for angle_deg in (30, 60, 90):
        radius = np.sqrt(2.0) * np.sin(np.radians(angle_deg) / 2.0)
        width = 1.2 if angle_deg == 90 else 0.5
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="#888888", linewidth=width)
    axes.plot([-1, 1], [0, 0], color="#bbbbbb", linewidth=0.5)
    axes.plot([0, 0], [-1, 1], color="#bbbbbb", linewidth=0.5)
    axes.text(1.03, 0.0, "x", va="center")
    axes.text(0.0, 1.03, "y", ha="center")
    axes.set(title=title, aspect="equal", xlim=(-1.15, 1.15), ylim=(-1.15, 1.2))
    axes.set_axis_off()


def _flat(down: Array) -> Array:
    """Return unit vectors of one half of the sphere on a plane, areas kept (Lambert)."""
    return np.asarray(down[:, :2] / np.sqrt(1.0 + np.abs(down[:, 2:])))
