"""The sensor's web page: units of the manual, and pages that are not valid."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh.errors import DataError
from services.sensor.netft_page import SettingsPage, parse
from sim.netft.protocol import FORCE_UNITS, TORQUE_UNITS, About, page

# The answer of an Axia80, reduced to the fields that the parser reads.
PAGE = """<?xml version="1.0"?><netft><runstat>0x00000000</runstat><cfgcalsn>FT27462</cfgcalsn>
<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>
<cfgmr>330;330;990;30;30;30</cfgmr><prodname>Axia80</prodname></netft>"""

counts = st.floats(1.0, 1e9)


def test_a_page_of_the_maker_is_understood() -> None:
    """The parser reads counts, serial number and the range of the strongest axis."""
    assert parse(PAGE) == SettingsPage(1e6, 1e6, "N", "Nm", "Axia80", "FT27462", 990.0, 30.0)


@given(st.sampled_from(sorted(FORCE_UNITS)), st.sampled_from(sorted(TORQUE_UNITS)), counts, counts)
def test_units_are_converted_whatever_they_are(force: str, torque: str, f: float, t: float) -> None:
    """The parser reads each unit that the simulated sensor writes from its own table."""
    about = About(counts_per_force=f, counts_per_torque=t, force_unit=force, torque_unit=torque)
    read = parse(page(about))
    assert read.counts_per_N == pytest.approx(about.counts_per_N, rel=1e-6)
    assert read.counts_per_Nm == pytest.approx(about.counts_per_Nm, rel=1e-6)
    assert read.force_range_N == pytest.approx(about.force_range_N, rel=1e-6)
    assert read.torque_range_Nm == pytest.approx(about.torque_range_Nm, rel=1e-6)


@pytest.mark.parametrize(
    ("code", "in_Nm"),
    [(1, 0.112985), (2, 1.355818), (3, 1.0), (4, 1e-3), (5, 0.0980665), (6, 1e3)],
)
def test_a_page_with_the_codes_of_units_alone_is_understood(code: int, in_Nm: float) -> None:
    """Older firmware sends the unit's number instead of its name."""
    text = PAGE.replace("<scfgtu>Nm</scfgtu>", f"<cfgtu>{code}</cfgtu>")
    assert parse(text).counts_per_Nm == pytest.approx(1e6 / in_Nm, rel=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("<html>a router's page</html>", "cfgfu is 'missing'"),
        (PAGE.replace(">Nm<", ">furlong<"), "cfgtu is 'furlong'"),
        (PAGE.replace("<cfgcpf>1000000", "<cfgcpf>0"), "cfgcpf"),
        (PAGE.replace("<cfgcpt>1000000", "<cfgcpt>nan"), "cfgcpt"),
        (PAGE.replace("<cfgcpt>1000000", "<cfgcpt>many"), "cfgcpt"),
    ],
)
def test_an_invalid_page_is_reported(wrong: str, message: str) -> None:
    """The scale is never guessed."""
    with pytest.raises(DataError, match=message):
        parse(wrong)


FIELDS = ["330;330;990;30;30;30", "<cfgcpf>1000000", "<cfgcpt>1000000", ">N<", ">Nm<"]


@given(st.text(max_size=300) | st.text("0123456789.eE+-;² nmlbf", max_size=40), st.data())
def test_any_text_in_a_field_is_read_or_raises_data_error(value: str, data: st.DataObject) -> None:
    """Another error would end the thread that fetches the page; a text is no page by itself."""
    old = data.draw(st.sampled_from(FIELDS))
    tag = old[: old.find(">") + 1]
    with suppress(DataError):
        parse(PAGE.replace(old, f"{tag}{value}{'<' if old.endswith('<') else ''}"))
    with pytest.raises(DataError):
        parse(value)
