"""The simulated Net F/T on real sockets, read by pynetft and by our driver: they must agree."""

import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any

import numpy as np
import pynetft
import pytest

from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.clock import MonotonicClock
from forcemesh.codec import decode
from forcemesh.errors import SimulationError
from forcemesh.messages import SensorWrench
from services.sensor.service import SensorDriver
from sim.netft.protocol import About
from sim.netft.sensor import NetftSensor
from sim.netft.server import NetftServer
from tests.fakes.rdt_sensor import REAL_CELL

pytestmark = pytest.mark.realtime

PERIOD_S = 0.001
SAMPLES = 200
FITTING = About(force_range_N=200.0, torque_range_Nm=8.0)
TRAP = About(counts_per_torque=1000.0, torque_unit="N-mm", force_range_N=200.0, torque_range_Nm=8.0)


def wrench_number(place: int) -> list[float]:
    """Return a wrench of its own for every sample of the sensor, so that samples can be told."""
    return [1e-3 * place, -2e-3 * place, 5.0, 1e-4 * place, -1e-4 * place, 0.5]


@contextmanager
def streaming(about: About = FITTING) -> Iterator[NetftServer]:
    """A sensor that measures a thousand times a second in a thread."""
    server, stop = NetftServer(NetftSensor(about)), threading.Event()

    def live() -> None:
        place = 0
        due_s = time.monotonic()
        while not stop.is_set():
            server.poll()
            while due_s <= time.monotonic():
                place += 1
                server.measured(wrench_number(place % 70_000))
                due_s += PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield server
    finally:
        stop.set()
        thread.join()
        server.close()


def pynetft_client(server: NetftServer) -> pynetft.Client:
    """Return the independent client of a server."""
    config = pynetft.Config(
        sensor_host="127.0.0.1",
        rdt_port=server.port,
        http_port=server.page_port,
        receive_timeout=1.0,
        recovery_policy=pynetft.RecoveryPolicy.FAIL_STOP,
    )
    return pynetft.Client(config)


class Ours:
    """Our driver on a real socket, without a bus behind it."""

    def __init__(self, server: NetftServer, **changes: Any) -> None:
        where = {
            "sensor.address": "127.0.0.1",
            "sensor.port": server.port,
            "sensor.page_port": server.page_port,
            "sensor.calibration": "page",
            "rates.sensor_hz": 1000.0,
            "deadlines.sensor_s": 1.0,
        }
        cell = load_cell(REAL_CELL, where | changes)
        self.said: list[SensorWrench] = []
        self.clock = MonotonicClock()
        self.service = SensorDriver(Bus("sensor", cell.cell, self, cell, self.clock), cell)

    def publish(self, _key: str, _qos: str) -> Any:
        """Keep every message."""
        return lambda data: self.said.append(decode(data, SensorWrench)[1])

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)

    def until(self, what: Any, longest_s: float = 20.0) -> None:
        """Live in real time until something is so."""
        give_up_s = time.monotonic() + longest_s
        while not what():
            assert time.monotonic() < give_up_s, self.said[-1:]
            self.service.step(self.clock.now_ns())
            time.sleep(0.0005)

    @property
    def good(self) -> list[SensorWrench]:
        """Every message that is valid."""
        return [message for message in self.said if message.valid]


def steps_of(force_x: list[float]) -> np.ndarray:
    """Return from sample to sample by how many places of the sensor the reading moved."""
    return np.round(np.diff(force_x) / 1e-3)


@pytest.mark.parametrize("about", [FITTING, TRAP], ids=["N, Nm", "N, N-mm"])
def test_both_clients_read_the_same_numbers(about: About) -> None:
    """Sample by sample, by the reading that each sample of the sensor has for itself alone."""
    with streaming(about) as server:
        with pynetft_client(server) as client:
            theirs = list(islice(client.samples(timeout=5.0), SAMPLES))
        ours = Ours(server)
        ours.until(lambda: len(ours.good) >= SAMPLES)
        ours.service.close()
    in_Nm = 1e-3 if about is TRAP else 1.0
    for place, read in [
        (round(sample.force[0] * 1e3), (*sample.force, *(in_Nm * t for t in sample.torque)))
        for sample in theirs
    ] + [
        (round(message.force_N[0] * 1e3), (*message.force_N, *message.torque_Nm))
        for message in ours.good
    ]:
        assert read == pytest.approx(wrench_number(place), abs=2e-6)
    assert {sample.torque_unit.value for sample in theirs} == {"N-mm" if about is TRAP else "N-m"}
    assert set(steps_of([m.force_N[0] for m in ours.good])) == {1.0}
    assert ours.service.counters()["lost"] == 0


def test_who_asks_last_has_the_stream_and_the_other_says_so() -> None:
    """The client pynetft takes our stream; before silence is told, the theft is."""
    with streaming() as server:
        ours = Ours(server)
        ours.until(lambda: len(ours.good) >= 100)
        with pynetft_client(server) as client:
            assert client.wait_for_first_sample(5.0)
        ours.until(lambda: not ours.said[-1].valid)
        bad = [message.code for message in ours.said[100:] if not message.valid]
        assert bad[0] == "sensor_stolen"
        ours.service.close()


def test_a_bias_that_another_client_sets_shows_in_the_sensor() -> None:
    """Software bias works as in the real one: in the sensor, for everybody."""
    with streaming() as server, pynetft_client(server) as client:
        samples = client.samples(timeout=5.0)
        assert next(samples).force[2] == pytest.approx(5.0)
        client.bias()
        assert any(abs(sample.force[2]) < 1e-6 for sample in islice(samples, 2000))


def test_switches_are_set_over_http_and_mistakes_are_told() -> None:
    """A small request is enough; what is no switch is refused with what there is."""
    with streaming() as server:
        url = f"http://127.0.0.1:{server.page_port}/faults"
        with urllib.request.urlopen(url, b"loss=0.25&stall=on") as answer:
            assert b'"loss": 0.25' in answer.read()
        assert (server.sensor.switches.loss, server.sensor.switches.stall) == (0.25, True)
        for body in (b"lose=0.1", b"loss=2", b"stall=perhaps"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(url, body)
            assert refused.value.code == 400
            refused.value.close()


def test_a_port_that_is_taken_is_told() -> None:
    """In a sentence, with the ports."""
    with streaming() as server, pytest.raises(SimulationError, match=rf"UDP {server.port}"):
        NetftServer(NetftSensor(), port=server.port)
