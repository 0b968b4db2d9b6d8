"""Plot of the demo over time; on a tilted plate also the contact, in the plane of the plate."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from cli.demo.measures import Surface
from cli.demo.scenario import (
    SETTLED_FORCE_N,
    SETTLED_TORQUE_NM,
    ScenarioPlan,
    ScenarioSample,
    Trace,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.typing import HashableList

LEVEL_DEG = 0.1  # below this tilt there is nothing to lay flat
PRESSED_N = 5.0  # the contact is drawn from this force on: a weaker one does not locate it
FLAT: "list[HashableList[str]]" = [["force"], ["torque"], ["height"]]
TILTED: "list[HashableList[str]]" = [["force", "plane"], ["torque", "plane"], ["height", "angle"]]


def plot(trace: Trace, plan: ScenarioPlan, surface: Surface, path: Path) -> None:
    """Write force, torque and height over time, and the contact on a tilted plate, as a PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    samples = trace.press + trace.work
    t_s = [sample.t_s for sample in samples]
    is_tilted = np.degrees(np.arccos(surface.normal[2])) > LEVEL_DEG
    figure, axes = plt.subplot_mosaic(
        TILTED if is_tilted else FLAT, figsize=(14 if is_tilted else 9, 8), layout="constrained"
    )
    over_time = [axes[name] for name in ("force", "torque", "height")]
    _draw_force(axes["force"], t_s, samples, plan)
    _draw_torque(axes["torque"], t_s, samples)
    lift_mm = [surface.lift_off_m(sample) * 1e3 for sample in samples]
    axes["height"].plot(t_s, lift_mm, color="tab:gray", label="disc above the unloaded plate")
    axes["height"].axhline(0.0, color="black", linewidth=0.8)
    axes["height"].set(ylabel="height [mm]", xlabel="time since force feedback began [s]")
    if is_tilted:
        _draw_plane(axes["plane"], trace, surface)
        angle_deg = [surface.misalignment_deg(sample) for sample in samples]
        axes["angle"].plot(t_s, angle_deg, color="tab:purple", label="disc to plate")
        axes["angle"].set(ylabel="angle [deg]", xlabel="time since force feedback began [s]")
        axes["angle"].set_ylim(bottom=0.0)
        over_time.append(axes["angle"])
    for each in over_time:
        if each is not axes["force"]:
            each.sharex(axes["force"])
        _mark(each, trace)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_force(
    axes: "Axes", t_s: list[float], samples: list[ScenarioSample], plan: ScenarioPlan
) -> None:
    axes.plot(t_s, [sample.force for sample in samples], color="tab:blue", label="|F|")
    axes.axhline(plan.setpoint_N, color="black", linewidth=0.8, label="set point")
    band = (plan.setpoint_N - SETTLED_FORCE_N, plan.setpoint_N + SETTLED_FORCE_N)
    axes.axhspan(*band, color="tab:green", alpha=0.2, label="settled band")
    axes.set(ylabel="force [N]", title=f"Main task, mode {plan.mode}: press, then force feedback")


def _draw_torque(axes: "Axes", t_s: list[float], samples: list[ScenarioSample]) -> None:
    axes.plot(t_s, [sample.torque for sample in samples], color="tab:orange", label="|M|")
    axes.axhspan(0.0, SETTLED_TORQUE_NM, color="tab:green", alpha=0.2, label="settled band")
    axes.set(ylabel="torque about the TCP [N m]")


def _draw_plane(axes: "Axes", trace: Trace, surface: Surface) -> None:
    """Draw the path of the contact and the disc at the end, in the plane of the plate."""
    from matplotlib.patches import Circle

    for samples, colour, label in (
        (trace.work, "tab:red", "contact under force feedback"),
        (trace.press, "tab:gray", "contact while pressing"),
    ):
        points_m = [surface.contact_m(each) for each in samples if each.force > PRESSED_N]
        if points_m:
            x_mm, y_mm = 1e3 * surface.in_plane_m(np.array(points_m)).T
            axes.plot(x_mm, y_mm, color=colour, marker=".", markersize=3, label=label)
    T_base_tcp = pin.SE3(trace.work[-1].T_base_flange) * surface.T_flange_tcp
    middle_mm = 1e3 * surface.in_plane_m(np.asarray(T_base_tcp.translation))
    radius_mm = 1e3 * surface.disc_radius_m
    axes.add_patch(Circle(tuple(middle_mm), radius_mm, fill=False, color="tab:blue", label="disc"))
    axes.plot(*middle_mm, "+", color="tab:blue", label="centre of the disc (TCP)")
    axes.set(
        title="Contact in the plane of the plate",
        xlabel="x along the plate [mm]",
        ylabel="y along the plate [mm]",
        aspect="equal",
    )
    axes.margins(0.15)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower left", fontsize=8)


def _mark(axes: "Axes", trace: Trace) -> None:
    """Mark the start of force feedback and the settling."""
    axes.axvline(0.0, color="tab:red", linestyle=":", label="force feedback starts")
    if trace.settled_at_s is not None:
        axes.axvline(trace.settled_at_s, color="tab:green", linestyle=":", label="settled")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize=8)
