"""A cell whose sensor's axes a person has checked, without the minutes that it takes."""

from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.requests import AxesRequest

WITHIN_S, POLL_S = 2.0, 0.01


def axes_are_checked(bus: Bus) -> None:
    """Tell a cell on this bus what `forcemesh check axes` tells it when all is right."""
    wrench = bus.reader(topics.WRENCH)
    for _ in range(round(WITHIN_S / POLL_S)):
        if wrench.read(bus.clock.now_ns()).fresh is not None:
            break
        bus.clock.sleep_s(POLL_S)
    heard = wrench.read(bus.clock.now_ns()).fresh
    assert heard is not None
    assert bus.ask(topics.AXES, AxesRequest(calibration=heard.calibration)).accepted
    bus.clock.sleep_s(10.0 * POLL_S)
