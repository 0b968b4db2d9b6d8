"""Page of a report: one self-contained HTML file."""

from datetime import UTC, datetime
from html import escape
from typing import TYPE_CHECKING

from services.panel.state_colours import NO_STATE, STATE_COLOURS

if TYPE_CHECKING:
    from cli.report.data import ReportContent
    from services.recorder.reading import RecordedFile

STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 960px; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.sub { color: #868e96; margin-top: .2rem; overflow-wrap: anywhere; }
.cards { display: flex; flex-wrap: wrap; gap: .75rem; margin: 1.2rem 0; }
.card { border: 1px solid #868e9655; border-radius: 8px; padding: .5rem .9rem; min-width: 8rem; }
.card b { display: block; font-size: 1.25rem; } .card span { color: #868e96; font-size: .8rem; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; }
th, td { text-align: left; padding: .25rem .6rem .25rem 0; border-bottom: 1px solid #868e9633; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
svg { width: 100%; height: auto; } .plot { margin: .3rem 0; }
.bar { display: flex; height: 1.4rem; border-radius: 6px; overflow: hidden; }
.bar span { font-size: .7rem; color: #fff; overflow: hidden; padding: .15rem 0; }
.bar span { text-align: center; }
.stop { border-left: 4px solid #e03131; padding: .3rem .8rem; margin: .6rem 0; }
iframe { width: 100%; height: 540px; border: 0; border-radius: 8px; }
.scroll { overflow-x: auto; }
"""


def page_of(read: "RecordedFile", content: "ReportContent", plots: list[str], scene: str) -> str:
    """Return the whole page."""
    about = read.about
    begin_text = datetime.fromtimestamp(content.begin_ns / 1e9, UTC).strftime(
        "%Y-%m-%d %H:%M:%S UTC"
    )
    title = f"Cell {about['cell']}, {begin_text}"
    broken = "" if read.is_whole else " · truncated: its recorder was killed"
    cause = "requested" if about["cause"] == "asked" else f"triggered by {about['cause']}"
    sub = (
        f"{read.path.name} · {cause} · forcemesh {about['version']} · "
        f"configuration {about['config_hash']}{broken}"
    )
    parts = [
        f"<h1>{escape(title)}</h1><p class=sub>{escape(sub)}</p>",
        _cards(content),
        _states(content),
        _stops(content),
        "<h2>Over time</h2>",
        *(f"<div class=plot>{plot}</div>" for plot in plots),
        _scene(scene),
        _topics(content),
    ]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    view = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    body = "\n".join(part for part in parts if part)
    return f'<!doctype html><html lang="en"><head>{head}{view}</head><body>{body}</body></html>\n'


def _cards(content: "ReportContent") -> str:
    lost = sum(row.lost for row in content.statistics.values())
    messages = sum(row.count for row in content.statistics.values())
    chain = sorted(value for value in content.series.get("chain", []) if value == value)  # noqa: PLR0124 - not NaN
    cards = [
        (f"{content.duration_s:.1f} s", "recorded"),
        (f"{content.force_max_N:.1f} N", "largest force"),
        (f"{content.torque_max_Nm:.2f} N m", "largest torque"),
        (f"{len(content.stops)}", "stops"),
        (f"{messages}", f"messages, {lost} lost"),
    ]
    if chain:
        cards.append((f"{chain[len(chain) // 2]:.1f} ms", "sensor to robot, median"))
    if content.unreadable:
        cards.append((f"{content.unreadable}", "messages that cannot be decoded"))
    inside = "".join(f"<div class=card><b>{b}</b><span>{s}</span></div>" for b, s in cards)
    return f"<div class=cards>{inside}</div>"


def _states(content: "ReportContent") -> str:
    ends = [*(at_s for at_s, _ in content.states[1:]), content.duration_s]
    spans = "".join(
        f'<span title="{escape(state)} {at_s:.2f} s to {end_s:.2f} s" style="flex:'
        f'{max(end_s - at_s, 0.0):.3f} 0 0;{_colours(state)}">'
        f"{escape(state)}</span>"
        for (at_s, state), end_s in zip(content.states, ends, strict=True)
    )
    return f"<h2>Arbiter states</h2><div class=bar>{spans}</div>" if spans else ""


def _colours(state: str) -> str:
    """Return the colours of a state as CSS; a recording may have a state of another version."""
    known = {str(name): colour for name, colour in STATE_COLOURS.items()}
    background, text = known.get(state, NO_STATE)
    return f"background:{background};color:{text}"


def _stops(content: "ReportContent") -> str:
    if not content.stops:
        return "<p class=sub>The arm was not stopped.</p>"
    return "<h2>Stops</h2>" + "".join(
        f"<div class=stop><b>{stop.at_s:.2f} s · {escape(stop.state)} · "
        f"{escape(stop.trip.code)} ({stop.trip.rule})</b><br>{escape(stop.trip.text)}"
        f"{'<br>Remedy: ' + escape(stop.remedy) if stop.remedy else ''}</div>"
        for stop in content.stops
    )


def _scene(scene: str) -> str:
    if not scene:
        return ""
    return (
        "<h2>Replay</h2><p class=sub>Drag to rotate, scroll to zoom; the bar below plays and "
        f'scrubs.</p><iframe title="3D replay" srcdoc="{escape(scene)}"></iframe>'
    )


def _topics(content: "ReportContent") -> str:
    rows = "".join(
        f"<tr><td>{escape(key)}</td><td class=n>{row.count}</td>"
        f"<td class=n>{row.rate_hz:.1f}</td>"
        f"<td class=n>{1e3 * row.longest_gap_s:.0f}</td><td class=n>{row.lost}</td></tr>"
        for key, row in sorted(content.statistics.items())
    )
    head = "<th>topic</th><th class=n>messages</th><th class=n>rate [1/s]</th>"
    head += "<th class=n>longest gap [ms]</th><th class=n>lost</th>"
    return f"<h2>Topics</h2><div class=scroll><table><tr>{head}</tr>{rows}</table></div>"
