"""Summary of a judged force log: rows for the page and the terminal, and the same as JSON."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Any

from cli.report.log_columns import ForceLog
from tuning.force_log import Sampling
from tuning.log_quality import Band, ColumnQuality, LogQuality, SegmentQuality
from tuning.log_steadiness import Drift, Peak

NONE = "-"
FIXED = "\u00a0"  # a space at which no line is broken
SEGMENT_HEAD = (
    "segment",
    "from [s]",
    "to [s]",
    "step",
    "band ±",
    "settling [s]",
    "overshoot [%]",
    "rise [s]",
    "error",
    "ripple RMS",
    "drift per s (95 %)",
    "dominant frequencies",
)
MOST_NAMED = 2  # peaks in a row


@dataclass(frozen=True, slots=True)
class JudgedLog:
    """A log with its judgement."""

    path: Path
    log: ForceLog
    quality: LogQuality
    band: Band
    mean_s: float

    @property
    def unit(self) -> str:
        """Unit of the judged signal."""
        return self.quality.judged.unit


def segment_rows(quality: LogQuality) -> Iterator[tuple[str, ...]]:
    """Yield a row for each segment, in the order of SEGMENT_HEAD."""
    for number, row in enumerate(quality.segments, 1):
        step = row.segment.step
        aimed = (
            NONE
            if step is None
            else f"{row.segment.before:.4g}{FIXED}→{FIXED}{row.segment.target:.4g}"
        )
        yield (
            str(number),
            f"{row.segment.begin_s:.3f}",
            f"{row.segment.end_s:.3f}",
            aimed,
            _number(row.band, ".3g"),
            _settling(row),
            _number(row.overshoot_pct, ".1f"),
            _number(row.rise_s, ".3f"),
            _number(row.error, "+.3g"),
            _number(row.ripple, ".3g"),
            _drift(row.drift),
            _peaks(row),
        )


def sampling_rows(sampling: Sampling) -> Iterator[tuple[str, str]]:
    """Yield name and value of each figure of the times."""
    yield "samples", str(sampling.count)
    yield "duration", f"{sampling.duration_s:.3f} s"
    period_ms = 1e3 * sampling.period_s
    yield "period, median", f"{period_ms:.4g} ms ({sampling.rate_hz:.4g} per s)"
    yield "jitter, standard deviation", f"{1e3 * sampling.jitter_s:.3g} ms"
    yield "jitter, largest", f"{1e3 * sampling.worst_s:.3g} ms"
    yield "gaps", f"{len(sampling.gaps)}, {sampling.missing_s:.3g} s in total"
    yield "repeated times", str(sampling.repeated)


def summary_lines(judged: JudgedLog) -> Iterator[str]:
    """Yield what is printed below the table of segments."""
    for finding in judged.quality.findings:
        yield f"finding: {finding.text}"
    if not judged.quality.findings:
        yield "no findings"
    for note in judged.log.notes:
        yield f"note: {note}"


def headline(judged: JudgedLog) -> str:
    """Return one line about the log."""
    sampling = judged.quality.sampling
    return (
        f"{judged.path.name}: {sampling.duration_s:.1f} s, {sampling.count} samples, "
        f"{sampling.rate_hz:.4g} per s; judged: {judged.quality.judged.name} [{judged.unit}]"
    )


def as_json_tree(judged: JudgedLog) -> dict[str, Any]:
    """Return everything as a tree for JSON; None is a figure that is not defined."""
    quality = judged.quality
    return {
        "file": str(judged.path),
        "axis": quality.judged.name,
        "unit": quality.judged.unit,
        "band": {
            "value": judged.band.value,
            "unit": "%" if judged.band.is_percent else judged.unit,
        },
        "mean_s": judged.mean_s,
        "sampling": _sampling_tree(quality.sampling),
        "segments": [_segment_tree(row) for row in quality.segments],
        "columns": [_column_tree(row) for row in quality.columns],
        "findings": [{"kind": each.kind, "text": each.text} for each in quality.findings],
        "notes": list(judged.log.notes),
    }


def _sampling_tree(sampling: Sampling) -> dict[str, Any]:
    return {
        "samples": sampling.count,
        "duration_s": sampling.duration_s,
        "period_s": sampling.period_s,
        "jitter_s": sampling.jitter_s,
        "largest_jitter_s": sampling.worst_s,
        "gaps": [{"begin_s": gap.begin_s, "length_s": gap.length_s} for gap in sampling.gaps],
        "repeated_times": sampling.repeated,
    }


def _column_tree(row: ColumnQuality) -> dict[str, Any]:
    return {
        "name": row.column.name,
        "unit": row.column.unit,
        "missing": row.column.missing,
        "constant": row.constant,
        "flat_tops": [
            {
                "value": top.value,
                "places": top.places,
                "samples": top.samples,
                "longest": top.longest,
            }
            for top in row.tops
        ],
    }


def _segment_tree(row: SegmentQuality) -> dict[str, Any]:
    drift, spectrum = row.drift, row.spectrum
    return {
        "begin_s": row.segment.begin_s,
        "end_s": row.segment.end_s,
        "before": row.segment.before,
        "target": row.segment.target,
        "band": row.band,
        "settled": None if row.band is None else row.settling_s is not None,
        "settling_s": row.settling_s,
        "overshoot_pct": row.overshoot_pct,
        "rise_s": row.rise_s,
        "steady_begin_s": row.steady_begin_s,
        "error": row.error,
        "ripple_rms": row.ripple,
        "drift_per_s": None if drift is None else drift.slope,
        "drift_bound_per_s": None if drift is None else drift.bound,
        "peaks": [
            {"frequency_hz": peak.frequency_hz, "amplitude": peak.amplitude}
            for peak in (spectrum.peaks if spectrum is not None else ())
        ],
    }


def peak_text(peak: Peak) -> str:
    """Return frequency and RMS of a peak."""
    return f"{peak.frequency_hz:.3g} Hz ({peak.amplitude / sqrt(2.0):.2g} RMS)"


def _settling(row: SegmentQuality) -> str:
    if row.band is None:
        return NONE
    return "not settled" if row.settling_s is None else f"{row.settling_s:.3f}"


def _drift(drift: Drift | None) -> str:
    if drift is None:
        return NONE
    bound = "?" if drift.bound is None else f"{drift.bound:.2g}"
    return f"{drift.slope:+.2g}{FIXED}±{FIXED}{bound}"


def _peaks(row: SegmentQuality) -> str:
    if row.spectrum is None or not row.spectrum.peaks:
        return NONE
    return ", ".join(peak_text(peak) for peak in row.spectrum.peaks[:MOST_NAMED])


def _number(value: float | None, form: str) -> str:
    return NONE if value is None else format(value, form)
