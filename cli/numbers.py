"""Parser of typed numbers: separated by commas, in millimetres and degrees."""

import math
from dataclasses import dataclass

from typer import BadParameter

# A vector may begin with a minus sign; without this it would be parsed as an option.
NEGATIVE_NUMBERS = {"ignore_unknown_options": True}


@dataclass(frozen=True, slots=True)
class VectorFormat:
    """Format and unit of the numbers of a vector."""

    names: tuple[str, ...]
    unit: str

    def __str__(self) -> str:
        return f"{','.join(self.names)} ({self.unit})"


POSE = VectorFormat(("X", "Y", "Z", "O", "A", "T"), "mm and degrees")
MOST_DEG = 5000.0  # a request accepts 100 rad
JOINTS = VectorFormat(("J1", "J2", "J3", "J4", "J5", "J6"), "degrees")
SEVEN_JOINTS = VectorFormat((*JOINTS.names, "J7"), "degrees")


def parse_vector(text: str, names: VectorFormat) -> tuple[float, ...]:
    """Return the numbers of a vector. Raise BadParameter for anything else."""
    parts = [part.strip() for part in text.strip().strip("[]()").split(",")]
    if len(parts) != len(names.names):
        raise BadParameter(
            f"{len(names.names)} numbers are needed, {names}, without spaces; "
            f"found {len(parts)}: {text!r}"
        )
    return tuple(parse_number(part, name) for part, name in zip(parts, names.names, strict=True))


def parse_gain(text: str | None, unit: str) -> tuple[float, float, float] | None:
    """Return three gains; one number applies to all three axes. None stays None."""
    if text is None:
        return None
    if "," not in text:
        text = ",".join([text] * 3)
    x, y, z = parse_vector(text, VectorFormat(("x", "y", "z"), unit))
    if min(x, y, z) < 0.0:
        raise BadParameter(f"a gain is zero or positive, found {text!r}")
    return (x, y, z)


def parse_number(text: str, name: str) -> float:
    """Return a finite number. Raise BadParameter, by its name, for anything else."""
    try:
        number = float(text)
    except ValueError:
        raise BadParameter(f"{name} is not a number: {text!r}") from None
    if not math.isfinite(number):
        raise BadParameter(f"{name} must be finite, found {text!r}")
    return number


def from_milli(number: float | None) -> float | None:
    """Return a number of millimetres or milliseconds in SI; None stays None."""
    return None if number is None else number / 1e3


def check_angle(angle_deg: float, name: str) -> None:
    """Raise BadParameter for an angle outside the range of any joint [degrees]."""
    if abs(angle_deg) > MOST_DEG:
        raise BadParameter(f"{name} must be within {MOST_DEG:g} degrees, found {angle_deg:g}")
