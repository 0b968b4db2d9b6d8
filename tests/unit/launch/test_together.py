"""The process of several roles runs those that the supervisor started, and no others."""

from pathlib import Path

import pytest

from launch import together

DEMO = Path(__file__).parents[3] / "cells" / "demo.yaml"


def test_roles_that_the_cell_file_does_not_run_together_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file may have changed since: two arbiters would run."""
    monkeypatch.setattr("sys.argv", ["together", "wrench", "regulator", "--cell", str(DEMO)])
    with pytest.raises(SystemExit, match="2"):
        together.main()
    assert (
        "together is [], but this process runs ['wrench', 'regulator']" in capsys.readouterr().err
    )
