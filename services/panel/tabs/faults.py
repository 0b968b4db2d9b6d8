"""Faults tab: present trips with their remedies, `clear`, and the fault history."""

import viser

from forcemesh.client.ask import remedy_of
from forcemesh.faults import trip_text
from forcemesh.messages import Trip
from services.panel.faultlog import Happened
from services.panel.markup import Html, html, joined, paragraphs
from services.panel.status_bar import services
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, Viewer, put
from services.panel.watch import Snapshot

SHOWN = 12
NOTHING = paragraphs("no faults while this panel was open; recordings contain earlier ones")


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    gui = viewer.gui
    now = Prose(gui, paragraphs("…"))
    clear = viewer.button(
        "Clear",
        lambda: viewer.do("Clear", lambda cell: cell.clear().text),
        icon=viser.Icon.CHECK,
        hint="Acknowledges; does not arm.",
    )
    with gui.add_folder("History"):
        before = Prose(gui, NOTHING)

    def refresh(snapshot: Snapshot) -> None:
        now.show(now_text(snapshot))
        before.show(log_text(viewer.log.newest()))
        status = snapshot.arbiter.fresh
        put(clear, disabled=status is None or not status.trips)

    return refresh


def now_text(snapshot: Snapshot) -> Html:
    """Return the present trips, with the remedy of each."""
    if snapshot.hub_fault:
        return paragraphs(f"⚠ {snapshot.hub_fault}")
    status = snapshot.arbiter.fresh
    if status is None:
        return paragraphs(f"⚠ {snapshot.arbiter.fault}")
    reasons: list[Html | str] = [
        html("✖ <code>{}</code> ({}) {}{}", trip.code, trip.rule, trip_text(trip), _remedy(trip))
        for trip in status.trips
    ]
    reasons += [f"not ready: {text}" for text in status.not_ready]
    clears = [f"→ {status.clears}"] if status.clears else []
    silent = [f"⚠ {row['name']}: {row['fault']}" for row in services(snapshot) if row["fault"]]
    state = html("<b>{}</b>", status.state)
    return paragraphs(state, *(reasons or ["no fault"]), *clears, *silent)


def _remedy(trip: Trip) -> Html:
    remedy = remedy_of(trip.code)
    return html("<br><i>{}</i>", remedy) if remedy else html("")


def log_text(happened: tuple[Happened, ...]) -> Html:
    """Return the newest entries of the fault log."""
    if not happened:
        return NOTHING
    row = "<p>{} <b>{}</b> <code>{}</code> {}{}</p>"
    return joined(
        html(row, one.at, one.state, one.trip.code, trip_text(one.trip), _remedy(one.trip))
        for one in happened[:SHOWN]
    )


TAB = Tab(90, "Faults", viser.Icon.ALERT_TRIANGLE, build)
