"""The simulated Net F/T on real sockets, read by pynetft and by our driver: they must agree."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any

import numpy as np
import pynetft
import pytest

from common.config.load import load_cell
from common.runtime.stop import StopSignal
from forcemesh.bus import Bus
from forcemesh.clock import MonotonicClock
from forcemesh.codec import decode
from forcemesh.messages import SensorWrench
from services.sensor.service import SensorDriver
from sim.netft.protocol import About
from sim.netft.sensor import NetftSensor
from sim.netft.server import NetftServer
from tests.fakes.netft_rig import REAL_CELL

pytestmark = pytest.mark.realtime

PERIOD_S = 0.001
SAMPLES = 200
FITTING = About(force_range_N=200.0, torque_range_Nm=8.0)
TRAP = About(counts_per_torque=1000.0, torque_unit="N-mm", force_range_N=200.0, torque_range_Nm=8.0)


def wrench_number(place: int) -> list[float]:
    """Return a different wrench for every sample of the sensor, so that each can be identified."""
    return [1e-3 * place, -2e-3 * place, 5.0, 1e-4 * place, -1e-4 * place, 0.5]


@contextmanager
def streaming(about: About = FITTING) -> Iterator[NetftServer]:
    """A sensor that measures 1000 samples a second in a thread."""
    server, stop = NetftServer(NetftSensor(about)), StopSignal()

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


class DriverOnSocket:
    """Our driver on a real socket without a bus."""

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
        self.published: list[SensorWrench] = []
        self.clock = MonotonicClock()
        self.service = SensorDriver(Bus("sensor", cell.cell, self, cell, self.clock), cell)

    def publish(self, _key: str, _qos: str) -> Any:
        """Keep every message."""
        return lambda data: self.published.append(decode(data, SensorWrench)[1])

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)

    def until(self, what: Any, longest_s: float = 20.0) -> None:
        """Step the driver in real time until a condition is true."""
        give_up_s = time.monotonic() + longest_s
        while not what():
            assert time.monotonic() < give_up_s, self.published[-1:]
            self.service.step(self.clock.now_ns())
            time.sleep(0.0005)

    @property
    def good(self) -> list[SensorWrench]:
        """All valid messages."""
        return [message for message in self.published if message.valid]


def steps_of(force_x: list[float]) -> np.ndarray:
    """Return the differences of consecutive readings in sample numbers of the sensor."""
    return np.round(np.diff(force_x) / 1e-3)


@pytest.mark.parametrize("about", [FITTING, TRAP], ids=["N, Nm", "N, N-mm"])
def test_both_clients_read_the_same_numbers(about: About) -> None:
    """Sample by sample: each sample of the sensor has a reading of its own."""
    with streaming(about) as server:
        with pynetft_client(server) as client:
            theirs = list(islice(client.samples(timeout=5.0), SAMPLES))
        our_driver = DriverOnSocket(server)
        our_driver.until(lambda: len(our_driver.good) >= SAMPLES)
        our_driver.service.close()
    in_Nm = 1e-3 if about is TRAP else 1.0
    for place, read in [
        (round(sample.force[0] * 1e3), (*sample.force, *(in_Nm * t for t in sample.torque)))
        for sample in theirs
    ] + [
        (round(message.force_N[0] * 1e3), (*message.force_N, *message.torque_Nm))
        for message in our_driver.good
    ]:
        assert read == pytest.approx(wrench_number(place), abs=2e-6)
    assert {sample.torque_unit.value for sample in theirs} == {"N-mm" if about is TRAP else "N-m"}
    assert set(steps_of([m.force_N[0] for m in our_driver.good])) == {1.0}
    assert our_driver.service.counters()["lost"] == 0


def test_the_last_client_has_the_stream_and_the_other_reports_it() -> None:
    """The client pynetft takes our stream; this is reported before silence is."""
    with streaming() as server:
        our_driver = DriverOnSocket(server)
        our_driver.until(lambda: len(our_driver.good) >= 100)
        with pynetft_client(server) as client:
            assert client.wait_for_first_sample(5.0)
        our_driver.until(lambda: not our_driver.published[-1].valid)
        bad = [message.code for message in our_driver.published[100:] if not message.valid]
        assert bad[0] == "sensor_stolen"
        our_driver.service.close()


def test_a_bias_that_another_client_sets_shows_in_the_sensor() -> None:
    """Software bias works as in the real sensor: it changes the readings of all clients."""
    with streaming() as server, pynetft_client(server) as client:
        samples = client.samples(timeout=5.0)
        assert next(samples).force[2] == pytest.approx(5.0)
        client.bias()
        assert any(abs(sample.force[2]) < 1e-6 for sample in islice(samples, 2000))
