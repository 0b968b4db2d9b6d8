"""The sensor on a simulated arm as a Net F/T: a record whenever the arm has made enough ticks."""

import numpy as np

from common.config.cell import Cell
from sim.netft.protocol import About
from sim.netft.sensor import NetftSensor
from sim.netft.server import NetftServer
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S


class RdtFeed:
    """Hands the arm's readings to the server that streams them."""

    def __init__(self, server: NetftServer, cell: Cell, arm: SimArm) -> None:
        """Sample at the cell's sensor rate."""
        self._server, self._arm = server, arm
        self._ticks = max(1, round(1.0 / cell.rates.sensor_hz / TICK_S))

    def ticked(self) -> None:
        """The arm has made a tick: measure if it is time."""
        if self._arm.ticks % self._ticks:
            return
        sample = self._arm.ft_sensor.disturb(self._arm.sample_ft())
        if sample is not None:
            self._server.measured(np.concatenate((sample.force_N, sample.torque_Nm)).tolist())


def server_of(cell: Cell) -> NetftServer:
    """Return the server of a cell's simulated Net F/T, at the address where its driver looks."""
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
