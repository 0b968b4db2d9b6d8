"""RDT protocol of the sensor side, and the sensor's settings page: bytes only.

Implemented from the manual, independently of the driver, so that tests can detect disagreement.
Source: ATI 9620-05-Net F/T (UDP with RDT) and 9610-05-Ethernet Axia chapter 11 (netftapi2.xml).
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape

HEADER = 0x1234
STOP, START, BUFFERED, RESET_LATCH, BIAS = 0x0000, 0x0002, 0x0003, 0x0041, 0x0042
REQUEST_BYTES = 8
SERIOUS = 0x8002_0000  # error, saturation or A/D converter fault
INT32 = 2**31 - 1

# Units of the page: (code on the page, factor to N or Nm).
FORCE_UNITS = {"lbf": (1, 4.4482216), "N": (2, 1.0), "kN": (4, 1e3), "kgf": (5, 9.80665)}
TORQUE_UNITS = {"lbf-in": (1, 0.11298483), "Nm": (3, 1.0), "N-mm": (4, 1e-3), "kN-m": (6, 1e3)}


def command_of(data: bytes) -> tuple[int, int] | None:
    """Return command and number of records of a request, or None for an invalid request."""
    if len(data) != REQUEST_BYTES:
        return None
    header, command, count = struct.unpack(">HHI", data)
    return (command, count) if header == HEADER else None


def record(rdt_sequence: int, ft_sequence: int, status: int, counts: Sequence[int]) -> bytes:
    """Return a record of 36 bytes; sequence numbers wrap at 32 bits, counts saturate."""
    held = [max(-INT32 - 1, min(INT32, count)) for count in counts]
    numbers = (rdt_sequence % 2**32, ft_sequence % 2**32, status % 2**32)
    return struct.pack(">III6i", *numbers, *held)


class About(NamedTuple):
    """Identity and scaling of a sensor, as shown on its page."""

    product: str = "forcemesh Net F/T simulator"
    serial: str = "FT00000"
    counts_per_force: float = 1_000_000.0  # per unit of force
    counts_per_torque: float = 1_000_000.0  # per unit of torque
    force_unit: str = "N"
    torque_unit: str = "Nm"
    force_range_N: float = 500.0
    torque_range_Nm: float = 20.0
    rate_hz: int = 1000

    @property
    def counts_per_N(self) -> float:
        """Counts per newton."""
        return self.counts_per_force / FORCE_UNITS[self.force_unit][1]

    @property
    def counts_per_Nm(self) -> float:
        """Counts per newton metre."""
        return self.counts_per_torque / TORQUE_UNITS[self.torque_unit][1]


def page(about: About, status: int = 0) -> str:
    """Return netftapi2.xml; ranges are in the page's units, as on a real sensor."""
    force_code, in_N = FORCE_UNITS[about.force_unit]
    torque_code, in_Nm = TORQUE_UNITS[about.torque_unit]
    ratings = [about.force_range_N / in_N] * 3 + [about.torque_range_Nm / in_Nm] * 3
    elements = {
        "runstat": f"0x{status:08X}",
        "prodname": about.product,
        "setserial": about.serial,
        "cfgcalsn": about.serial,
        "cfgfu": force_code,
        "scfgfu": about.force_unit,
        "cfgtu": torque_code,
        "scfgtu": about.torque_unit,
        "cfgcpf": f"{about.counts_per_force:.12g}",
        "cfgcpt": f"{about.counts_per_torque:.12g}",
        "cfgmr": ";".join(f"{rating:.9g}" for rating in ratings),
        "comrdte": "Enabled",
        "comrdtrate": about.rate_hz,
    }
    lines = "\n".join(f"<{name}>{escape(str(text))}</{name}>" for name, text in elements.items())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<netft>\n{lines}\n</netft>\n'
