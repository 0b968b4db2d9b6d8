"""Text of a trip with its value and its limit, in the units of a teach pendant. Pure."""

import math

from forcemesh.messages import Trip

SHOWN_AS = {  # unit on the bus: factor and unit on the panel
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "rad": (math.degrees(1.0), "deg"),
    "rad/s": (math.degrees(1.0), "deg/s"),
}


def trip_text(trip: Trip) -> str:
    """Return the finding, its value and its limit; numbers of unknown unit are left out."""
    factor, unit = SHOWN_AS.get(trip.unit, (1.0, trip.unit))
    numbers = [] if trip.value is None else [f"{factor * trip.value:.4g} {unit}"]
    if trip.limit is not None:
        numbers.append(f"limit {factor * trip.limit:.4g} {unit}")
    return f"{trip.text} ({', '.join(numbers)})" if numbers and unit else trip.text
