"""Quality of a force log: a row for each segment, and the findings that need attention. Pure.

Definitions, for a segment that begins with a step from `before` to `target`:

- settling: time from the step until the force, in moving means, stays within the band about the
  target to the end, for at least HELD_SHARE of the segment. A single sample of a noisy sensor is no
  motion of the arm, hence the means. (MATLAB's stepinfo: single samples, 2 % of the step);
- overshoot: largest excess of a sample over the target in the direction of the step, in percent of
  the step; the noise of the sensor is in it;
- rise: time from 10 % to 90 % of the step, of single samples;
- steady part: from twice the settling time to the end, so that the rest of the response is neither
  ripple nor drift, and at least the second half of the settled part; the second half of a segment
  that does not settle; the whole segment where no step begins it. Error, ripple, drift and spectrum
  are of this part.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tuning.flat_tops import FlatTop, flat_tops, is_constant
from tuning.force_log import LEAST_SAMPLES, Sampling, Signal, sampling_of
from tuning.log_segments import LogSegment, segments_of
from tuning.log_steadiness import Drift, Spectrum, drift_of, ripple_of, spectrum_of

HELD_SHARE = 0.1  # of a segment, within the band until its end
MOST_OVERSHOOT_PCT = 10.0
MOST_JITTER_SHARE = 0.2  # of the period
OSCILLATION_SHARE = 0.5  # of the ripple's power in one frequency
RISE_FROM, RISE_TO = 0.1, 0.9  # of the step


@dataclass(frozen=True, slots=True)
class Band:
    """Half the width of the band in which a force counts as settled."""

    value: float  # in percent of the step, or in the unit of the signal
    is_percent: bool

    def width(self, step: float) -> float:
        """Return the half width for a step, in the unit of the signal."""
        return abs(step) * self.value / 100.0 if self.is_percent else self.value


@dataclass(frozen=True, slots=True)
class LogColumn:
    """One force or torque of a log."""

    name: str
    unit: str  # N or N m
    signal: Signal
    missing: int  # samples without a value


@dataclass(frozen=True, slots=True)
class SegmentQuality:
    """Figures of one segment, in the unit of its signal; None: not defined here."""

    segment: LogSegment
    band: float | None
    settling_s: float | None  # None after a step: not settled
    overshoot_pct: float | None
    rise_s: float | None
    steady_begin_s: float
    error: float | None  # mean of the steady part minus the target
    ripple: float | None  # None: too few samples in the steady part
    drift: Drift | None
    spectrum: Spectrum | None


@dataclass(frozen=True, slots=True)
class ColumnQuality:
    """Figures of one column over the whole log."""

    column: LogColumn
    tops: tuple[FlatTop, ...]
    constant: bool


@dataclass(frozen=True, slots=True)
class LogFinding:
    """Condition that needs attention: a kind for programs, a sentence for readers."""

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class LogQuality:
    """Judgement of a whole log."""

    sampling: Sampling
    judged: LogColumn
    segments: tuple[SegmentQuality, ...]
    columns: tuple[ColumnQuality, ...]
    findings: tuple[LogFinding, ...]


def quality_of(
    columns: Sequence[LogColumn],
    judged: LogColumn,
    setpoint: Signal | float | None,
    *,
    band: Band,
    mean_s: float = 0.0,
) -> LogQuality:
    """Return the judgement of a log.

    Args:
        columns: Every force and torque, at least LEAST_SAMPLES each.
        judged: The one that follows the set point, with the set point's sign.
        setpoint: Recorded or constant set point, in the unit of `judged`; None: the final levels.
        band: Band of settling.
        mean_s: Length of the moving mean from which settling is taken [s]; 0: single samples.
    """
    sampling = sampling_of(judged.signal.time_s)
    mean = judged.signal.averaged(mean_s)
    segments = tuple(
        segment_quality(segment, judged.signal, mean, band=band, period_s=sampling.period_s)
        for segment in segments_of(judged.signal, setpoint)
    )
    rows = tuple(column_quality(column) for column in columns)
    findings = (
        *_of_times(sampling),
        *_of_steps(segments),
        *(
            each
            for number, row in enumerate(segments, 1)
            for each in _of_segment(f"segment {number}", row, judged.unit)
        ),
        *(each for row in rows for each in _of_column(row)),
    )
    return LogQuality(sampling, judged, segments, rows, findings)


def segment_quality(
    segment: LogSegment, signal: Signal, mean: Signal, *, band: Band, period_s: float
) -> SegmentQuality:
    """Return the figures of one segment.

    Args:
        segment: The segment.
        signal: The whole signal.
        mean: Its moving mean, for settling.
        band: Band of settling.
        period_s: Period of the samples.
    """
    inside = signal.between(segment.begin_s, segment.end_s)
    settling_s = width = overshoot = rise_s = None
    begin_s = segment.begin_s
    if segment.step and segment.target is not None and len(inside.value):
        width = band.width(segment.step)
        means = mean.between(segment.begin_s, segment.end_s)
        settling_s = _settling_s(means, segment, width)
        overshoot = _overshoot_pct(inside, segment.target, segment.step)
        rise_s = _rise_s(inside, segment.target - segment.step, segment.step)
        begin_s = _steady_begin_s(segment, settling_s)
    steady = signal.between(begin_s, segment.end_s)
    enough = len(steady.value) >= LEAST_SAMPLES
    has_error = enough and segment.target is not None
    return SegmentQuality(
        segment,
        width,
        settling_s,
        overshoot,
        rise_s,
        begin_s,
        error=float(np.mean(steady.value)) - (segment.target or 0.0) if has_error else None,
        ripple=ripple_of(steady) if enough else None,
        drift=drift_of(steady) if enough else None,
        spectrum=spectrum_of(steady, period_s) if enough else None,
    )


def column_quality(column: LogColumn) -> ColumnQuality:
    """Return the figures of one column."""
    value = column.signal.value
    return ColumnQuality(column, tuple(flat_tops(value)), is_constant(value))


def _steady_begin_s(segment: LogSegment, settling_s: float | None) -> float:
    settled_s = segment.begin_s + (settling_s or 0.0)
    half_s = 0.5 * (segment.end_s - settled_s)
    return settled_s + (half_s if settling_s is None else min(settling_s, half_s))


def _settling_s(inside: Signal, segment: LogSegment, width: float) -> float | None:
    outside = np.flatnonzero(np.abs(inside.value - (segment.target or 0.0)) > width)
    if len(outside) == 0:
        return 0.0
    last = int(outside[-1])
    held_s = segment.end_s - float(inside.time_s[last])
    if last + 1 == len(inside.value) or held_s < HELD_SHARE * (segment.end_s - segment.begin_s):
        return None
    return float(inside.time_s[last + 1]) - segment.begin_s


def _overshoot_pct(inside: Signal, target: float, step: float) -> float:
    excess = float(np.max((inside.value - target) * np.sign(step)))
    return max(0.0, 100.0 * excess / abs(step))


def _rise_s(inside: Signal, before: float, step: float) -> float | None:
    share = (inside.value - before) / step
    if np.max(share) < RISE_TO:
        return None
    first = float(inside.time_s[int(np.argmax(share >= RISE_FROM))])
    return float(inside.time_s[int(np.argmax(share >= RISE_TO))]) - first


def _of_times(sampling: Sampling) -> Iterator[LogFinding]:
    period_ms = 1e3 * sampling.period_s
    if sampling.gaps:
        longest = max(sampling.gaps, key=lambda gap: gap.length_s)
        yield LogFinding(
            "gaps",
            f"gaps in the samples: {len(sampling.gaps)}, {sampling.missing_s:.3g} s in total; the "
            f"longest is {longest.length_s:.3g} s at {longest.begin_s:.3f} s",
        )
    if sampling.jitter_s > MOST_JITTER_SHARE * sampling.period_s:
        yield LogFinding(
            "jitter",
            f"the times are uneven: standard deviation {1e3 * sampling.jitter_s:.3g} ms of a "
            f"period of {period_ms:.3g} ms",
        )
    if sampling.repeated:
        yield LogFinding(
            "repeated_times",
            f"{sampling.repeated} of {sampling.count} samples have the time of the sample before: "
            "the clock of the log is too coarse, or samples are stored twice",
        )


def _of_steps(segments: Sequence[SegmentQuality]) -> Iterator[LogFinding]:
    if all(row.band is None for row in segments):
        text = "no step was found: settling, overshoot and rise need one, or its set point"
        yield LogFinding("no_step", text)


def _of_segment(place: str, row: SegmentQuality, unit: str) -> Iterator[LogFinding]:
    if row.band is not None and row.settling_s is None:
        ripple = "" if row.ripple is None else f"; ripple {row.ripple:.3g} {unit} RMS"
        text = (
            f"{place}: the force does not stay within {row.band:.3g} {unit} of its target{ripple}"
        )
        yield LogFinding("not_settled", text)
    if row.overshoot_pct is not None and row.overshoot_pct > MOST_OVERSHOOT_PCT:
        text = f"{place}: overshoot {row.overshoot_pct:.0f} % of the step"
        yield LogFinding("overshoot", text)
    if row.band is not None and row.drift is not None and row.drift.is_significant:
        travelled = abs(row.drift.slope) * (row.segment.end_s - row.steady_begin_s)
        if travelled > row.band / 2.0:
            text = f"{place}: the steady force drifts by {travelled:.3g} {unit}"
            yield LogFinding("drift", text)
    if row.spectrum is not None and row.ripple and row.spectrum.peaks:
        peak = row.spectrum.peaks[0]
        if peak.amplitude**2 / 2.0 > OSCILLATION_SHARE * row.ripple**2:
            text = (
                f"{place}: the ripple is an oscillation of {peak.frequency_hz:.3g} Hz with an "
                f"amplitude of {peak.amplitude:.3g} {unit}"
            )
            yield LogFinding("oscillation", text)


def _of_column(row: ColumnQuality) -> Iterator[LogFinding]:
    name, unit = row.column.name, row.column.unit
    if row.constant:
        yield LogFinding("constant", f"{name} never changes: is its channel connected?")
    if row.column.missing:
        yield LogFinding("missing", f"{name} has no value in {row.column.missing} rows: gaps")
    for top in row.tops:
        yield LogFinding(
            "flat_top",
            f"{name} is flat at {top.value:.6g} {unit}: places {top.places}, samples "
            f"{top.samples}, at most {top.longest} in a row: clipped by a range of the sensor, of "
            "the converter or of the software?",
        )
