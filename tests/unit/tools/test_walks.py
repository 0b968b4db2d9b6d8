"""The walks through the code: their steps, and their figures on the page."""

import re

import pytest

from tools.tree import ROOT
from tools.walks import WALKS, main


@pytest.mark.parametrize("name", WALKS)
def test_no_walk_is_longer_than_on_the_page(name: str) -> None:
    """Nor shorter by more than a tenth: then the page must be updated."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^ +{name}: +(\d+) files, (\d+) functions$", page, re.MULTILINE)
    trace = WALKS[name]()
    for counted, stated in zip((trace.files, trace.functions), row, strict=True):
        assert 0.9 * int(stated) <= len(counted) <= int(stated)


def test_a_walk_goes_from_service_to_service_as_the_data_does(capsys) -> None:
    """Sensor, wrench, regulator, arbiter; each file is listed with its functions."""
    main(["--list"])
    output = capsys.readouterr().out
    sample = output.partition("sample over TCP:")[0]
    stations = [
        "sim/robot/ft_sensor.py",
        "services/wrench/",
        "services/regulator/",
        "services/arbiter/",
    ]
    places = [sample.index(station) for station in stations]
    assert places == sorted(places)
    assert "control/adaptive.py: step" in sample
    assert "cli/" not in output
    assert "launch/" not in output
