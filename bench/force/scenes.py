"""Scenes other than the release: contact, hold, follow, align, guide, and disturbances."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.force.laws import HOLD_N, SAFE, holding, pressing, runner_of
from bench.force.rig import ForceRig, SceneSettings, Trace
from bench.force.settle import true_tau_s
from bench.results import Row
from common.motion.frames import Array
from sim.robot.ft_sensor import FtSample
from sim.robot.settings import TICK_S

SLOPE_M_S = 0.02 * float(np.tan(np.radians(10.0)))  # 10 degrees at 20 mm/s across
SINE_M, SINE_HZ = 0.002, 0.02 / 0.1  # 2 mm in 100 mm at 20 mm/s
STEP_N = 10.0
SPIKE_N, SPIKE_SHARE = 20.0, 0.01
SLIDE_M_S, SLIDE_S, SLIDE_TILT_DEG = 0.02, 1.5, 3.0
GRIP_N_M, GRIP_NS_M, HAND_M_S = 500.0, 20.0, 0.03
FIRM_N_M = 1000.0  # grip of a hand that presses against the wall
WALL_M, LEAN_S, BACK_S, END_S = 0.005, 0.4, 1.2, 2.2

HandMotion = Callable[[float], tuple[Array, Array]]  # of the hand since the grip [m], [m/s]


def press(world: SceneSettings, law: str) -> Row:
    """From a contact with 3 N to 10 N, then 1 s of holding at rest."""
    rig, pilot, found = holding(world, law)
    still = rig.run(pilot, 1.0)
    return {"settling_s": found.settling_s(HOLD_N), "steady_error_N": _error_N(still)}


def touch(world: SceneSettings, law: str) -> Row:
    """From 0.5 mm above the plate to 10 N."""
    rig = ForceRig(replace(world, gap_m=0.0005).cell())
    pilot = runner_of(law, rig)
    pilot.setpoint_N = HOLD_N
    trace = rig.run(pilot, 4.0)
    first = int(np.argmax(np.array(trace.push_N) > 1.0))
    lost = (trace.smooth_N[first + 10 :] < 0.5).any()
    return {"peak_N": float(trace.smooth_N.max()), "contact_lost": float(lost)}


def slope(world: SceneSettings, law: str) -> Row:
    """Hold 10 N on a surface that rises like a slope under a sliding tool."""
    return _follow(world, law, lambda t_s: SLOPE_M_S * t_s, SLOPE_M_S)


def sine(world: SceneSettings, law: str) -> Row:
    """Hold 10 N on a surface that moves like waves under a sliding tool."""
    turns = 2 * np.pi * SINE_HZ
    return _follow(world, law, lambda t_s: SINE_M * np.sin(turns * t_s), SINE_M * turns)


def _follow(
    world: SceneSettings, law: str, height_m: Callable[[float], float], speed_m_s: float
) -> Row:
    rig, pilot, _ = holding(world, law)
    rest_m, start = rig.arm.plate.point_m.copy(), rig.arm.ticks

    def move(rig: ForceRig) -> None:
        rise_m = height_m((rig.arm.ticks - start) * 1e-3)
        rig.arm.plate.point_m = rest_m + np.array([0.0, 0.0, rise_m])

    rig.every_tick = move
    trace = rig.run(pilot, 6.0)
    error_N = trace.smooth_N - HOLD_N
    onset_N = float(np.abs(error_N[np.array(trace.t_s) < 1.0]).max())
    return {
        "mean_error_N": _error_N(trace, 1.0),
        "onset_of_k_v_tau": onset_N / (world.stiffness_N_m * speed_m_s * true_tau_s(world)),
        "contact_lost": float((error_N < -HOLD_N + 0.5).any()),
    }


def set_point_step(world: SceneSettings, law: str) -> Row:
    """From 10 N to 20 N, as fast as the regulator lets a set point change."""
    rig, pilot, _ = holding(world, law)
    trace = Trace()
    rises_N = rig.cell.force.setpoint_ramp_N_s / rig.cell.rates.control_hz
    while pilot.setpoint_N < HOLD_N + STEP_N:
        pilot.setpoint_N = min(pilot.setpoint_N + rises_N, HOLD_N + STEP_N)
        rig.run(pilot, 1.0 / rig.cell.rates.control_hz, trace)
    rig.run(pilot, 1.5 if law != SAFE else 6.0, trace)
    return {
        "settling_s": trace.settling_s(pilot.setpoint_N),
        "overshoot_pct": 100.0 * max(0.0, trace.smooth_N.max() - pilot.setpoint_N) / STEP_N,
    }


def align(world: SceneSettings, law: str) -> Row:
    """Alignment of a face from 10 degrees in mode both, at 10 N."""
    rig, pilot = pressing(replace(world, tilt_deg=10.0), law)
    pilot.mode = "both"
    trace = rig.run(pilot, 8.0)
    cosine = -float(rig.arm.plate.normal @ trace.T_base_tcp[-1].rotation[:, 2])
    return {"misalignment_deg": float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))}


def lateral(world: SceneSettings, law: str) -> Row:
    """Mode both at 10 N while a lateral force of 2 N acts on the tool."""
    rig, pilot, _ = holding(world, law)
    pilot.mode = "both"
    tool = rig.arm.model.body("tool").id
    rig.arm.data.xfrc_applied[tool][:3] = (2.0, 0.0, 0.0)
    later_s = 0.5 + TICK_S  # than half a second
    return {"normal_error_N": _error_N(rig.run(pilot, 2.0), later_s)}


def slide(world: SceneSettings, law: str) -> Row:
    """Mode both at 10 N, moved 30 mm at 20 mm/s over a plate with friction, tilted 3 degrees.

    The disc lies flat before it is moved, uphill; the first 0.3 s, in which friction builds up, are
    left out of the error.
    """
    rig, pilot = pressing(replace(world, tilt_deg=SLIDE_TILT_DEG), law)
    pilot.mode = "both"
    rig.run(pilot, 6.0)
    pilot.across_m_s = np.array([0.0, SLIDE_M_S, 0.0])
    trace = rig.run(pilot, SLIDE_S)
    lost = (trace.smooth_N < 0.5).any()
    return {"mean_error_N": _error_N(trace, 0.3), "contact_lost": float(lost)}


def guide(world: SceneSettings, law: str) -> Row:
    """A hand pulls the free tool at 30 mm/s."""
    velocity_m_s = np.array([0.0, HAND_M_S, 0.0])
    rig = ForceRig(replace(world, gap_m=0.05).cell())
    pilot = runner_of(law, rig)
    rig.every_tick = grip_force(rig, lambda t: (velocity_m_s * t, velocity_m_s), GRIP_N_M)
    trace = rig.run(pilot, 2.0)
    force_N = np.array(trace.force_N)[:, 1][np.array(trace.t_s) > 1.0]
    return {"hand_N": float(np.abs(force_N).mean())}


def guide_to_a_wall(world: SceneSettings, law: str) -> Row:
    """A hand guides the tool down against the plate, presses, and guides it up again."""
    down = np.array([0.0, 0.0, -HAND_M_S])
    rig = ForceRig(replace(world, gap_m=WALL_M).cell())
    pilot = runner_of(law, rig)

    def lean(t: float) -> tuple[Array, Array]:
        if t < LEAN_S:
            return down * t, down
        return down * (LEAN_S - max(0.0, t - BACK_S)), (-down if t > BACK_S else 0.0 * down)

    rig.every_tick = grip_force(rig, lean, FIRM_N_M)
    return {"peak_N": float(rig.run(pilot, END_S).smooth_N.max())}


def grip_force(
    rig: ForceRig, hand_motion: HandMotion, grip_N_m: float
) -> Callable[[ForceRig], None]:
    """Return the function that applies the force of the hand at every tick."""
    tool, start = rig.arm.model.body("tool").id, rig.arm.ticks
    home: Array = np.array(rig.arm.T_base_tcp.translation)
    last = [home.copy()]

    def pull(rig: ForceRig) -> None:
        at = np.array(rig.arm.T_base_tcp.translation)
        speed, last[0] = (at - last[0]) / TICK_S, at
        place, hand_speed = hand_motion((rig.arm.ticks - start) * TICK_S)
        force_N = grip_N_m * (home + place - at) + GRIP_NS_M * (hand_speed - speed)
        rig.arm.data.xfrc_applied[tool][:3] = force_N

    return pull


def payload_error(world: SceneSettings, law: str) -> Row:
    """The tool is 100 g heavier than configured: true force on the plate."""
    rig = ForceRig(world.cell())
    lighter_kg = rig.payload.mass_kg - 0.1
    rig.payload = rig.payload.model_copy(update={"mass_kg": lighter_kg})
    rig.press(3.0)
    pilot = runner_of(law, rig)
    pilot.setpoint_N = HOLD_N
    rig.run(pilot, 3.0)
    truth_N = true_push(rig)
    rig.run(pilot, 1.0)
    return {"true_error_N": abs(float(np.mean(truth_N)) - HOLD_N)}


def spikes(world: SceneSettings, law: str) -> Row:
    """One sample of the sensor in a hundred is 20 N off."""
    rig, pilot = pressing(world, law)
    rng = np.random.default_rng(world.seed + 1)

    def spoil(sample: FtSample) -> FtSample:
        if rng.random() >= SPIKE_SHARE:
            return sample
        side = float(rng.choice([-SPIKE_N, SPIKE_N]))
        return replace(sample, force_N=sample.force_N + np.array([0.0, 0.0, side]))

    rig.arm.ft_sensor.disturb = spoil
    rig.run(pilot, 2.0 if law != SAFE else 4.0)
    truth_N = true_push(rig)
    rig.run(pilot, 2.0)
    return {"ripple_N": float(np.std(truth_N))}


def true_push(rig: ForceRig) -> list[float]:
    """Return a list that the true force along the tool's axis is added to at every tick."""
    truth_N: list[float] = []

    def add(rig: ForceRig) -> None:
        force_N = rig.arm.true_wrench().force_N
        truth_N.append(-float(force_N @ rig.arm.T_base_tcp.rotation[:, 2]))

    rig.every_tick = add
    return truth_N


