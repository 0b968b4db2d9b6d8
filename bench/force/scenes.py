"""Scenes other than the release: contact, hold, follow, align, guide, and disturbances."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.force.guided import guide, guide_to_a_wall
from bench.force.laws import HOLD_N, Make, holding, plain
from bench.force.measures import energy_mJ, means, settling_s
from bench.force.rig import ForceRig, SceneSettings, Trace
from bench.force.settle import true_tau_s
from bench.force.turning import align, lateral, slide
from bench.results import Row
from sim.robot.ft_sensor import FtSample

SLOPE_M_S = 0.02 * float(np.tan(np.radians(10.0)))  # 10 degrees at 20 mm/s across
SINE_M, SINE_HZ = 0.002, 0.02 / 0.1  # 2 mm in 100 mm at 20 mm/s
STEP_N = 10.0
SPIKE_N, SPIKE_SHARE = 20.0, 0.01


def press(world: SceneSettings, make: Make) -> Row:
    """From a contact with 3 N to 10 N, then 1 s of holding at rest."""
    rig, pilot, found = holding(world, make)
    still = rig.run(pilot, 1.0)
    settled = settling_s(np.array(found.t_s), np.array(found.push_N) - HOLD_N, 1.0)
    return {
        "settling_s": settled,
        "overshoot_N": _peak(found) - HOLD_N,
        "steady_error_N": _mean_abs(still),
        "ripple_N": float(np.std(still.push_N)),
        "energy_mJ": energy_mJ(found),
    }


def touch(world: SceneSettings, make: Make) -> Row:
    """From 0.5 mm above the plate to 10 N."""
    rig = ForceRig(replace(world, gap_m=0.0005).cell())
    pilot = make(rig)
    pilot.setpoint_N = HOLD_N
    trace = rig.run(pilot, 4.0)
    push, t = np.array(trace.push_N), np.array(trace.t_s)
    first = int(np.argmax(push > 1.0))
    settled = settling_s(t, push - HOLD_N, 1.0)
    return {
        "peak_N": _peak(trace),
        "settling_after_touch_s": None if settled is None else settled - float(t[first]),
        "contact_lost": float((means(t, push)[first + 10 :] < 0.5).sum() > 0),
        "energy_mJ": energy_mJ(trace),
    }


def followed(world: SceneSettings, make: Make, kind: str) -> Trace:
    """Return a trace on a surface that moves like a slope or waves under a sliding tool."""
    rig, pilot, _ = holding(world, make)
    rest_m, start = rig.arm.plate.point_m.copy(), rig.arm.ticks

    def move(rig: ForceRig) -> None:
        t = (rig.arm.ticks - start) * 1e-3
        up = SLOPE_M_S * t if kind == "slope" else SINE_M * np.sin(2 * np.pi * SINE_HZ * t)
        rig.arm.plate.point_m = rest_m + np.array([0.0, 0.0, up])

    rig.every_tick = move
    return rig.run(pilot, 6.0)


def follow(world: SceneSettings, make: Make, kind: str) -> Row:
    """Hold 10 N on a surface that moves."""
    trace = followed(world, make, kind)
    t, error = np.array(trace.t_s), np.array(trace.push_N) - HOLD_N
    speed = SLOPE_M_S if kind == "slope" else SINE_M * 2 * np.pi * SINE_HZ
    onset = float(np.abs(means(t, error)[t < 1.0]).max())
    return {
        "mean_error_N": float(np.abs(error[t >= 1.0]).mean()),
        "onset_of_k_v_tau": onset / (world.stiffness_N_m * speed * true_tau_s(world)),
        "contact_lost": float((means(t, error) < -HOLD_N + 0.5).any()),
        "energy_mJ": energy_mJ(trace),
    }


def set_point_step(world: SceneSettings, make: Make) -> Row:
    """From 10 N to 20 N, as fast as the regulator lets a set point change."""
    rig, pilot, _ = holding(world, make)
    trace = Trace()
    rises_N = rig.cell.force.setpoint_ramp_N_s / rig.cell.rates.control_hz
    while pilot.setpoint_N < HOLD_N + STEP_N:
        pilot.setpoint_N = min(pilot.setpoint_N + rises_N, HOLD_N + STEP_N)
        rig.run(pilot, 1.0 / rig.cell.rates.control_hz, trace)
    rig.run(pilot, 1.5 if make is not plain else 6.0, trace)
    settled = settling_s(np.array(trace.t_s), np.array(trace.push_N) - pilot.setpoint_N, 1.0)
    return {
        "settling_s": settled,
        "overshoot_pct": 100.0 * max(0.0, _peak(trace) - pilot.setpoint_N) / STEP_N,
        "energy_mJ": energy_mJ(trace),
    }


def payload_error(world: SceneSettings, make: Make) -> Row:
    """The tool is 100 g heavier than configured: true force on the plate."""
    rig = ForceRig(world.cell())
    lighter_kg = rig.payload.mass_kg - 0.1
    rig.payload = rig.payload.model_copy(update={"mass_kg": lighter_kg})
    rig.press(3.0)
    pilot = make(rig)
    pilot.setpoint_N = HOLD_N
    rig.run(pilot, 3.0)
    truth: list[float] = []
    rig.every_tick = lambda rig: truth.append(_true_N(rig))
    rig.run(pilot, 1.0)
    return {"true_error_N": abs(float(np.mean(truth)) - HOLD_N)}


def spikes(world: SceneSettings, make: Make) -> Row:
    """One sample of the sensor in a hundred is 20 N off."""
    rig = ForceRig(world.cell())
    rig.press(3.0)
    rng = np.random.default_rng(world.seed + 1)

    def spoil(sample: FtSample) -> FtSample:
        if rng.random() >= SPIKE_SHARE:
            return sample
        side = float(rng.choice([-SPIKE_N, SPIKE_N]))
        return replace(sample, force_N=sample.force_N + np.array([0.0, 0.0, side]))

    rig.arm.ft_sensor.disturb = spoil
    pilot = make(rig)
    pilot.setpoint_N = HOLD_N
    rig.run(pilot, 2.0 if make is not plain else 4.0)
    truth: list[float] = []
    rig.every_tick = lambda rig: truth.append(_true_N(rig))
    rig.run(pilot, 2.0)
    return {"ripple_N": float(np.std(truth))}


def wall_vanishes(world: SceneSettings, make: Make) -> Row:
    """The wall vanishes: travel until the search is as slow as an approach."""
    rig, pilot, _ = holding(world, make)
    rig.arm.plate.point_m[2] -= 0.1
    z = float(rig.arm.T_base_tcp.translation[2])
    trace = rig.run(pilot, 0.3)
    lowest = min(float(T.translation[2]) for T in trace.T_base_tcp)
    return {"travel_mm": 1e3 * (z - lowest)}


def ten_times_stiffer(world: SceneSettings, make: Make) -> Row:
    """The contact becomes ten times stiffer while the set point changes from 10 to 20 N."""
    rig, pilot, _ = holding(replace(world, stiffness_N_m=world.stiffness_N_m / 10.0), make)
    plate, springs = rig.arm.plate, rig.arm.plate.springs
    springs.stiffness_N_m *= 10.0
    springs.relaxation_s /= 10.0**0.5
    springs.travel_m /= 10.0  # so that the force is the same at first, at the same height
    springs.shear_m = (springs.shear_m[0] / 10.0, springs.shear_m[1] / 10.0)
    plate.point_m += 9.0 * springs.travel_m * plate.normal
    pilot.setpoint_N = HOLD_N + STEP_N
    trace = rig.run(pilot, 2.0 if make is not plain else 6.0)
    settled = settling_s(np.array(trace.t_s), np.array(trace.push_N) - pilot.setpoint_N, 1.0)
    bound_N = world.stiffness_N_m * world.speed_m_s * true_tau_s(world)
    return {
        "peak_N": _peak(trace),
        "peak_bound_N": pilot.setpoint_N + bound_N,
        "settling_s": settled,
        "energy_mJ": energy_mJ(trace),
    }


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene and the names of its measures."""

    play: Callable[[SceneSettings, Make], Row]
    measures: str


