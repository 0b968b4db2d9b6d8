"""Sensor check of `forcemesh doctor` for a cell that is not up."""

import socket
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from cli.doctor.checks import ReportLine, finding, passed, skipped
from services.sensor.driver_registry import unknown_driver
from services.sensor.rdt import RdtCommand, RdtRecord, parse, request
from services.sensor.rdt_status import is_good, status_text

if TYPE_CHECKING:
    from common.config.cell import CellConfig, SensorSection

SENSOR_LISTEN_S = 0.5
PACKAGES = {"robotiq": "serial", "bota": "bota_driver"}


@dataclass(frozen=True, slots=True)
class ReceivedStream:
    """Records received from a sensor after a stream request."""

    records: int
    newest: RdtRecord | None
    error_text: str = ""  # error text of the system


def sensor_line(cell: "CellConfig", *, is_up: bool) -> ReportLine:
    """Check the cell's sensor unless the cell is up: it streams to its last client only."""
    implementation, sensor = cell.roles.sensor, cell.sensor
    if implementation != "driver":
        return skipped("sensor", f"not used by this cell: roles.sensor is {implementation}")
    if is_up:
        return skipped("sensor", "the cell is up and uses the only stream: see sensor/wrench")
    if sensor.driver == "rdt":
        endpoint = f"{sensor.address}:{sensor.port}"
        return check_stream_of(
            endpoint, listen(sensor.address, sensor.port, SENSOR_LISTEN_S), SENSOR_LISTEN_S
        )
    if mistake := unknown_driver(cell):
        return finding("sensor", "FAIL", mistake, "sensor.driver")
    if sensor.driver not in PACKAGES:
        return passed("sensor", f"{sensor.driver}: installed; the sensor was not opened")
    has_package = bool(find_spec(PACKAGES[sensor.driver]))
    return check_device(sensor, exists=Path(sensor.device).exists(), has_package=has_package)


def check_stream_of(endpoint: str, found: ReceivedStream, listened_s: float) -> ReportLine:
    """Check the records of a sensor on the network."""
    if found.newest is None:
        detail = found.error_text or f"no record in {listened_s:g} s"
        return finding("sensor", "FAIL", f"{endpoint}: {detail}", "sensor.silent")
    text = f"{endpoint}: {found.records / listened_s:.0f} records/s"
    if not is_good(found.newest.status):
        status_line = f"{text}, status: {status_text(found.newest.status)}"
        return finding("sensor", "FAIL", status_line, "sensor.status")
    return passed("sensor", text)


def check_device(sensor: "SensorSection", *, exists: bool, has_package: bool) -> ReportLine:
    """Check whether a sensor on a serial line can be opened."""
    if not has_package:
        found = f"driver {sensor.driver} needs the package {PACKAGES[sensor.driver]}"
        return finding("sensor", "FAIL", found, f"sensor.{sensor.driver}")
    if not exists:
        return finding("sensor", "FAIL", f"{sensor.device} does not exist", "sensor.device")
    return passed("sensor", f"{sensor.driver}: {sensor.device} exists; it was not opened")


def listen(address: str, port: int, for_s: float) -> ReceivedStream:
    """Request the stream of a sensor, count its records, stop the stream."""
    records, newest = 0, None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        try:
            line.connect((address, port))
            line.send(request(RdtCommand.START))
            end_s = time.monotonic() + for_s
            while (left_s := end_s - time.monotonic()) > 0.0:
                line.settimeout(left_s)
                record = parse(line.recv(2048))
                if record is not None:
                    records, newest = records + 1, record
        except TimeoutError:
            pass
        except OSError as error:
            return ReceivedStream(records, newest, error.strerror or str(error))
        line.send(request(RdtCommand.STOP))
    return ReceivedStream(records, newest)
