"""A cell whose sensor axes are confirmed, without the minutes of the real check."""

from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.requests import AxesRequest

TIMEOUT_S, POLL_S = 2.0, 0.01


def axes_are_checked(bus: Bus) -> None:
    """Send the request of a successful `forcemesh check axes` to a cell on this bus."""
    wrench = bus.reader(topics.WRENCH)
    for _ in range(round(TIMEOUT_S / POLL_S)):
        if wrench.read(bus.clock.now_ns()).fresh is not None:
            break
        bus.clock.sleep_s(POLL_S)
    newest = wrench.read(bus.clock.now_ns()).fresh
    assert newest is not None
    assert bus.ask(topics.AXES, AxesRequest(calibration=newest.calibration)).accepted
    bus.clock.sleep_s(10.0 * POLL_S)
