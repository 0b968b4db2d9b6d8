"""Measures of a trace of the main task, with their table, plot and picture."""

from dataclasses import dataclass
from math import hypot
from pathlib import Path

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.typing import HashableList
from rich.table import Column, Table

from cli.demo.scenario import (
    SETTLED_FORCE_N,
    SETTLED_TORQUE_NM,
    ScenarioPlan,
    ScenarioSample,
    Trace,
)
from common.motion.contact_point import contact_point_m
from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from sim.robot.plate import lift_off_m
from sim.robot.settings import SimSettings

FINAL_WINDOW_S = 0.5
# Averages over 8 ms against the sensor's noise, without the first 15 ms, in which the inertia of
# the tool is measured as force.
MEAN_WINDOW_S = 0.008
IGNORE_FIRST_S = 0.015
# fmt: off
LABELS = {  # of the numbers of robot/health in the table
    "framed_round_trip_p50_s": "command to acknowledgement, p50 [s]",
    "framed_round_trip_p99_s": "command to acknowledgement, p99 [s]",
    "taken_round_trip_p50_s": "command to execution, p50 [s]",
    "taken_round_trip_p99_s": "command to execution, p99 [s]",
    "streamed_round_trip_p50_s": "streamed command to execution, p50 [s]",
    "program_loop_hz": "program loop rate [1/s]",
    "sender_hz": "report rate [1/s]",
    "monitor_speed_fraction": "monitor speed [1]",
    "any_peer_may_connect": "any peer may connect",
}
# fmt: on
LEVEL_DEG = 0.1  # below this tilt there is nothing to lay flat
PRESSED_N = 5.0  # the contact is drawn from this force on: a weaker one does not locate it
FLAT: "list[HashableList[str]]" = [["force"], ["torque"], ["height"]]
TILTED: "list[HashableList[str]]" = [["force", "plane"], ["torque", "plane"], ["height", "angle"]]


@dataclass(frozen=True, slots=True)
class Surface:
    """Unloaded plate and the disc above it: the true start of contact."""

    point_m: Array
    normal: Array
    disc_radius_m: float
    stiffness_N_m: float
    T_flange_tcp: pin.SE3

    def lift_off_m(self, sample: ScenarioSample) -> float:
        """Distance of the disc's lowest point to the plate at rest; positive is free [m]."""
        return lift_off_m(
            sample.T_base_flange * self.T_flange_tcp,
            plate_point_m=self.point_m,
            plate_normal=self.normal,
            disc_radius_m=self.disc_radius_m,
        )

    def misalignment_deg(self, sample: ScenarioSample) -> float:
        """Angle between the disc's axis and the plate's normal [degrees]."""
        T_base_tcp = sample.T_base_flange * self.T_flange_tcp
        cosine = -float(self.normal @ T_base_tcp.rotation[:, 2])
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def contact_m(self, sample: ScenarioSample) -> Array:
        """Point at which the force acts on the disc, in base [m]. Shape (3,)."""
        T_base_tcp = sample.T_base_flange * self.T_flange_tcp
        from_tcp_m = contact_point_m(T_base_tcp.rotation, sample.force_N, sample.torque_Nm)
        return np.asarray(T_base_tcp.translation + from_tcp_m)

    def in_plane_m(self, p_base_m: Array) -> Array:
        """Coordinates of points in the plane of the plate, true to length [m]. Shape (..., 2).

        The first axis is base x turned into the plane, the second one the normal times the first.
        """
        x = np.array([1.0, 0.0, 0.0]) - self.normal[0] * self.normal
        x /= hypot(*x)
        return np.asarray(
            (p_base_m - self.point_m) @ np.column_stack([x, np.cross(self.normal, x)])
        )


@dataclass(frozen=True, slots=True)
class Result:
    """Measures of one demo run."""

    settled: bool
    peak_force_N: float
    settling_s: float | None
    overshoot_pct: float
    final_force_N: float
    final_torque_Nm: float
    misalignment_deg: float
    lift_off_mm: float  # largest, positive is free of contact
    tau_s: float
    chain_latency_us_p50: float | None
    chain_latency_us_p99: float | None
    hops_us: dict[str, tuple[float, float]]  # p50, p99 from one stage to the next
    robot_numbers: dict[str, float]  # measured by the robot's process, units in the names


