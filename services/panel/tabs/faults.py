"""What stopped the arm, what to do about it, and `clear`."""

import viser

from common.faults import FAULTS
from common.messages import ArbiterStatus
from services.panel.faultlog import Happened
from services.panel.strip import services
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Viewer
from services.panel.watch import Snapshot

SHOWN = 12
NOTHING = "nothing since somebody looks at this panel; recordings have what was before"


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    gui = viewer.gui
    now = gui.add_markdown("…")
    clear = gui.add_button("Clear", icon=viser.Icon.CHECK, hint="Acknowledge; arming comes after.")
    clear.on_click(lambda _event: viewer.do("Clear", lambda cell: cell.clear().text))
    with gui.add_folder("What happened"):
        before = gui.add_markdown(NOTHING)

    def refresh(heard: Snapshot) -> None:
        for handle, text in ((now, now_text(heard)), (before, log_text(viewer.log.newest()))):
            if handle.content != text:
                handle.content = text
        stopped = heard.arbiter.fresh is not None and bool(heard.arbiter.fresh.trips)
        if clear.disabled == stopped:
            clear.disabled = not stopped

    return refresh


def now_text(heard: Snapshot) -> str:
    """Return what stops the arm now, with the remedy of each reason."""
    if heard.hub_fault:
        return f"⚠ {heard.hub_fault}"
    status = heard.arbiter.fresh
    if status is None:
        return f"⚠ {heard.arbiter.fault}"
    lines = [f"**{status.state}**", *_reasons(status)]
    if status.clears:
        lines.append(f"→ {status.clears}")
    silent = [f"⚠ {row['name']}: {row['fault']}" for row in services(heard) if row["fault"]]
    return "\n\n".join([*lines, *silent])


def _reasons(status: ArbiterStatus) -> list[str]:
    lines = [
        f"✖ `{trip.code}` ({trip.rule}) {trip.text}  \n*{_remedy(trip.code)}*"
        for trip in status.trips
    ]
    lines += [f"not ready: {text}" for text in status.not_ready]
    return lines or ["nothing stops the arm"]


def _remedy(code: str) -> str:
    row = FAULTS.get(code)
    return "" if row is None else row.remedy


def log_text(happened: tuple[Happened, ...]) -> str:
    """Return the newest of what has happened."""
    if not happened:
        return NOTHING
    return "\n\n".join(
        f"{one.at} **{one.state}** `{one.trip.code}` {one.trip.text}  \n*{one.remedy}*"
        for one in happened[:SHOWN]
    )


TAB = Tab(90, "Faults", viser.Icon.ALERT_TRIANGLE, build)
