"""Page of a report: one self-contained HTML file with plots and the arm's motion in 3D."""

from contextlib import redirect_stdout
from datetime import UTC, datetime
from io import StringIO
from statistics import median_high

from cli.pages import chart, legend_above, picture, table
from cli.recording_tables import shortened
from cli.replay import free_port
from cli.report.contacts import contact_table
from cli.report.data import ReportContent, sampled_snapshots
from common.config.cell import CellConfig
from forcemesh.client.ask import remedy_of
from services.panel.markup import Html, filled_page, html, joined
from services.panel.state_colours import NO_STATE, STATE_COLOURS
from services.recorder.reading import RecordedFile

# Title, and the lines with their colours.
PLOTS: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("Press force [N]", (("press", "#e03131"), ("set point", "#868e96"))),
    (
        "Force of the environment on the tool [N]",
        (("Fx", "#e8590c"), ("Fy", "#2f9e44"), ("Fz", "#1971c2")),
    ),
    ("Torque about the TCP [N m]", (("Mx", "#e8590c"), ("My", "#2f9e44"), ("Mz", "#1971c2"))),
    ("Tracking error [mm]", (("distance", "#7048e8"),)),
    ("Latency from sensor sample to robot [ms]", (("chain", "#0c8599"),)),
)
LABELS = {"press": "measured"}
FASTEST_HZ = 20.0  # of the 3D replay
MOST_FRAMES = 4000
MOST_LISTED = 200
LONGEST_CELL = 120  # characters of a table's cell
SPAN = '<span title="{}" style="flex:{} 0 0;{}">{}</span>'
REPLAY = (
    '<h2>Replay</h2><p class="sub">Drag to rotate, scroll to zoom; the bar below plays and '
    'scrubs.</p><iframe title="3D replay" srcdoc="{}"></iframe>'
)


def page_of(read: "RecordedFile", content: "ReportContent", scene: Html, forecasts: Html) -> Html:
    """Return the whole page."""
    about = read.about
    begin = datetime.fromtimestamp(content.begin_ns / 1e9, UTC)
    cause = "requested" if about["cause"] == "asked" else f"triggered by {about['cause']}"
    broken = "" if read.is_whole else " · truncated: its recorder was killed"
    return filled_page(
        "cli.report",
        "report.html",
        title=f"Cell {about['cell']}, {begin:%Y-%m-%d %H:%M:%S UTC}",
        origin=f"{read.path.name} · {cause} · forcemesh {about['version']} · "
        f"configuration {about['config_hash']}{broken}",
        cards=_cards(content),
        states=_states(content),
        stops=_stops(content),
        requests=_requests(content),
        contacts=contact_table(content.contacts),
        forecasts=forecasts,
        plots=_plots(content),
        scene=scene,
        topics=_topics(content),
    )


def _cards(content: "ReportContent") -> Html:
    rows = content.statistics.values()
    chain = [value for value in content.series.get("chain", []) if value == value]  # noqa: PLR0124 - not NaN
    cards = [
        (f"{content.duration_s:.1f} s", "recorded"),
        (f"{content.force_max_N:.1f} N", "largest force"),
        (f"{content.torque_max_Nm:.2f} N m", "largest torque"),
        (len(content.stops), "stops"),
        (sum(row.count for row in rows), f"messages, {sum(row.gaps.lost for row in rows)} lost"),
    ]
    if chain:
        cards.append((f"{median_high(chain):.1f} ms", "sensor to robot, median"))
    if content.unreadable:
        cards.append((content.unreadable, "messages that cannot be decoded"))
    return joined(html('<div class="card"><b>{}</b><span>{}</span></div>', *card) for card in cards)


