"""Calibration wizard of the panel: a child process that fails."""

from pathlib import Path
from typing import Any

import pytest

from services.panel import wizard
from services.panel.wizard import WizardProcess
from tests.chaos.common_net import free_port
from tests.fakes.bench import DEMO


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