def measure(trace: Trace, plan: ScenarioPlan, surface: Surface, tau_s: float) -> Result:
    """Return the measures of a trace."""
    work = trace.work
    final = [sample for sample in work if sample.t_s >= work[-1].t_s - FINAL_WINDOW_S]
    highest_m = max(surface.lift_off_m(sample) for sample in work)
    ages = trace.stages.get("robot", {})
    chain = percentiles_us(list(ages.values()))
    return Result(
        settled=trace.settled_at_s is not None,
        peak_force_N=max(sample.force for sample in trace.press + work),
        settling_s=trace.settled_at_s,
        overshoot_pct=overshoot_pct(trace, plan, highest_m * surface.stiffness_N_m),
        final_force_N=hypot(*np.mean([sample.force_N for sample in final], axis=0)),
        final_torque_Nm=hypot(*np.mean([sample.torque_Nm for sample in final], axis=0)),
        misalignment_deg=surface.misalignment_deg(work[-1]),
        lift_off_mm=highest_m * 1e3,
        tau_s=tau_s,
        chain_latency_us_p50=chain[0] if chain else None,
        chain_latency_us_p99=chain[1] if chain else None,
        hops_us=hops_us(trace),
        robot_numbers=trace.robot_numbers,
    )


def overshoot_pct(trace: Trace, plan: ScenarioPlan, lift_off_force_N: float) -> float:
    """Return the overshoot in percent of the step.

    A contact cannot pull: at set point 0 the overshoot is the true lift-off times the stiffness,
    over the starting force. With a set point it is the force beyond it, over the step.
    """
    start_N = trace.work[0].force
    if plan.setpoint_N == 0.0 or plan.mode == "orientation":
        return 100.0 * max(0.0, lift_off_force_N) / start_N
    step_N = plan.setpoint_N - start_N
    overshoots_N = [
        (force_N - plan.setpoint_N) * np.sign(step_N)
        for t_s, force_N in mean_force(trace.work)
        if t_s >= IGNORE_FIRST_S
    ]
    return 100.0 * float(max(0.0, *overshoots_N)) / max(abs(step_N), 1.0)


def mean_force(samples: list[ScenarioSample]) -> list[tuple[float, float]]:
    """Return time and force averaged over a few milliseconds."""
    times = np.array([sample.t_s for sample in samples])
    forces = np.array([sample.force for sample in samples])
    first = np.searchsorted(times, times - MEAN_WINDOW_S)
    total = np.concatenate([[0.0], np.cumsum(forces)])
    last = np.arange(1, len(times) + 1)
    means = (total[last] - total[first]) / (last - first)
    return list(zip(times.tolist(), means.tolist(), strict=True))


def hops_us(trace: Trace) -> dict[str, tuple[float, float]]:
    """Return p50 and p99 of the time from each stage to the next, same sensor sample [us]."""
    result: dict[str, tuple[float, float]] = {}
    previous, before = "sensor", dict.fromkeys(trace.stages.get("wrench", {}), 0)
    for stage in ("wrench", "regulator", "arbiter", "robot"):
        ages = trace.stages.get(stage, {})
        hops = [age - before[seq] for seq, age in ages.items() if seq in before]
        if (found := percentiles_us(hops)) is not None:
            result[f"{previous} to {stage}"] = found
        before, previous = ages, stage
    return result


def percentiles_us(ages_ns: list[int]) -> tuple[float, float] | None:
    """Return p50 and p99 in microseconds, or None without data."""
    if not ages_ns:
        return None
    p50, p99 = np.percentile(np.array(ages_ns) / 1e3, [50, 99]).tolist()
    return (p50, p99)


# --- output ---------------------------------------------------------------------------------------


