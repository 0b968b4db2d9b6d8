"""Calibrate tab: plan, one confirmation, progress, residuals at each pose; the bring-up ladder."""

from pathlib import Path
from typing import Any

import numpy as np
import viser
from viser import uplot

from common.config.evidence import ladder, read_evidence
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from services.panel.markup import Html, html, joined, paragraphs
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, RequestOutcome, Viewer, put
from services.panel.watch import Snapshot
from services.panel.wizard import Progress

REPORT_HEIGHT = 150
LADDER_PERIOD_S = 2.0  # it is read from files
MARKS = {"passed": "✔", "changed": "↻", "failed": "✖", "open": "·"}
WORDS: dict[str, Html | str] = {
    "idle": "Identifies payload and sensor bias: the arm visits poses inside the workspace.",
    "planning": "planning …",
    "asking": "waiting for confirmation",
    "running": "running",
    "done": html("✔ <b>completed</b>: the cell uses the new calibration"),
    "failed": html("✖ <b>ended: the cell uses no new calibration</b>; see the notes"),
}


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    gui, wizard = viewer.gui, viewer.wizard
    most_mm_s = 1e3 * viewer.cell.limits.speed_m_s
    state = Prose(gui, paragraphs(WORDS["idle"]))
    poses = gui.add_slider("Poses", min=6, max=40, step=1, initial_value=10)
    fresh = gui.add_slider("Verification poses", min=1, max=20, step=1, initial_value=4)
    speed = gui.add_slider(
        "Speed [mm/s]", min=10.0, max=most_mm_s, step=10.0, initial_value=min(100.0, most_mm_s)
    )
    asked = False  # whether this page requested the calibration and shows the confirmation

    def plan() -> None:
        nonlocal asked
        refused = wizard.plan(
            poses=int(poses.value), verify_poses=int(fresh.value), speed_mm_s=float(speed.value)
        )
        asked = not refused
        if refused:
            viewer.show("Calibrate", RequestOutcome("refused", refused))

    start = viewer.button("Calibrate", plan, icon=viser.Icon.WAND, color="orange")
    stop = viewer.button(
        "Stop calibration", wizard.cancel, icon=viser.Icon.PLAYER_STOP, visible=False
    )
    bar = gui.add_progress_bar(0.0, visible=False)
    residuals = gui.add_folder("Residuals", visible=False)
    plotted: Progress | None = None
    plot: viser.GuiUplotHandle | None = None
    notes = Prose(gui, html(""))
    show_ladder = _add_ladder(viewer)

    def refresh(snapshot: Snapshot) -> None:
        nonlocal asked, plot, plotted
        now = wizard.progress
        if asked and now.phase == "asking":
            asked = False
            question = paragraphs(*(line for line in now.plan.split("\n") if line))
            viewer.confirm("Calibrate", question, "Move now", wizard.start, if_not=wizard.cancel)
        is_begun, is_moving = now.phase in {"planning", "asking", "running"}, now.phase == "running"
        put(start, visible=not is_begun)
        put(stop, visible=is_begun)
        put(bar, visible=is_moving, value=100.0 * now.share)
        state.show(paragraphs(f"running: {now.text}" if is_moving else WORDS[now.phase]))
        notes.show(notes_of(now))
        show_ladder(snapshot)
        if now.left and now is not plotted:
            plotted = now
            if plot is not None:
                plot.remove()
            residuals.visible = True
            with residuals:
                plot = _add_residual_plot(gui, now.left)

    return refresh


def _add_residual_plot(gui: viser.GuiApi, left: dict[str, Any]) -> viser.GuiUplotHandle:
    """Add the residual force at each fitted pose and at each verification pose."""
    fit_N, fresh_N, limit_N = left["fit_N"], left["fresh_N"], left["limit_N"]
    dots = uplot.Series_Points(show=True, size=8)
    count = len(fit_N) + len(fresh_N)
    return gui.add_uplot(
        (
            np.arange(1, count + 1, dtype=float),
            np.array(fit_N + [-1.0] * len(fresh_N)),  # below the axis range: not visible
            np.array([-1.0] * len(fit_N) + fresh_N),
            np.full(count, limit_N),
        ),
        (
            uplot.Series(label="pose"),
            uplot.Series(label="fitted", stroke="#1c7ed6", width=0, points=dots),
            uplot.Series(label="verification", stroke="#2f9e44", width=0, points=dots),
            uplot.Series(label="limit", stroke="#e03131", dash=(6, 4), width=1),
        ),
        title="Residual force at each pose [N]",
        scales={
            "x": uplot.Scale(time=False, auto=False, range=(0.5, count + 0.5)),
            "y": uplot.Scale(auto=False, range=(0.0, 1.1 * max([limit_N, *fit_N, *fresh_N]))),
        },
        axes=(uplot.Axis(stroke="#8b95a1"), uplot.Axis(stroke="#8b95a1", size=46)),
        legend=uplot.Legend(show=True, live=False),
        height=REPORT_HEIGHT,
    )


def notes_of(now: Progress) -> Html:
    """Return the verdict, the identified parameters and the notes."""
    notes = paragraphs(*(html("<code>{}</code>", note) for note in now.notes))
    if not now.left:
        return notes
    cells = [[html("<td>{}</td>", cell) for cell in row] for row in now.left["found"]]
    rows = joined(html("<tr>{}</tr>", joined(row)) for row in cells)
    head = html("<tr><th>parameter</th><th>value</th><th>±</th></tr>")
    return html("<p><b>{}</b></p><table>{}{}</table>{}", now.left["verdict"], head, rows, notes)


def _add_ladder(viewer: Viewer) -> Refresh:
    """Add the steps of the bring-up, for a cell with a controller; return their refresh."""
    if viewer.cell.gateway is None:
        return lambda _snapshot: None
    with viewer.gui.add_folder("Bring-up", expand_by_default=False):
        rows, read_ns = Prose(viewer.gui, html("")), 0

    def refresh(snapshot: Snapshot) -> None:
        nonlocal read_ns
        if not read_ns or snapshot.now_ns - read_ns >= LADDER_PERIOD_S * NS_PER_S:
            read_ns = snapshot.now_ns
            rows.show(ladder_text(viewer.wizard.cell_file))

    return refresh


def ladder_text(cell_file: Path) -> Html:
    """Return the steps of the bring-up with their states, and the next one."""
    try:
        rows = ladder(cell_file, read_evidence(cell_file))
    except ConfigError as error:
        return paragraphs(f"⚠ {error}")
    if not rows:
        return paragraphs(html("no evidence: <code>forcemesh bringup</code> walks the ladder"))
    lines = [
        html("{} <b>{}</b> {} {}", MARKS[row.state], row.name, row.state, row.detail)
        for row in rows
    ]
    following = next((row.name for row in rows if row.state != "passed"), None)
    end = "all steps have passed" if following is None else f"next: {following}"
    return paragraphs(*lines, end)


TAB = Tab(30, "Calibrate", viser.Icon.TARGET, build)
