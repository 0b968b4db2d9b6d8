"""Command `python -m sim.netft`: streams a constant wrench with noise until SIGTERM or Ctrl-C."""

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from common.runtime.realtime import prepare_realtime
from common.runtime.service import exit_on_error
from common.runtime.stop import StopSignal, stop_on_signals
from forcemesh.clock import NS_PER_S
from sim.netft.protocol import FORCE_UNITS, TORQUE_UNITS, About
from sim.netft.sensor import NetftSensor
from sim.netft.server import FAULTS, PAGE, NetftServer

MOST_BEHIND = 50  # records; a process delayed for longer drops samples instead
print_line = partial(print, flush=True)


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    words = argparse.ArgumentParser(
        prog="python -m sim.netft",
        description="A simulated ATI Net F/T: RDT over UDP, netftapi2.xml and fault switches"
        " over HTTP. Set faults with: curl http://ADDRESS:PAGE_PORT/faults -d 'loss=0.2'",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    words.add_argument("--address", default="127.0.0.1", help="listen on this address only")
    words.add_argument("--port", type=int, default=49152, help="UDP port of RDT; 0: any free port")
    words.add_argument("--page-port", type=int, default=8081, help="TCP port of HTTP; 0: any free")
    words.add_argument("--rate-hz", type=float, default=1000.0, help="records per second [Hz]")
    words.add_argument("--force", type=vector, default="0,0,10", metavar="X,Y,Z", help="force [N]")
    words.add_argument("--torque", type=vector, default="0,0,0", metavar="X,Y,Z", help="[N m]")
    words.add_argument("--noise-N", type=float, default=0.1, help="standard deviation [N]")
    words.add_argument("--noise-Nm", type=float, default=0.005, help="standard deviation [N m]")
    words.add_argument("--counts-per-force", type=float, default=1e6, help="per unit of force")
    words.add_argument("--counts-per-torque", type=float, default=1e6, help="per unit of torque")
    words.add_argument("--force-unit", choices=FORCE_UNITS, default="N", help="unit on the page")
    words.add_argument("--torque-unit", choices=TORQUE_UNITS, default="Nm", help="unit on the page")
    words.add_argument("--seed", type=int, default=0, help="seed of noise and faults")
    return words


def vector(text: str) -> np.ndarray:
    """Parse three comma-separated numbers. Shape (3,)."""
    return np.array([float(part) for part in text.split(",")]).reshape(3)


def main() -> None:
    """Stream until a stop signal."""
    given = parser().parse_args()
    stop = stop_on_signals()
    about = About(
        counts_per_force=given.counts_per_force,
        counts_per_torque=given.counts_per_torque,
        force_unit=given.force_unit,
        torque_unit=given.torque_unit,
        rate_hz=round(given.rate_hz),
    )
    with exit_on_error("netft"):
        server = NetftServer(
            NetftSensor(about, seed=given.seed),
            address=given.address,
            port=given.port,
            page_port=given.page_port,
        )
        where = f"http://{given.address}:{server.page_port}"
        print_line(
            f"RDT at {given.address}:{server.port}, page {where}{PAGE}, switches {where}{FAULTS}"
        )
        still = np.concatenate((given.force, given.torque))
        noise = np.array([given.noise_N] * 3 + [given.noise_Nm] * 3)
        rng = np.random.default_rng(given.seed)

        def sample() -> list[float]:
            reading: list[float] = (still + noise * rng.standard_normal(6)).tolist()
            return reading

        prepare_realtime()
        run(server, sample, given.rate_hz, stop)
        server.close()
        print_line(f"{server.sent} records sent, {server.unsendable} unsendable")


def run(
    server: NetftServer, sample: Callable[[], list[float]], rate_hz: float, stop: StopSignal
) -> None:
    """Sample at a rate until a stop signal; a delay is made up for, up to MOST_BEHIND records."""
    period_ns = round(NS_PER_S / rate_hz)
    due_ns = time.monotonic_ns()
    while not stop.is_set():
        server.poll()
        now_ns = time.monotonic_ns()
        due_ns = max(due_ns, now_ns - MOST_BEHIND * period_ns)
        while due_ns <= now_ns:
            server.measured(sample())
            due_ns += period_ns
        time.sleep(max(0, due_ns - time.monotonic_ns()) / NS_PER_S)


if __name__ == "__main__":
    main()
