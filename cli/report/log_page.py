"""Page of a judged force log: one self-contained HTML file with tables, plots and definitions."""

from collections.abc import Iterator

import numpy as np

from cli.pages import chart, legend_above, picture, table
from cli.report.log_summary import (
    SEGMENT_HEAD,
    JudgedLog,
    peak_text,
    sampling_rows,
    segment_rows,
)
from services.panel.markup import Html, filled_page, html, joined, paragraphs
from tuning.flat_tops import LEAST_RUN
from tuning.force_log import GAP_FACTOR, Signal
from tuning.log_quality import (
    HELD_SHARE,
    MOST_JITTER_SHARE,
    MOST_OVERSHOOT_PCT,
    OSCILLATION_SHARE,
    LogColumn,
    SegmentQuality,
)

COLOURS = ("#e8590c", "#2f9e44", "#1971c2")
MEASURED, TARGET, SECTION, FLAT = "#e03131", "#868e96", "#7048e8", "#f08c00"
PLOT_BINS = 1500  # of a plot; each keeps its smallest and its largest sample
LONGEST_GAP_PERIODS = 3.0  # beyond, a line is interrupted


def log_page(judged: JudgedLog) -> Html:
    """Return the whole page."""
    return filled_page(
        "cli.report",
        "log.html",
        title=f"Force log {judged.path.name}",
        origin=f"{judged.path.name} · judged: {judged.quality.judged.name} [{judged.unit}] · "
        f"band {_band(judged)}",
        cards=_cards(judged),
        findings=_findings(judged),
        segments=table(SEGMENT_HEAD, segment_rows(judged.quality)),
        segments_note=f"Step, band, error, ripple and drift in {judged.unit}.",
        plots=joined(_plots(judged)),
        spectrum=_spectra(judged),
        columns=_columns(judged),
        times=table(("figure", "value"), sampling_rows(judged.quality.sampling)),
        definitions=_definitions(judged),
        notes=paragraphs(*judged.log.notes),
    )


def _band(judged: JudgedLog) -> str:
    value = f"± {judged.band.value:g}"
    return f"{value} % of the step" if judged.band.is_percent else f"{value} {judged.unit}"


def _cards(judged: JudgedLog) -> Html:
    sampling, unit = judged.quality.sampling, judged.unit
    steps = [row for row in judged.quality.segments if row.band is not None]
    settled = [row.settling_s for row in steps if row.settling_s is not None]
    overshoots = [row.overshoot_pct for row in steps if row.overshoot_pct is not None]
    ripples = [row.ripple for row in judged.quality.segments if row.ripple is not None]
    cards = [
        (f"{sampling.duration_s:.1f} s", f"{sampling.count} samples, {sampling.rate_hz:.4g} per s"),
        (f"{len(settled)} of {len(steps)}", "steps settled"),
        (len(judged.quality.findings), "findings"),
    ]
    if settled:
        cards.append((f"{max(settled):.3f} s", "longest settling"))
    if overshoots:
        cards.append((f"{max(overshoots):.1f} %", "largest overshoot"))
    if ripples:
        cards.append((f"{max(ripples):.3g} {unit}", "largest ripple, RMS"))
    return joined(html('<div class="card"><b>{}</b><span>{}</span></div>', *card) for card in cards)


def _findings(judged: JudgedLog) -> Html:
    if not judged.quality.findings:
        return html('<p class="sub">No findings.</p>')
    lines = (
        html('<div class="stop"><b>{}</b><br>{}</div>', each.kind.replace("_", " "), each.text)
        for each in judged.quality.findings
    )
    return html("<h2>Findings</h2>{}", joined(lines))


def _plots(judged: JudgedLog) -> Iterator[Html]:
    """Yield a plot of the judged signal, then one for each unit of the log."""
    yield _target_plot(judged)
    columns = judged.quality.columns
    for unit in dict.fromkeys(row.column.unit for row in columns):
        title = f"Columns in {unit}"
        figure, axes = chart(title, "time [s]")
        of_unit = (row for row in columns if row.column.unit == unit)
        for row, colour in zip(of_unit, COLOURS, strict=False):
            name = row.column.name
            axes.plot(*_line(row.column.signal), color=colour, linewidth=1.0, label=name)
            for top in row.tops:
                axes.axhline(top.value, color=FLAT, linewidth=1.0, linestyle=":")
        legend_above(axes)
        yield picture(title, figure)


def _target_plot(judged: JudgedLog) -> Html:
    title = f"{judged.quality.judged.name}, its targets with their bands [{judged.unit}]"
    figure, axes = chart(title, "time [s]")
    axes.plot(*_line(judged.quality.judged.signal), color=MEASURED, linewidth=1.0)
    for row in judged.quality.segments:
        segment = row.segment
        if row.band is None or segment.target is None:
            continue
        low, high = segment.target - row.band, segment.target + row.band
        span_s = (segment.begin_s, segment.end_s)
        axes.axvline(segment.begin_s, color=SECTION, linewidth=1.0, linestyle=":")
        axes.fill_between(span_s, low, high, color=TARGET, alpha=0.25, linewidth=0.0)
        axes.plot(span_s, (segment.target,) * 2, color=TARGET, linewidth=1.0)
        if row.settling_s is not None:
            axes.axvline(
                segment.begin_s + row.settling_s, color=COLOURS[1], linewidth=1.0, linestyle="--"
            )
    return picture(title, figure)


