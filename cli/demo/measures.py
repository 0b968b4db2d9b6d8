"""Measures of a trace of the main task. Pure."""

from dataclasses import asdict, dataclass

import numpy as np
import pinocchio as pin

from cli.demo.scenario import ScenarioPlan, ScenarioSample, Trace
from common.motion.contact_point import contact_point_m
from common.motion.frames import Array
from sim.robot.plate import lift_off_m

FINAL_WINDOW_S = 0.5
# Averages over 8 ms against the sensor's noise, without the first 15 ms, in which the inertia of
# the tool is measured as force.
MEAN_WINDOW_S = 0.008
IGNORE_FIRST_S = 0.015


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
        T_base_flange = pin.SE3(sample.T_base_flange)
        return lift_off_m(
            T_base_flange * self.T_flange_tcp,
            plate_point_m=self.point_m,
            plate_normal=self.normal,
            disc_radius_m=self.disc_radius_m,
        )

    def misalignment_deg(self, sample: ScenarioSample) -> float:
        """Angle between the disc's axis and the plate's normal [degrees]."""
        T_base_tcp = pin.SE3(sample.T_base_flange) * self.T_flange_tcp
        cosine = -float(self.normal @ T_base_tcp.rotation[:, 2])
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def contact_m(self, sample: ScenarioSample) -> Array:
        """Point at which the force acts on the disc, in base [m]. Shape (3,)."""
        T_base_tcp = pin.SE3(sample.T_base_flange) * self.T_flange_tcp
        from_tcp_m = contact_point_m(T_base_tcp.rotation, sample.force_N, sample.torque_Nm)
        return np.asarray(T_base_tcp.translation + from_tcp_m)

    def in_plane_m(self, p_base_m: Array) -> Array:
        """Coordinates of points in the plane of the plate, true to length [m]. Shape (..., 2).

        The first axis is base x turned into the plane, the second one the normal times the first.
        """
        x = np.array([1.0, 0.0, 0.0]) - self.normal[0] * self.normal
        x /= np.linalg.norm(x)
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

    def as_dict(self) -> dict[str, object]:
        """Return what `--json` prints."""
        return asdict(self)


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
        final_force_N=_length(np.mean([sample.force_N for sample in final], axis=0)),
        final_torque_Nm=_length(np.mean([sample.torque_Nm for sample in final], axis=0)),
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
    before: dict[int, int] | None = None
    previous = "sensor"
    for stage in ("wrench", "regulator", "arbiter", "robot"):
        ages = trace.stages.get(stage, {})
        hops = [
            age - (0 if before is None else before[seq])
            for seq, age in ages.items()
            if before is None or seq in before
        ]
        found = percentiles_us(hops)
        if found is not None:
            result[f"{previous} to {stage}"] = found
        before, previous = ages, stage
    return result


def percentiles_us(ages_ns: list[int]) -> tuple[float, float] | None:
    """Return p50 and p99 in microseconds, or None without data."""
    if not ages_ns:
        return None
    p50, p99 = np.percentile(np.array(ages_ns) / 1e3, [50, 99]).tolist()
    return (p50, p99)


def _length(vector: Array) -> float:
    return float(np.linalg.norm(vector))