def _states(content: "ReportContent") -> Html:
    if not content.states:
        return html("")
    ends = [*(at_s for at_s, _ in content.states[1:]), content.duration_s]
    spans = []
    for (at_s, state), end_s in zip(content.states, ends, strict=True):
        colour = STATE_COLOURS.get(state, NO_STATE)  # it may be a state of another version
        style = f"background:{colour.background};color:{colour.text}"
        share, period = max(end_s - at_s, 0.0), f"{state} {at_s:.2f} s to {end_s:.2f} s"
        spans.append(html(SPAN, period, f"{share:.3f}", style, state))
    return html('<h2>Arbiter states</h2><div class="bar">{}</div>', joined(spans))


def _stops(content: "ReportContent") -> Html:
    if not content.stops:
        return html('<p class="sub">The arm was not stopped.</p>')
    lines = []
    for stop in content.stops:
        trip, advice = stop.trip, remedy_of(stop.trip.code)  # none for a code of another version
        title = f"{stop.at_s:.2f} s · {stop.state} · {trip.code} ({trip.rule})"
        remedy = html("<br>Remedy: {}", advice) if advice else ""
        lines.append(html('<div class="stop"><b>{}</b><br>{}{}</div>', title, trip.text, remedy))
    return html("<h2>Stops</h2>{}", joined(lines))


def _requests(content: "ReportContent") -> Html:
    """Return a table of the requests with their replies, the newest ones if there are many."""
    if not content.requests:
        return html("")
    rows = (
        (
            f"{at_s:.2f}",
            served.request.removeprefix("request/"),
            shortened(served.payload, LONGEST_CELL),
            "" if served.reply is None else shortened(served.reply.text, LONGEST_CELL),
            served.sender,
        )
        for at_s, served in content.requests[-MOST_LISTED:]
    )
    columns = ("time [s]", "request", "fields", "reply", "sender")
    omitted = len(content.requests) - MOST_LISTED
    note = html('<p class="sub">without the first {}</p>', omitted) if omitted > 0 else html("")
    return html('<h2>Requests</h2>{}<div class="scroll">{}</div>', note, table(columns, rows))


def _topics(content: "ReportContent") -> Html:
    rows = (
        (key, row.count, f"{row.rate_hz:.1f}", f"{1e3 * row.longest_gap_s:.0f}", row.gaps.lost)
        for key, row in sorted(content.statistics.items())
    )
    return table(("topic", "messages", "rate [1/s]", "longest gap [ms]", "lost"), rows)


def _plots(content: "ReportContent") -> Html:
    """Return one plot for each title with data."""
    available = {
        title: [(name, colour) for name, colour in lines if name in content.series]
        for title, lines in PLOTS
    }
    return joined(_plot(content, title, lines) for title, lines in available.items() if lines)


def _plot(content: "ReportContent", title: str, lines: list[tuple[str, str]]) -> Html:
    figure, axes = chart(title, "time [s]")
    for name, colour in lines:
        label = LABELS.get(name, name)
        axes.plot(content.times_s, content.series[name], color=colour, linewidth=1.0, label=label)
    for stop in content.stops:
        axes.axvline(stop.at_s, color="#e03131", linewidth=1.0, linestyle=":")
    axes.set_xlim(0.0, max(content.duration_s, 1e-3))
    if len(lines) > 1:
        legend_above(axes)
    return picture(title, figure)


def scene_of(read: "RecordedFile", cell: "CellConfig", content: "ReportContent") -> Html:
    """Return the panel's view of the arm's motion, played by the page itself, without a server."""
    import viser

    from services.panel.scene import Scene

    with redirect_stdout(StringIO()):  # it prints a greeting in any case
        server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        scene = Scene(server, cell)
        serializer = server.get_scene_serializer()
        rate_hz = min(FASTEST_HZ, MOST_FRAMES / max(content.duration_s, 1.0))
        last_s = 0.0
        for at_s, snapshot in sampled_snapshots(read, content.begin_ns, rate_hz):
            serializer.insert_sleep(max(at_s - last_s, 0.0))
            last_s = at_s
            scene.draw(snapshot)
        serializer.insert_sleep(max(content.duration_s - last_s, 0.0))
        page: str = serializer.as_html()
    finally:
        with redirect_stdout(StringIO()):
            server.stop()
    return html(REPLAY, page)