FOLLOWED = "mean_error_N onset_of_k_v_tau contact_lost energy_mJ"
SCENES = {
    "press": Scene(press, "settling_s overshoot_N steady_error_N ripple_N energy_mJ"),
    "touch": Scene(touch, "peak_N settling_after_touch_s contact_lost energy_mJ"),
    "slope": Scene(lambda world, make: follow(world, make, "slope"), FOLLOWED),
    "sine": Scene(lambda world, make: follow(world, make, "sine"), FOLLOWED),
    "set-point-step": Scene(set_point_step, "settling_s overshoot_pct energy_mJ"),
    "align": Scene(align, "misalignment_deg time_to_1_deg_s force_off_N"),
    "lateral": Scene(lateral, "normal_error_N sideways_left_N"),
    "slide": Scene(slide, "mean_error_N peak_error_N friction_N misalignment_deg contact_lost"),
    "guide": Scene(guide, "hand_N hand_peak_N"),
    "guide-to-a-wall": Scene(guide_to_a_wall, "peak_N leaning_N ripple_N came_back_mm"),
    "payload-error": Scene(payload_error, "true_error_N"),
    "spikes": Scene(spikes, "ripple_N"),
    "wall-vanishes": Scene(wall_vanishes, "travel_mm"),
    "ten-times-stiffer": Scene(ten_times_stiffer, "peak_N peak_bound_N settling_s energy_mJ"),
}


def _peak(trace: Trace) -> float:
    return float(means(np.array(trace.t_s), np.array(trace.push_N)).max())


def _mean_abs(trace: Trace) -> float:
    return float(np.abs(np.array(trace.push_N) - HOLD_N).mean())


def _true_N(rig: ForceRig) -> float:
    return -float(rig.arm.true_wrench().force_N @ rig.arm.T_base_tcp.rotation[:, 2])