def table(result: Result, plan: ScenarioPlan, started: str) -> Table:
    """Return the result as a table; its title is the regulator's confirmation of the start."""
    force = f"|F - {plan.setpoint_N:g} N| <= {SETTLED_FORCE_N:g} N"
    torque = f"|M| <= {SETTLED_TORQUE_NM:g} N m"
    goal = {"position": force, "orientation": torque, "both": f"{force}, {torque}"}[plan.mode]
    settling = "not settled"
    if result.settling_s is not None:
        taus = result.settling_s / result.tau_s
        settling = f"{result.settling_s * 1e3:.0f} ms = {taus:.1f} tau"
    rows = [
        ("settled", "yes" if result.settled else "no", f"{goal} for 1 s"),
        ("settling time", settling, "from the start of force feedback"),
        ("overshoot", f"{result.overshoot_pct:.1f} %", "lift-off, or force beyond the set point"),
        ("peak force", f"{result.peak_force_N:.1f} N", "including pressing"),
        ("final force", f"{result.final_force_N:.2f} N", "mean of the last 0.5 s"),
        (
            "final torque",
            f"{result.final_torque_Nm:.3f} N m",
            "mean of the last 0.5 s, about the TCP",
        ),
        ("misalignment", f"{result.misalignment_deg:.2f} deg", "tool axis to plate normal"),
        ("tau", f"{result.tau_s * 1e3:.1f} ms", "delay and lag used by the gain rule"),
    ]
    for hop, (p50, p99) in result.hops_us.items():
        rows.append((hop, f"{p50:.0f} / {p99:.0f} us", "hop latency, p50 / p99"))
    if result.chain_latency_us_p50 is not None:
        chain = f"{result.chain_latency_us_p50:.0f} / {result.chain_latency_us_p99:.0f} us"
        rows.append(("whole chain", chain, "sensor to robot, p50 / p99"))
    for name, label in LABELS.items():  # the others are in --json
        if name in result.robot_numbers:
            rows.append((label, f"{result.robot_numbers[name]:.3g}", "from robot/health"))
    shown = Table(
        "measure",
        Column("value", justify="right"),
        "definition",
        title=f"force feedback: {started}",
        title_justify="left",
    )
    for row in rows:
        shown.add_row(*row)
    return shown


def pictured(trace: Trace, plan: ScenarioPlan) -> ScenarioSample:
    """Return the sample to draw: the last one, or the last press where nothing is pressed after it.

    A tilted plate is drawn once the disc lies flat on it.
    """
    ends_pressing = plan.setpoint_N > 0.0 or plan.mode != "position"
    return trace.work[-1] if ends_pressing else trace.press[-1]


def picture(settings: "SimSettings", surface: Surface, sample: ScenarioSample, path: Path) -> None:
    """Write a picture of the scene at one sample. Raises RenderUnavailable without EGL."""
    from sim.robot.render import render_png

    arm, home_rad = ArmKinematics(settings.arm), settings.home_rad
    solution = arm.solve(sample.T_base_flange, home_rad, jump_rad=np.pi)
    q = home_rad if solution.q is None else solution.q
    contact_m = surface.contact_m(sample)
    render_png(settings, path, q=q, force_N=sample.force_N, contact_m=contact_m)


def plot(trace: Trace, plan: ScenarioPlan, surface: Surface, path: Path) -> None:
    """Write force, torque and height over time, and the contact on a tilted plate, as a PNG."""
    samples = trace.press + trace.work
    t_s = [sample.t_s for sample in samples]
    is_tilted = np.degrees(np.arccos(surface.normal[2])) > LEVEL_DEG
    figure = Figure(figsize=(14 if is_tilted else 9, 8), layout="constrained")
    axes = figure.subplot_mosaic(TILTED if is_tilted else FLAT)
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
    for samples, colour, label in (
        (trace.work, "tab:red", "contact under force feedback"),
        (trace.press, "tab:gray", "contact while pressing"),
    ):
        points_m = [surface.contact_m(each) for each in samples if each.force > PRESSED_N]
        if points_m:
            x_mm, y_mm = 1e3 * surface.in_plane_m(np.array(points_m)).T
            axes.plot(x_mm, y_mm, color=colour, marker=".", markersize=3, label=label)
    T_base_tcp = trace.work[-1].T_base_flange * surface.T_flange_tcp
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
