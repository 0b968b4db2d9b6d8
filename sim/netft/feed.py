"""Net F/T feed of a simulated arm: one RDT record every fixed number of ticks."""

import numpy as np

from common.config.cell import CellConfig
from sim.netft.protocol import About
from sim.netft.sensor import NetftSensor
from sim.netft.server import NetftServer
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S


class RdtFeed:
    """Passes sensor samples of the arm to the RDT server."""

    def __init__(self, server: NetftServer, cell: CellConfig, arm: SimArm) -> None:
        """Sample at the cell's sensor rate."""
        self._server, self._arm = server, arm
        self._ticks = max(1, round(1.0 / cell.rates.sensor_hz / TICK_S))

    def ticked(self) -> None:
        """Handle one tick of the arm: take a sample if due."""
        if self._arm.ticks % self._ticks:
            return
        sample = self._arm.ft_sensor.disturb(self._arm.ft_sensor.sample())
        if sample is not None:
            self._server.measured(np.concatenate((sample.force_N, sample.torque_Nm)).tolist())


def server_of(cell: CellConfig) -> NetftServer:
    """Return the server of a cell's simulated Net F/T, at the address that its driver uses."""
    sensor = cell.sensor
    about = About(
        counts_per_force=sensor.counts_per_N,
        counts_per_torque=sensor.counts_per_Nm,
        force_range_N=sensor.force_range_N,
        torque_range_Nm=sensor.torque_range_Nm,
        rate_hz=round(cell.rates.sensor_hz),
    )
    netft = NetftSensor(about, seed=0 if cell.sim is None else cell.sim.seed)
    return NetftServer(netft, address=sensor.address, port=sensor.port, page_port=sensor.page_port)
