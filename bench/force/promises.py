"""Requirements on the adaptive law, checked against the rows of the benchmark. Pure."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf

import numpy as np

from bench.force.run import Row
from bench.force.settle import BAND_N, PRESS_N

Rows = dict[str, list[Row]]


@dataclass(frozen=True, slots=True)
class Requirement:
    """One requirement: quantity, limit, and the worst result. Met when found <= limit."""

    text: str
    limit: float
    found: float
    where: str

    @property
    def kept(self) -> bool:
        """Whether it is met."""
        return self.found <= self.limit


def requirements(rows: Rows) -> list[Requirement]:
    """Return every requirement that these rows cover."""
    made: list[Requirement | None] = [
        *_releases(rows["release"]),
        *_slow(rows["slow loops"]),
        *_over_tcp(rows["over TCP"]),
        *_limited(rows["limited speed"]),
        *_brakes(rows["slow brakes"]),
        *_scenes(rows["scenes"]),
    ]
    made += [*_peers(with_own_results(rows)), _fixed(rows["fixed gain"][0])]
    return [promise for promise in made if promise is not None]


def _worst(
    text: str, limit: float, rows: Iterable[Row], of: Callable[[Row], float]
) -> Requirement | None:
    chosen = list(rows)
    if not chosen:
        return None  # not run
    values = [of(row) for row in chosen]
    worst = int(np.argmax(values))
    row = chosen[worst]
    delay = f", {row['delay_ms']} ms" if "delay_ms" in row else ""
    loop = f", {row['loop_hz']:.3g} Hz" if row.get("loop_hz", 250.0) != 250.0 else ""
    return Requirement(text, limit, values[worst], f"{row['stiffness_N_m']:g} N/m{delay}{loop}")


def _or_never(seconds: float | None) -> float:
    return float("inf") if seconds is None else seconds


def _taus(name: str) -> Callable[[Row], float]:
    return lambda row: _or_never(row[f"{name}_s"]) / float(row["tau_s"])


def _overshoot(row: Row) -> float:
    return max(float(row["first_overshoot_pct"]), float(row["identified_overshoot_pct"]))


def _releases(rows: list[Row]) -> Iterable[Requirement | None]:
    stiff = [row for row in rows if row["stiffness_N_m"] >= 5e3]
    right = [row for row in stiff if row["delay_error_ms"] == 0.0]
    safe = [row for row in stiff if row["delay_error_ms"] in {0.0, 5.0}]
    soft = [row for row in rows if row["stiffness_N_m"] < 5e3 and row["delay_error_ms"] == 0.0]
    undelayed = [r for r in safe if r["delay_ms"] == 0 and r["stiffness_N_m"] <= 1e4]
    others = [row for row in right if row not in undelayed]
    late = [r for r in stiff if r["delay_error_ms"] == 5.0 and r not in undelayed]
    yield _worst("first contact, tau", 9.0, safe, _taus("first"))
    yield _worst("stiffness identified, tau", 5.0, others, _taus("identified"))
    yield _worst("the same, delay assumed 5 ms long", 5.0, late, _taus("identified"))
    yield _worst("both, k <= 1e4 without delay", 6.0, undelayed, _taus("identified"))
    yield _worst("overshoot, % (delay exact or 5 ms long)", 5.0, safe, _overshoot)
    far = [row for row in right if row["stiffness_N_m"] >= 1e4 and row["delay_ms"] >= 10]
    yield _worst("stricter, k >= 1e4, delay >= 10 ms, first, tau", 7.0, far, _taus("first"))
    yield _worst("the same, identified, tau", 4.0, far, _taus("identified"))
    wrong = [row for row in stiff if row["delay_error_ms"] == 10.0]
    yield _worst("delay assumed 10 ms long, tau", 11.0, wrong, _taus("first"))
    yield _worst("the same, overshoot, %", 10.0, wrong, _overshoot)
    short = [row for row in stiff if row["delay_error_ms"] == -5.0]
    yield _worst("delay assumed 5 ms short, overshoot, % (bounded)", 100.0, short, _overshoot)
    text = "1e3 and 2e3 N/m, first, relative to 3.5/(k Ki_cap) + tau"
    yield _worst(text, 1.0, soft, lambda row: _or_never(row["first_s"]) / _capped_s(row))


def _capped_s(row: Row) -> float:
    return 3.5 / (5e-3 * float(row["stiffness_N_m"])) + float(row["tau_s"])


def _limited(rows: list[Row]) -> Iterable[Requirement | None]:
    def part(row: Row) -> float:
        approach_s = (PRESS_N - BAND_N) / (float(row["stiffness_N_m"]) * float(row["speed_m_s"]))
        limited_s = approach_s + 5.0 * float(row["tau_s"])
        return _or_never(row["first_s"]) / max(limited_s, _capped_s(row))

    soft = [row for row in rows if row["stiffness_N_m"] < 5e3]
    text = "20 and 50 mm/s, first, relative to (F0 - 1)/(k vmax) + 5 tau"
    yield _worst(text, 1.0, [row for row in rows if row not in soft], part)
    yield _worst("the same at 1e3 N/m, or relative to the line above if longer", 1.0, soft, part)


def _brakes(rows: list[Row]) -> Iterable[Requirement | None]:
    yield _worst("arms with low braking acceleration, overshoot, %", 5.0, rows, _overshoot)


def with_own_results(rows: Rows) -> list[Row]:
    """Return the peers' rows with our results in the same scene."""
    ours = {
        (row["stiffness_N_m"], row["delay_ms"]): row
        for row in rows["release"]
        if row["delay_error_ms"] == 0.0
    }
    both = [(peer, ours[peer["stiffness_N_m"], peer["delay_ms"]]) for peer in rows["peers"]]
    return [
        peer | {"first_s": row["first_s"], "identified_s": row["identified_s"]}
        for peer, row in both
    ]