def wall_vanishes(world: SceneSettings, law: str) -> Row:
    """The wall vanishes: travel until the search is as slow as an approach."""
    rig, pilot, _ = holding(world, law)
    rig.arm.plate.point_m[2] -= 0.1
    z = float(rig.arm.T_base_tcp.translation[2])
    trace = rig.run(pilot, 0.3)
    lowest = min(float(T.translation[2]) for T in trace.T_base_tcp)
    return {"travel_mm": 1e3 * (z - lowest)}


def ten_times_stiffer(world: SceneSettings, law: str) -> Row:
    """The contact becomes ten times stiffer while the set point changes from 10 to 20 N."""
    rig, pilot, _ = holding(replace(world, stiffness_N_m=world.stiffness_N_m / 10.0), law)
    plate, springs = rig.arm.plate, rig.arm.plate.springs
    springs.stiffness_N_m *= 10.0
    springs.relaxation_s /= 10.0**0.5
    springs.travel_m /= 10.0  # so that the force is the same at first, at the same height
    springs.shear_m = (springs.shear_m[0] / 10.0, springs.shear_m[1] / 10.0)
    plate.point_m += 9.0 * springs.travel_m * plate.normal
    pilot.setpoint_N = HOLD_N + STEP_N
    trace = rig.run(pilot, 2.0 if law != SAFE else 6.0)
    peak_N, rise_N_s = float(trace.smooth_N.max()), world.stiffness_N_m * world.speed_m_s
    bound_N = pilot.setpoint_N + rise_N_s * true_tau_s(world)
    return {"peak_N": peak_N, "peak_bound_N": bound_N, "peak_of_bound": peak_N / bound_N}


Scene = Callable[[SceneSettings, str], Row]
SCENES: dict[str, Scene] = {  # the page shows the first measure of each
    "press": press,
    "touch": touch,
    "slope": slope,
    "sine": sine,
    "set-point-step": set_point_step,
    "align": align,
    "lateral": lateral,
    "slide": slide,
    "guide": guide,
    "guide-to-a-wall": guide_to_a_wall,
    "payload-error": payload_error,
    "spikes": spikes,
    "wall-vanishes": wall_vanishes,
    "ten-times-stiffer": ten_times_stiffer,
}


def _error_N(trace: Trace, begin_s: float = 0.0) -> float:
    """Return the mean size of the force error from a time on."""
    return float(np.abs(trace.after(begin_s) - HOLD_N).mean())
