"""Contact events in a report: what a recording has of each state, and its table."""

from dataclasses import dataclass, field

from cli.pages import table
from forcemesh.codec import Header
from forcemesh.messages import TOUCHING, ContactEvent
from services.panel.markup import Html, html

MOST_LISTED = 200
COLUMNS = (
    "time [s]", "state", "duration [s]", "peak force [N]", "impact [mm/s]", "slid [mm]",
    "TCP x, y, z [mm]", "normal x, y, z",
)  # fmt: skip


@dataclass(slots=True)
class ContactLog:
    """Contact states of a recording in order: time of the beginning [s], and newest message."""

    states: list[tuple[float, ContactEvent]] = field(default_factory=list)
    _epoch: int = 0  # of the regulator: its numbers begin again after a restart

    def add(self, at_s: float, header: Header, event: ContactEvent) -> None:
        """Take a message, published at a time of the recording [s]."""
        last = self.states[-1][1] if self.states else None
        is_same_run, self._epoch = header.epoch == self._epoch, header.epoch
        if last is not None and is_same_run:
            if event.number == last.number:
                self.states[-1] = self.states[-1][0], event
                return
            if event.number == last.number + 1:  # it has the whole duration of the last one
                whole = last.replaced(duration_s=event.before_s, peak_N=event.before_peak_N)
                self.states[-1] = self.states[-1][0], whole
        self.states.append((at_s - event.duration_s, event))


def contact_table(log: ContactLog) -> Html:
    """Return the table of the states, the newest ones if there are many; empty without contact."""
    if not any(event.state in TOUCHING for _, event in log.states):
        return html("")
    rows = [_row(began_s, event) for began_s, event in log.states[-MOST_LISTED:]]
    omitted = len(log.states) - MOST_LISTED
    note = html('<p class="sub">without the first {}</p>', omitted) if omitted > 0 else html("")
    body = table(COLUMNS, rows)
    return html('<h2>Contact events</h2>{}<div class="scroll">{}</div>', note, body)


def _row(began_s: float, event: ContactEvent) -> tuple[str, ...]:
    touches, state = event.state in TOUCHING, event.state
    position = ", ".join(f"{1e3 * part:z.2f}" for part in event.position_m)
    normal = ", ".join(f"{part:z.2f}" for part in event.normal) if any(event.normal) else ""
    return (
        f"{began_s:.3f}",
        state if event.valid else f"{state}: {event.reason}",
        f"{event.duration_s:.3f}",
        f"{event.peak_N:.1f}" if touches else "",
        f"{1e3 * event.impact_m_s:.1f}" if state == "impact" else "",
        f"{1e3 * event.slid_m:.1f}" if state in ("sliding", "lost") else "",
        position if event.number else "",
        normal,
    )