def _slow(rows: list[Row]) -> Iterable[Requirement | None]:
    near = [row for row in rows if row["delay_ms"] == 10]
    for hz, first, identified in ((60.0, 0.5, 0.35), (30.0, 0.8, 0.45), (15.0, 1.4, 0.65)):
        these = [row for row in near if row["loop_hz"] == hz]
        yield _worst(
            f"loop of {hz:g} Hz, first, s", first, these, lambda r: _or_never(r["first_s"])
        )
        yield _worst(
            f"loop of {hz:g} Hz, identified, s",
            identified,
            these,
            lambda r: _or_never(r["identified_s"]),
        )
    far = [row for row in rows if row not in near]
    yield _worst("slow loops, 120 ms of delay, first, tau", 12.0, far, _taus("first"))
    yield _worst("slow loops, overshoot, %", 5.0, rows, _overshoot)


def _over_tcp(rows: list[Row]) -> Iterable[Requirement | None]:
    names = ("first_s", "tau_s", "overshoot_pct")
    never = {"adaptive_first_s": None, "adaptive_tau_s": 1.0, "adaptive_overshoot_pct": inf}
    done = [{"stiffness_N_m": r["stiffness_N_m"]} | never | r for r in rows]
    ours = [r | {name: r[f"adaptive_{name}"] for name in names} for r in done]
    yield _worst("over TCP, contact unknown, first, tau", 15.0, ours, _taus("first"))
    text = "the same, overshoot, %"
    yield _worst(text, 10.0, ours, lambda row: float(row["overshoot_pct"]))


def _scenes(rows: list[Row]) -> Iterable[Requirement | None]:
    ours = [row for row in rows if row["law"] == "adaptive"]

    def of(scene: str, least_k: float = 2e4, most_k: float = 1e5) -> list[Row]:
        return [r for r in ours if r["scene"] == scene and least_k <= r["stiffness_N_m"] <= most_k]

    def value(name: str) -> Callable[[Row], float]:
        return lambda row: _or_never(row[name])

    yield _worst("slope, mean error after 1 s, N", 0.1, of("slope", 5e3), value("mean_error_N"))
    yield _worst("sine up to 2e4, N", 0.2, of("sine", 5e3, 2e4), value("mean_error_N"))
    yield _worst("sine at 1e5, N", 0.5, of("sine", 1e5), value("mean_error_N"))
    onset = [*of("slope"), *of("sine")]
    yield _worst("onset, relative to k v tau", 1.2, onset, value("onset_of_k_v_tau"))
    step = of("set point step", 0.0)
    yield _worst("set point from 10 to 20 N, overshoot, %", 5.0, step, value("overshoot_pct"))
    yield _worst("stationary surface, N", 0.1, of("press", 0.0), value("steady_error_N"))
    yield _worst("alignment from 10 degrees, degrees", 0.1, of("align"), value("misalignment_deg"))
    lost = [row for row in ours if "contact_lost" in row]
    yield _worst("contacts lost", 0.0, lost, value("contact_lost"))
    for speed, limit in ((0.02, 1.5), (0.05, 3.0)):
        walls = [row for row in of("wall vanishes", 0.0) if row["speed_m_s"] == speed]
        yield _worst(f"wall vanishes at {speed * 1e3:g} mm/s, mm", limit, walls, value("travel_mm"))
    yield _worst("spikes, ripple, N rms", 0.1, of("spikes", 0.0), value("ripple_N"))
    yield _worst(
        "ten times stiffer, peak relative to its bound", 1.0, of("ten times stiffer", 0.0),
        lambda row: float(row["peak_N"] / row["peak_bound_N"]),
    )  # fmt: skip


def _peers(rows: list[Row]) -> Iterable[Requirement]:
    """Yield reciprocal speed ratios: met when ours is faster by the required factor."""
    one = [_or_never(row["one_s"]) / _or_never(row["first_s"]) for row in rows]
    here = [_or_never(row["tuned_here_s"]) / _or_never(row["identified_s"]) for row in rows]
    scenes = [f"{row['law']}, {row['stiffness_N_m']:g} N/m, {row['delay_ms']} ms" for row in rows]
    yield Requirement(
        "1 / median speed ratio, one setting for all", 1 / 5.0, 1 / float(np.median(one)), ""
    )
    yield Requirement(
        "1 / smallest speed ratio, one setting for all",
        1.0,
        1 / min(one),
        scenes[int(np.argmin(one))],
    )
    yield Requirement(
        "1 / median speed ratio, tuned per scene", 1 / 1.3, 1 / float(np.median(here)), ""
    )
    yield Requirement(
        "1 / smallest speed ratio, tuned per scene",
        1.1,
        1 / min(here),
        scenes[int(np.argmin(here))],
    )


def _fixed(row: Row) -> Requirement:
    lead = _or_never(row["fixed_s"]) / _or_never(row["identified_s"])
    return Requirement(
        "1 / speed ratio to a fixed gain safe at 1e5, at 5e3 N/m", 1 / 12.0, 1 / lead, ""
    )
