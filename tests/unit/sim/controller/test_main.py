"""Command line of the emulated controller: options that exclude each other."""

from pathlib import Path

import pytest

from sim.controller.__main__ import main


@pytest.mark.parametrize("order", [1, -1])
def test_a_probed_controller_is_not_pessimistic_as_well(
    order: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of the two would be ignored; refused before any file is read."""
    options = [["--like", "probe.yaml"], ["--pessimistic"]][::order]
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "none.as"), *options[0], *options[1]])
    assert ended.value.code == 2
    first, second = (option[0] for option in options[::-1])
    assert f"argument {first}: not allowed with argument {second}" in capsys.readouterr().err
