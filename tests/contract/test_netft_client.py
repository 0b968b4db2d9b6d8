"""The simulated Net F/T on real sockets, read by pynetft, which shares no code with it."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice

import pynetft
import pytest

from common.runtime.stop import StopSignal
from sim.netft.protocol import About
from sim.netft.sensor import NetftSensor
from sim.netft.server import NetftServer

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


@pytest.mark.parametrize("about", [FITTING, TRAP], ids=["N, Nm", "N, N-mm"])
def test_an_independent_client_reads_what_the_sensor_measures(about: About) -> None:
    """Sample by sample, in the units of the sensor's page."""
    with streaming(about) as server:
        config = pynetft.Config(
            sensor_host="127.0.0.1",
            rdt_port=server.port,
            http_port=server.page_port,
            receive_timeout=1.0,
            recovery_policy=pynetft.RecoveryPolicy.FAIL_STOP,
        )
        with pynetft.Client(config) as client:
            samples = list(islice(client.samples(timeout=5.0), SAMPLES))
    in_Nm = 1e-3 if about is TRAP else 1.0
    for sample in samples:
        measured = wrench_number(round(sample.force[0] * 1e3))
        read = (*sample.force, *(in_Nm * torque for torque in sample.torque))
        assert read == pytest.approx(measured, abs=2e-6)
    assert {sample.torque_unit.value for sample in samples} == {"N-mm" if about is TRAP else "N-m"}
