"""Contact check before a calibration: in contact, the return path would press again."""

from math import hypot

import numpy as np

from common.config.cell import CellConfig
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from identification.errors import InContactError, NotBegunError

CONTACT_WITHIN_S = 1.0
POLL_S = 0.01


def refuse_loaded_tool(bus: Bus, cell: CellConfig) -> None:
    """Raise NotBegunError when the compensated wrench shows a force on the tool.

    Without a calibration the wrench contains the tool's weight: then nothing is checked here, and
    `refuse_relieved` checks after the tool was lifted.
    """
    reader = bus.reader(topics.WRENCH)
    give_up_ns = bus.clock.now_ns() + round(CONTACT_WITHIN_S * NS_PER_S)
    while (wrench := reader.read(bus.clock.now_ns()).fresh) is None:
        if bus.clock.now_ns() > give_up_ns:
            return  # a missing topic is reported where it is needed
        bus.clock.sleep_s(POLL_S)
    force_N, limit_N = hypot(*wrench.force_N), cell.force.touch_N
    if not wrench.calibrated or force_N <= limit_N:
        return
    raise NotBegunError(
        "contact",
        f"the tool is loaded: {force_N:.1f} N measured, limit {limit_N:g} N in free space "
        "(force.touch_N); nothing was moved. In contact: `forcemesh arm --jog`, then move it away. "
        "In free space: `forcemesh tare`; --free when another tool than the calibrated one is "
        "mounted; `forcemesh check axes` when the sensor is new",
    )


def refuse_relieved(before_N: Array, after_N: Array, lifted_m: float, cell: CellConfig) -> None:
    """Raise InContactError when the force has changed while the tool was lifted.

    Args:
        before_N: Mean force at the start, sensor axes. Shape (3,).
        after_N: Mean force straight above, in the same attitude.
        lifted_m: Height of the lift [m].
        cell: Cell file with the contact threshold force.touch_N.
    """
    change_N, limit_N = float(np.linalg.norm(after_N - before_N)), cell.force.touch_N
    if change_N > limit_N:
        raise InContactError(
            f"the tool was in contact at the start: {change_N:.1f} N change while it was lifted by "
            f"{1e3 * lifted_m:.0f} mm without rotation (limit {limit_N:g} N, force.touch_N); it "
            "stays above the start: check that it is free now, and calibrate again from there"
        )
