"""Fixed-point scales: packet units per millimetre, degree or newton, negotiated by hello.

A running gateway takes them from the section `gateway` of its cell file; the defaults here are for
tools without a cell. Gains and percents have fixed scales: controller/packet_table.py.
"""

from dataclasses import dataclass, fields
from math import isfinite

from controller.packet import VALUE_MAX, VALUE_MIN, VecInt
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Joints

# Upper bounds: the range must hold 180 degrees of O, A, T and 360 of a joint on the negative side
# (-99999), 1 m, 100 N, 10 N m and 250 mm/s; the positive side (499999) is five times as large.
# Lower bounds: the resolution of one unit must be useful.
# fmt: off
SCALE_RANGES = {
    "position_per_mm": (10, 99),
    "oat_per_deg":     (100, 555),
    "joint_per_deg":   (50, 277),
    "force_per_N":     (1, 999),
    "torque_per_Nm":   (10, 9999),
    "speed_per_mm_s":  (1, 1000),
}
# fmt: on


@dataclass(frozen=True, slots=True)
class Scales:
    """Packet units per millimetre, degree, newton, newton metre, millimetre per second."""

    position_per_mm: int = 50
    oat_per_deg: int = 500
    joint_per_deg: int = 250
    force_per_N: int = 100
    torque_per_Nm: int = 1000
    speed_per_mm_s: int = 10

    def __post_init__(self) -> None:
        """Raise LocalProtocolError for a scale outside its range."""
        for name, (low, high) in SCALE_RANGES.items():
            value = getattr(self, name)
            if type(value) is not int or not low <= value <= high:
                raise LocalProtocolError(f"scale {name} is {value!r}, it must be {low} to {high}")

    @property
    def vec(self) -> VecInt:
        """The scales in the order of hello."""
        return (
            self.position_per_mm,
            self.oat_per_deg,
            self.joint_per_deg,
            self.force_per_N,
            self.torque_per_Nm,
            self.speed_per_mm_s,
        )


def scales_from_hello(vec: VecInt) -> Scales:
    """Return the scales in a hello. Raise RemoteProtocolError for scales outside their range."""
    try:
        return Scales(*vec)
    except LocalProtocolError as error:
        raise RemoteProtocolError(f"hello: {error}") from error


def differences(asked: Scales, answered: Scales) -> list[str]:
    """Return one line for each scale that differs."""
    names = [field.name for field in fields(Scales)]
    triples = zip(names, asked.vec, answered.vec, strict=True)
    return [
        f"{name} asked {ours}, has {theirs}" for name, ours, theirs in triples if ours != theirs
    ]


def to_units(name: str, value: float, units_per_one: float) -> int:
    """Return the nearest number of packet units.

    Raises LocalProtocolError, naming the quantity, for a value that is not finite or does not fit.
    """
    if not isfinite(value):
        raise LocalProtocolError(f"{name} is {value}, it cannot be sent")
    units = round(value * units_per_one)
    if not VALUE_MIN <= units <= VALUE_MAX:
        low, high = VALUE_MIN / units_per_one, VALUE_MAX / units_per_one
        raise LocalProtocolError(f"{name} is {value:.6g}, the packet holds {low:.6g} to {high:.6g}")
    return units


def to_vec(names: tuple[str, ...], values: Joints, units_per_one: tuple[float, ...]) -> VecInt:
    """Return six values as packet units; errors name the value that cannot be sent."""
    rows = zip(names, values, units_per_one, strict=True)
    a, b, c, d, e, f = (to_units(name, value, scale) for name, value, scale in rows)
    return (a, b, c, d, e, f)