def _line(signal: Signal) -> tuple[list[float], list[float]]:
    """Return times and values of a line: extremes of each bin, interrupted at gaps."""
    period_s = float(np.median(np.diff(signal.time_s)))
    cut = np.flatnonzero(np.diff(signal.time_s) > LONGEST_GAP_PERIODS * period_s) + 1
    count = max(1, len(signal.value) // PLOT_BINS)
    times: list[float] = []
    values: list[float] = []
    for piece_s, piece in zip(
        np.split(signal.time_s, cut), np.split(signal.value, cut), strict=True
    ):
        for at in range(0, len(piece), count):
            part = piece[at : at + count]
            for place in sorted({int(np.argmin(part)), int(np.argmax(part))}):
                times.append(float(piece_s[at + place]))
                values.append(float(part[place]))
        times.append(float(piece_s[-1]))
        values.append(float("nan"))
    return times, values


def _spectra(judged: JudgedLog) -> Html:
    """Return the spectrum with the largest peak, else of the longest steady part, and its peaks."""
    rows = [row for row in judged.quality.segments if row.spectrum is not None]
    if not rows:
        return paragraphs("No steady part is long enough for a spectrum.")
    row = max(rows, key=_prominence)
    return joined((_spectrum(row, judged), _peaks(row, judged.unit)))


def _prominence(row: SegmentQuality) -> tuple[float, float]:
    peaks = row.spectrum.peaks if row.spectrum is not None else ()
    largest = max((peak.amplitude for peak in peaks), default=0.0)
    return largest, row.segment.end_s - row.steady_begin_s


def _spectrum(row: SegmentQuality, judged: JudgedLog) -> Html:
    assert row.spectrum is not None  # noqa: S101 - chosen by the caller
    number = judged.quality.segments.index(row) + 1
    title = f"Segment {number}, steady part: density [{judged.unit}/√Hz]"
    figure, axes = chart(title, "frequency [Hz]")
    density = np.sqrt(row.spectrum.density[1:])
    if np.max(density) > 0.0:
        axes.semilogy(row.spectrum.frequency_hz[1:], density, color=SECTION, linewidth=1.0)
    for peak in row.spectrum.peaks:
        axes.axvline(peak.frequency_hz, color=FLAT, linewidth=1.0, linestyle=":")
    return picture(title, figure)


def _peaks(row: SegmentQuality, unit: str) -> Html:
    peaks = row.spectrum.peaks if row.spectrum is not None else ()
    if not peaks:
        return paragraphs("No frequency stands out from the noise.")
    return paragraphs(f"Dominant, RMS in {unit}: {', '.join(peak_text(peak) for peak in peaks)}")


def _columns(judged: JudgedLog) -> Html:
    head = ("column", "unit", "smallest", "mean", "largest", "missing", "flat tops")
    rows = []
    for row in judged.quality.columns:
        tops = ", ".join(f"{top.value:.5g}: {top.samples} samples" for top in row.tops) or "none"
        rows.append((row.column.name, row.column.unit, *_range(row.column), tops))
    return table(head, rows)


def _range(column: LogColumn) -> tuple[str, str, str, int]:
    value = column.signal.value
    low, mean, high = float(np.min(value)), float(np.mean(value)), float(np.max(value))
    return f"{low:.4g}", f"{mean:.4g}", f"{high:.4g}", column.missing


def _definitions(judged: JudgedLog) -> Html:
    mean = f" in moving means of {1e3 * judged.mean_s:g} ms" if judged.mean_s else ""
    return paragraphs(
        "Segment: from one step of the set point to the next; a ramp is one step. Without a "
        "recorded set point the steps are those of the force itself, and the target is the median "
        "of the last fifth of the segment unless a constant set point is given.",
        f"Settling: time from the step until the force{mean} stays within {_band(judged)} of the "
        f"target, for at least {100.0 * HELD_SHARE:.0f} % of the segment. Overshoot: largest "
        "excess over the target, in percent of the step. Rise: from 10 % to 90 % of the step.",
        "Steady part: from twice the settling time to the end of the segment, at least the second "
        "half of what is settled; the second half of a segment that does not settle. Error: mean "
        "minus target. Ripple: RMS about the straight line of least squares. Drift: slope of this "
        "line with its 95 % interval, for correlated samples (Santer et al. 2000). Spectrum: Welch "
        "1967, Hann's window; a peak would be reached by noise alone in one log of a thousand, and "
        "needs 14 periods.",
        f"Findings: overshoot above {MOST_OVERSHOOT_PCT:.0f} %; a significant drift by more than "
        f"half the band; one frequency with more than {100.0 * OSCILLATION_SHARE:.0f} % of the "
        f"ripple's power; at least {LEAST_RUN} equal samples in a row at an extreme value, entered "
        f"or left at full slope; distances above {GAP_FACTOR:.0f} periods (gaps); jitter above "
        f"{100.0 * MOST_JITTER_SHARE:.0f} % of the period; missing values, which are gaps and "
        "never zeros.",
    )
