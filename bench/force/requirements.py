"""Requirements on the adaptive law, checked against the rows of the bench. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from math import inf

import numpy as np

from bench.harness import worst
from bench.results import Row

SLOW_LOOPS = ((60.0, 0.5, 0.35), (30.0, 0.8, 0.45), (15.0, 1.4, 0.65))  # Hz; first, identified [s]
Rows = Mapping[str, Sequence[Row]]


def requirements(rows: Rows) -> list[Row]:
    """Return every requirement that these rows cover; the worst row decides."""
    brakes = "arms with low braking acceleration, overshoot, %"
    ours = {name: [r for r in each if r.get("law") == "adaptive"] for name, each in rows.items()}
    groups = {
        "releases": _releases(rows["release"]),
        "slow loops": _slow(rows["slow-loops"]),
        "over TCP": _over_tcp(ours["over-tcp"]),
        "limited speed": _limited(rows["limited-speed"]),
        "slow brakes": _worst(brakes, 5.0, rows["slow-brakes"], "overshoot_pct"),
        "scenes": _scenes(ours),
        "other laws": (each for part in (_peers(rows["peers"]), _fixed(rows["fixed-gain"]))
                       for each in part),
    }  # fmt: skip
    return [{"group": group, **each} for group, found in groups.items() for each in found]


def closest(found: Sequence[Row]) -> Iterator[Row]:
    """Yield the requirement of each group that is nearest to its limit, or farthest beyond."""
    for group in dict.fromkeys(each["group"] for each in found):
        ours = [each for each in found if each["group"] == group]
        nearest = max(ours, key=lambda each: each["worst_result"] / max(each["limit"], 1e-9))
        yield {
            **nearest,
            "met": all(each["met"] for each in ours),
            "requirements": len(ours),
            "closest_to_its_limit": nearest["quantity"],
        }


def requirement(quantity: str, limit: float, found: float, where: str = "") -> Row:
    """Return one requirement: it is met when the result is at most the limit."""
    return {
        "quantity": quantity,
        "limit": limit,
        "worst_result": found,
        "where": where,
        "met": found <= limit,
    }


def _worst(quantity: str, limit: float, rows: Sequence[Row], value: str) -> Iterator[Row]:
    """Yield a requirement on the largest value; nothing without rows."""
    if rows:
        values = [worst([row.get(value)]) for row in rows]
        row = rows[int(np.argmax(values))]
        delay = f", {row['delay_ms']} ms" if "delay_ms" in row else ""
        loop = f", {row['loop_hz']:.3g} Hz" if row.get("loop_hz", 250.0) != 250.0 else ""
        where = f"{row['stiffness_N_m']:g} N/m{delay}{loop}"
        yield requirement(quantity, limit, max(values), where)


def _releases(rows: Sequence[Row]) -> Iterator[Row]:
    stiff = [row for row in rows if row["stiffness_N_m"] >= 5e3]
    soft = [r for r in rows if r["stiffness_N_m"] < 5e3 and r["delay_error_ms"] == 0.0]
    right, late, later, short = (
        [row for row in stiff if row["delay_error_ms"] == error] for error in (0.0, 5.0, 10.0, -5.0)
    )
    safe = [*right, *late]
    undelayed = [r for r in safe if r["delay_ms"] == 0 and r["stiffness_N_m"] <= 1e4]
    far = [row for row in right if row["stiffness_N_m"] >= 1e4 and row["delay_ms"] >= 10]
    exact, wrong = ([r for r in each if r not in undelayed] for each in (right, late))
    yield from _worst("first contact, tau", 9.0, safe, "first_tau")
    yield from _worst("stiffness identified, tau", 5.0, exact, "identified_tau")
    yield from _worst(
        "stiffness identified, delay assumed 5 ms long, tau", 5.0, wrong, "identified_tau"
    )
    yield from _worst("both, k <= 1e4 without delay", 6.0, undelayed, "identified_tau")
    yield from _worst("overshoot, % (delay exact or 5 ms long)", 5.0, safe, "overshoot_pct")
    yield from _worst("stricter, k >= 1e4, delay >= 10 ms, first, tau", 7.0, far, "first_tau")
    yield from _worst("stricter, identified, tau", 4.0, far, "identified_tau")
    yield from _worst("delay assumed 10 ms long, tau", 11.0, later, "first_tau")
    yield from _worst("delay assumed 10 ms long, overshoot, %", 10.0, later, "overshoot_pct")
    text = "delay assumed 5 ms short, overshoot, % (bounded)"
    yield from _worst(text, 100.0, short, "overshoot_pct")
    text = "1e3 and 2e3 N/m, first, relative to 3.5/(k Ki_cap) + tau"
    yield from _worst(text, 1.0, soft, "first_of_capped")


def _slow(rows: Sequence[Row]) -> Iterator[Row]:
    for hz, first_s, identified_s in SLOW_LOOPS:
        these = [row for row in rows if row["delay_ms"] == 10 and row["loop_hz"] == hz]
        yield from _worst(f"loop of {hz:g} Hz, first, s", first_s, these, "first_s")
        yield from _worst(f"loop of {hz:g} Hz, identified, s", identified_s, these, "identified_s")
    far = [row for row in rows if row["delay_ms"] != 10]
    yield from _worst("slow loops, 120 ms of delay, first, tau", 12.0, far, "first_tau")
    yield from _worst("slow loops, overshoot, %", 5.0, rows, "overshoot_pct")


def _over_tcp(ours: Sequence[Row]) -> Iterator[Row]:
    yield from _worst("over TCP, contact unknown, first, tau", 15.0, ours, "first_tau")
    yield from _worst("over TCP, contact unknown, overshoot, %", 10.0, ours, "overshoot_pct")


def _limited(rows: Sequence[Row]) -> Iterator[Row]:
    soft = [row for row in rows if row["stiffness_N_m"] < 5e3]
    stiff = [row for row in rows if row["stiffness_N_m"] >= 5e3]
    text = "20 and 50 mm/s, first, relative to (F0 - 1)/(k vmax) + 5 tau"
    yield from _worst(text, 1.0, stiff, "first_of_limited")
    text = "20 and 50 mm/s at 1e3 N/m, relative to the longer of the two"
    yield from _worst(text, 1.0, soft, "first_of_limited")


def _scenes(ours: Rows) -> Iterator[Row]:
    def of(scene: str, least_k: float = 0.0, most_k: float = inf) -> list[Row]:
        return [row for row in ours[scene] if least_k <= row["stiffness_N_m"] <= most_k]

    slope = "slope, mean error after 1 s, N"
    yield from _worst(slope, 0.1, of("slope", 5e3), "mean_error_N")
    yield from _worst("sine up to 2e4, N", 0.2, of("sine", 5e3, 2e4), "mean_error_N")
    yield from _worst("sine at 1e5, N", 0.5, of("sine", 1e5), "mean_error_N")
    onset = [*of("slope", 2e4), *of("sine", 2e4)]
    yield from _worst("onset, relative to k v tau", 1.2, onset, "onset_of_k_v_tau")
    step = "set point from 10 to 20 N, overshoot, %"
    yield from _worst(step, 5.0, of("set-point-step"), "overshoot_pct")
    yield from _worst("stationary surface, N", 0.1, of("press"), "steady_error_N")
    align = "alignment from 10 degrees, degrees"
    yield from _worst(align, 0.1, of("align", 2e4), "misalignment_deg")
    lost = [row for each in ours.values() for row in each if "contact_lost" in row]
    yield from _worst("contacts lost", 0.0, lost, "contact_lost")
    for speed_m_s, limit_mm in ((0.02, 1.5), (0.05, 3.0)):
        walls = [row for row in of("wall-vanishes") if row["speed_m_s"] == speed_m_s]
        text = f"wall vanishes at {1e3 * speed_m_s:g} mm/s, mm"
        yield from _worst(text, limit_mm, walls, "travel_mm")
    yield from _worst("spikes, ripple, N rms", 0.1, of("spikes"), "ripple_N")
    text = "ten times stiffer, peak relative to its bound"
    yield from _worst(text, 1.0, of("ten-times-stiffer"), "peak_of_bound")


def _peers(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield reciprocal speed ratios: met when ours is faster by the required factor."""
    limits = (("one setting for all", "one_setting", "first", 1 / 5.0, 1.0),
              ("tuned per scene", "tuned_here", "identified", 1 / 1.3, 1.1))  # fmt: skip
    for text, theirs, ours, most_median, most in limits if rows else ():
        ratios = [_speed_ratio(row, theirs, ours) for row in rows]
        row = rows[int(np.argmin(ratios))]
        where = f"{row['law']}, {row['stiffness_N_m']:g} N/m, {row['delay_ms']} ms"
        median = 1 / float(np.median(ratios))
        yield requirement(f"1 / median speed ratio, {text}", most_median, median)
        yield requirement(f"1 / smallest speed ratio, {text}", most, 1 / min(ratios), where)


def _fixed(rows: Sequence[Row]) -> Iterator[Row]:
    for row in rows:
        text = "1 / speed ratio to a fixed gain safe at 1e5, at 5e3 N/m"
        yield requirement(text, 1 / 12.0, 1 / _speed_ratio(row, "fixed", "identified"))


def _speed_ratio(row: Row, theirs: str, ours: str) -> float:
    return worst([row.get(f"{theirs}_s")]) / worst([row.get(f"{ours}_s")])
