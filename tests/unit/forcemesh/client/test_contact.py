"""`cell.contact` on a whole cell in virtual time: press, slide and leave; waits and errors."""

from collections.abc import Iterator

import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.client import LostError, NotReachedError, NotValidError
from forcemesh.requests import ForceStartRequest
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import CELL, DEMO, HALF_RATES

ALONG_TOOL = (False, False, True) * 2
SLIDE_M = 0.02
assert CELL.sim is not None
GAP_MM = 1e3 * CELL.sim.gap_m


class ContactCell:
    """An armed cell in virtual time with its client."""

    def __init__(self) -> None:
        self.world = VirtualCell(load_cell(DEMO, {"rates": HALF_RATES}))
        self.client = ConfiguredCell(self.world.cell, bus=self.world.client, commander="operator")
        self.client.wait_ready()
        self.client.tare()
        self.client.arm()
        self.world.advance(0.1)

    def press(self) -> None:
        """Start a press along the tool."""
        request = ForceStartRequest(mode="position", setpoint_N=10.0, law="adaptive")
        self.client.force.begin(request.replaced(axes=ALONG_TOOL))


@pytest.fixture
def lab() -> Iterator[ContactCell]:
    """The demo's cell, armed, the tool above the plate."""
    made = ContactCell()
    with made.client:
        yield made


def test_press_slide_and_leave_are_exactly_these_states(lab: ContactCell) -> None:
    """With place, normal, impact speed, peak force and slid length of the job."""
    client, start = lab.client, lab.world.arm.T_base_tcp.translation.copy()
    assert client.contact().state == "free"
    lab.press()
    client.contact.wait("contact", within_s=10.0)
    lab.world.advance(1.0)
    x, y, z = start
    client.force.path(((x, y + SLIDE_M, z),), speed_m_s=0.02)
    client.contact.wait("sliding", within_s=3.0)
    client.contact.wait("contact", within_s=3.0)
    client.force.stop()
    client.jog(shift_m=(0.0, 0.0, -0.01), axes="tool")
    client.contact.wait("free", within_s=3.0)
    events = client.contact.changes()
    states = [event.state for event in events]
    assert states == ["free", "approach", "impact", "contact", "sliding", "contact", "lost", "free"]
    numbers = [event.number for event in events]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    impact, contact, sliding, lost = events[2], events[3], events[4], events[-2]
    assert 1e3 * (start - impact.position_m)[2] == pytest.approx(GAP_MM, abs=0.2)
    assert impact.normal == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)
    assert 0.002 < impact.impact_m_s <= CELL.force.approach_m_s
    assert 5.0 < contact.before_peak_N < 12.0
    assert 9.0 < sliding.peak_N < 13.0
    assert lost.slid_m == pytest.approx(SLIDE_M, rel=0.1)


def test_a_silent_regulator_is_lost_and_an_unknown_state_not_valid(lab: ContactCell) -> None:
    """Waiting ends with the error that says which."""
    lab.client.contact()
    lab.world.kill("robot")
    lab.world.advance(0.5)
    with pytest.raises(NotValidError, match="sensor/wrench stale"):
        lab.client.contact(within_s=0.1)
    with pytest.raises(NotReachedError, match="is unknown"):
        lab.client.contact.wait("impact", within_s=0.1)
    lab.world.kill("regulator")
    with pytest.raises(LostError, match="contact is missing or stale"):
        lab.client.contact.wait("impact", within_s=1.0)
