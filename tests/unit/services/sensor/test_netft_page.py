"""The sensor's web page: the units of the manual, invalid pages, and how the page is fetched."""

import time
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.load import load_cell
from forcemesh.errors import DataError
from services.sensor.link import FETCH_AGAIN_S, PageFetch
from services.sensor.netft_page import PATH, SettingsPage, disagreement, info_of, parse, scale_of
from services.sensor.rdt_status import NAMES, status_text
from sim.netft.protocol import FORCE_UNITS, TORQUE_UNITS, About, page
from tests.fakes.rdt_sensor import REAL_CELL

# The answer of an Axia80, reduced to the fields that the parser reads.
REAL = """<?xml version="1.0"?><netft><runstat>0x00000000</runstat><cfgcalsn>FT27462</cfgcalsn>
<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>
<cfgmr>330;330;990;30;30;30</cfgmr><prodname>Axia80</prodname></netft>"""

counts = st.floats(1.0, 1e9)


def test_a_page_of_the_maker_is_understood() -> None:
    """The parser reads counts, serial number and the range of the strongest axis."""
    assert parse(REAL) == SettingsPage(1e6, 1e6, "N", "Nm", "Axia80", "FT27462", 990.0, 30.0)


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
    text = REAL.replace("<scfgtu>Nm</scfgtu>", f"<cfgtu>{code}</cfgtu>")
    assert parse(text).counts_per_Nm == pytest.approx(1e6 / in_Nm, rel=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("", "cfgfu is 'missing'"),
        ("<html>a router's page</html>", "cfgfu is 'missing'"),
        (REAL.replace(">Nm<", ">furlong<"), "cfgtu is 'furlong'"),
        (REAL.replace("<cfgcpf>1000000", "<cfgcpf>0"), "cfgcpf"),
        (REAL.replace("<cfgcpt>1000000", "<cfgcpt>nan"), "cfgcpt"),
        (REAL.replace("<cfgcpt>1000000", "<cfgcpt>many"), "cfgcpt"),
    ],
)
def test_an_invalid_page_is_reported(wrong: str, message: str) -> None:
    """The scale is never guessed."""
    with pytest.raises(DataError, match=message):
        parse(wrong)


@given(st.text(max_size=300))
def test_no_text_breaks_the_reader(text: str) -> None:
    """An arbitrary text raises DataError and no other error."""
    with pytest.raises(DataError):
        parse(text)


def test_the_cell_file_selects_the_source_of_the_counts() -> None:
    """`page` takes the page's, `cell` the cell file's; the range is always the cell file's."""
    sensor = load_cell(REAL_CELL, {"sensor.calibration": "page", "sensor.counts_per_N": 5.0}).sensor
    assert scale_of(sensor).counts_per_N == 5.0
    scale = scale_of(sensor, parse(REAL))
    assert (scale.counts_per_N, scale.force_range_N) == (1e6, sensor.force_range_N)
    assert not disagreement(sensor, parse(REAL)).code
    assert "serial FT27462" in str(info_of(sensor, parse(REAL)))


@pytest.mark.parametrize("bit", sorted(NAMES))
def test_a_status_names_its_bits(bit: int) -> None:
    """The text has the status word in hexadecimal and the meaning of each bit."""
    text = status_text(0x8000_0000 | 1 << bit)
    assert f"0x{0x8000_0000 | 1 << bit:08X}" in text
    assert NAMES[bit] in text
    assert "bit 4" in status_text(0x8000_0010)


# --- over HTTP ------------------------------------------------------------------------------------


@pytest.fixture
def web() -> Iterator[tuple[int, dict[str, tuple[int, str]]]]:
    """Yield the port of a web server and its answers by path, which the test sets."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, text = answers.get(self.path, (404, ""))
            self.send_response(status)
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    answers: dict[str, tuple[int, str]] = {}
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    yield server.server_address[1], answers
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.realtime
def test_the_page_is_fetched_until_it_arrives_and_again_after_forget(web) -> None:
    """Meanwhile the fault names the error and the address."""
    port, answers = web
    fetch = PageFetch("127.0.0.1", port)
    now_ns = 1

    def until(condition) -> None:
        nonlocal now_ns
        deadline_s = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < deadline_s, fetch.fault
            time.sleep(0.01)
            now_ns += round(FETCH_AGAIN_S * 0.5e9)

    until(lambda: fetch.poll(now_ns) or "HTTP 404" in fetch.fault)
    assert PATH in fetch.fault
    answers[PATH] = (200, "no page")
    until(lambda: fetch.poll(now_ns) or "cfgfu" in fetch.fault)
    answers[PATH] = (200, REAL)
    until(lambda: fetch.poll(now_ns) == parse(REAL))
    fetch.clear()
    answers[PATH] = (200, REAL.replace("FT27462", "FT00002"))
    until(lambda: (read := fetch.poll(now_ns)) is not None and read.serial == "FT00002")


@pytest.mark.realtime
def test_an_address_that_refuses_the_connection_is_reported() -> None:
    """The fault has the text of the network error."""
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as closed:
        port = closed.server_address[1]
    fetch = PageFetch("127.0.0.1", port)
    deadline_s = time.monotonic() + 20.0
    while "refused" not in fetch.fault:
        assert fetch.poll(time.monotonic_ns()) is None
        assert time.monotonic() < deadline_s, fetch.fault
        time.sleep(0.01)


@pytest.mark.parametrize(
    "rating",
    ["1.2.3", "330;330;990;30;30;1.2.3", ".", "1e", "1e999;1;1;1;1;1", "-;;;", "330,330", "e;.;1"],
)
def test_a_rating_that_is_no_number_is_not_known(rating: str) -> None:
    """The rest of the page is read; an unreadable range is None."""
    read = parse(REAL.replace("330;330;990;30;30;30", rating))
    assert (read.force_range_N, read.torque_range_Nm) == (None, None)
    assert read.counts_per_N == 1e6


@given(st.text(alphabet="0123456789.eE+-;² nmlbf", max_size=40), st.sampled_from(range(5)))
def test_any_text_in_a_field_is_read_or_raises_data_error(value: str, at: int) -> None:
    """Another error would end the thread that fetches the page."""
    old = ("330;330;990;30;30;30", "<cfgcpf>1000000", "<cfgcpt>1000000", ">N<", ">Nm<")[at]
    tag = old[: old.find(">") + 1] if old.startswith("<") else ""
    new = {3: f"></scfgfu><cfgfu>{value}</cfgfu><x><", 4: f"></scfgtu><cfgtu>{value}</cfgtu><x><"}
    with suppress(DataError):
        parse(REAL.replace(old, new.get(at, f"{tag}{value}")))
