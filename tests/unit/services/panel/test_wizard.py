"""Calibration wizard of the panel: progress from its messages, and a child that fails."""

from pathlib import Path
from typing import Any

import pytest

from services.panel import wizard
from services.panel.tabs.calibrate import notes_of
from services.panel.wizard import Progress, WizardProcess
from tests.chaos.common_net import free_port
from tests.fakes.bench import DEMO


def test_messages_of_the_wizard_become_progress_and_a_table() -> None:
    """Plan, question, running, result, end; an error is a failure."""
    progress = Progress()
    left = {"verdict": "PASS", "found": [["mass (kg)", "1.2", "0.1"]]}
    lines: tuple[tuple[dict[str, Any], str], ...] = (
        ({"plan": "ten poses"}, "asking"), ({"progress": 0.4, "text": "pose 3"}, "running"),
        ({"note": "⚠ a loose cable"}, "running"), ({"left": left}, "running"), ({"end": 0}, "done"),
    )  # fmt: skip
    for line, phase in lines:
        progress.update(line)
        assert progress.phase == phase
    assert (progress.plan, progress.text) == ("ten poses", "pose 3")
    row = "<tr><td>mass (kg)</td><td>1.2</td><td>0.1</td></tr></table>"
    assert notes_of(progress).endswith(f"{row}<p><code>⚠ a loose cable</code></p>")
    progress.update({"error": "no hub"})
    progress.update({"end": 2})
    assert (progress.phase, progress.notes[-1]) == ("failed", "⚠ no hub")


@pytest.mark.processes
@pytest.mark.parametrize(
    ("module", "note"),
    [(wizard.MODULE, "no hub"), ("tests.no_such_module", "the wizard ended, exit code 1")],
)
def test_a_wizard_of_a_cell_that_is_down_or_that_crashes_has_failed(
    module: str, note: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last words are shown; meanwhile a second one is refused, afterwards it may start."""
    monkeypatch.setattr(wizard, "MODULE", module)
    path = tmp_path / "cell.yaml"
    path.write_text(DEMO.read_text().replace("7447", str(free_port())))
    process = WizardProcess(path)
    asked: dict[str, Any] = {"poses": 6, "verify_poses": 1, "speed_mm_s": 100.0}
    assert process.plan(**asked) == ""
    assert process.plan(**asked) == "a calibration is already running"
    process.wait(60.0)
    assert process.progress.phase == "failed"
    assert note in " ".join(process.progress.notes)
    assert process.plan(**asked) == ""
    process.close()
