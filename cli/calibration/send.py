"""Request that puts a calibration into use in the running cell."""

from common.config.calibration import CalibrationSection
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.requests import CalibrationRequest, Reply

SEND_TIMEOUT_S = 3.0
SEND_AGAIN_S = 0.1
TRANSIENT_REFUSALS = ("wait", "moving")  # transient refusals: the arm has just returned


def send_calibration(bus: Bus, section: CalibrationSection) -> Reply:
    """Send a calibration to the wrench service; return the reply.

    Raises BusError when there is no reply.
    """
    request = CalibrationRequest(calibration_json=section.model_dump_json())
    give_up_ns = bus.clock.now_ns() + round(SEND_TIMEOUT_S * NS_PER_S)
    while True:
        reply = bus.ask(topics.CALIBRATE, request)
        is_transient = not reply.accepted and reply.code in TRANSIENT_REFUSALS
        if not is_transient or bus.clock.now_ns() > give_up_ns:
            return reply
        bus.clock.sleep_s(SEND_AGAIN_S)
