"""No calibration begins in contact: its poses would be free, and the way back would press again."""

from math import hypot

import numpy as np

from common.config.cell import Cell
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from identification.errors import InContactError, NotBegunError

HEARD_WITHIN_S = 1.0
POLL_S = 0.01


def refuse_loaded_tool(bus: Bus, cell: Cell) -> None:
    """Raise NotBegunError when the calibration in use shows a force on the tool.

    Without a calibration the tool's weight is part of what is shown: then nothing is judged here,
    and `refuse_relieved` judges once the tool was lifted.
    """
    reader = bus.reader(topics.WRENCH)
    give_up_ns = bus.clock.now_ns() + round(HEARD_WITHIN_S * NS_PER_S)
    while (wrench := reader.read(bus.clock.now_ns()).fresh) is None:
        if bus.clock.now_ns() > give_up_ns:
            return  # whatever is silent is named where it is needed
        bus.clock.sleep_s(POLL_S)
    force_N, limit_N = hypot(*wrench.force_N), cell.force.touch_N
    if not wrench.calibrated or force_N <= limit_N:
        return
    raise NotBegunError(
        "contact",
        f"the tool is loaded: {force_N:.1f} N are shown, a free tool shows at most {limit_N:g} N "
        "(force.touch_N); nothing was moved. In contact: `forcemesh arm --jog`, then move it away. "
        "If it hangs free: `forcemesh tare`; --free where another tool than the calibrated one is "
        "on the arm; `forcemesh check axes` where the sensor is new",
    )


def refuse_relieved(before_N: Array, after_N: Array, lifted_m: float, cell: Cell) -> None:
    """Raise InContactError when the force has changed although the tool was only lifted.

    Args:
        before_N: Mean reading where the arm began, sensor axes. Shape (3,).
        after_N: The same straight above, in the same attitude.
        lifted_m: By so much.
        cell: Says which change is contact.
    """
    change_N, limit_N = float(np.linalg.norm(after_N - before_N)), cell.force.touch_N
    if change_N > limit_N:
        raise InContactError(
            f"the tool was in contact where it began: {change_N:.1f} N changed while it was lifted "
            f"by {1e3 * lifted_m:.0f} mm without turning (limit {limit_N:g} N, force.touch_N); it "
            "stays above: look that it hangs free now, and calibrate again from there"
        )
