"""Repeated touches of one place: each contact, and mean and standard deviation of all."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cli.skills.contact_monitor import ContactMonitor, no_progress
from cli.skills.pressing import TouchResult
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import vec3
from common.motion.frames import Array
from forcemesh.errors import NotReachedError
from forcemesh.messages import TOUCHING, Vec3

RETRACT_MM = 5.0  # between two touches, unless another distance is given
FREE_S = 2.0  # until the contact has ended after a retraction
ALREADY = "the tool is in contact: repeated touches start from free space, `forcemesh retract`"


@dataclass(frozen=True, slots=True)
class TouchStatistics:
    """Result: contacts of repeated touches. A single contact has no standard deviation."""

    touches: tuple[TouchResult, ...]
    mean_mm: Vec3  # of the TCP, base axes
    std_mm: Vec3  # of one touch, n - 1 in the denominator
    along_mean_mm: float  # along the tool's axis, from the first contact
    along_std_mm: float

    @classmethod
    def of(cls, touches: list[TouchResult], axis: Array) -> "TouchStatistics":
        """Return the statistics of two or more touches along a unit vector in base axes."""
        places_mm = np.array([found.tcp_mm for found in touches])
        along_mm = (places_mm - places_mm[0]) @ axis
        return cls(
            touches=tuple(touches),
            mean_mm=vec3(places_mm.mean(axis=0)),
            std_mm=vec3(places_mm.std(axis=0, ddof=1)),
            along_mean_mm=float(along_mm.mean()),
            along_std_mm=float(along_mm.std(ddof=1)),
        )

    def text(self) -> str:
        """Return mean and standard deviation as text."""
        x, y, z = self.mean_mm
        a, b, c = self.std_mm
        count = len(self.touches)
        return (
            f"mean of {count} contacts: {x:z.3f}, {y:z.3f}, {z:z.3f} mm, along the tool axis "
            f"{self.along_mean_mm:+.3f} mm from the first\n"
            f"standard deviation: {a:.3f}, {b:.3f}, {c:.3f} mm, along the tool axis "
            f"{self.along_std_mm:.3f} mm"
        )


def contact_text(found: TouchResult) -> str:
    """Return place, travel and peak force of one contact as text."""
    x, y, z = found.tcp_mm
    text = f"contact with the TCP at {x:z.2f}, {y:z.2f}, {z:z.2f} mm after {found.travel_mm:.2f} mm"
    return f"{text}, peak force {found.peak_N:.1f} N"


def touch_often(
    cell: ConfiguredCell,
    approach: Callable[[], TouchResult],
    repeat: int,
    *,
    retract_m: float,
    found: Callable[[TouchResult], object],
) -> TouchStatistics:
    """Touch, retract and touch again; the arm retracts after the last touch as well.

    Args:
        cell: An armed cell.
        approach: Touches once and retracts: `touch` of cli/skills/pressing.py.
        repeat: Number of touches, 2 or more.
        retract_m: Distance of that retraction.
        found: Receives each contact.

    Raises:
        NotReachedError: In contact at the start, no contact within the travel, or the retraction
            does not end it.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    if cell.contact().state in TOUCHING:
        raise NotReachedError(ALREADY)
    axis = ContactMonitor(cell, no_progress).tcp_pose().rotation[:, 2]
    touches: list[TouchResult] = []
    for number in range(repeat):
        touches.append(approach())
        found(touches[-1])
        if number + 1 < repeat:
            _wait_free(cell, retract_m)
    return TouchStatistics.of(touches, axis)


def _wait_free(cell: ConfiguredCell, retract_m: float) -> None:
    try:
        cell.contact.wait("free", within_s=FREE_S)
    except NotReachedError as error:
        text = f"still in contact after a retraction by {1e3 * retract_m:g} mm"
        raise NotReachedError(f"{text}: give a longer one with --back ({error})") from None
