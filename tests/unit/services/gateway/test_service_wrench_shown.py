"""Command 4 without force feedback in the controller, for a display or a log there."""

import pytest

from common.motion.convert import record_of
from forcemesh.messages import WrenchAtTcp
from tests.contract.rig import shifted
from tests.contract.robots import Emulated

WRENCH = WrenchAtTcp(force_N=(1.0, 0.0, 12.0), torque_Nm=(0.1, 0.2, 0.3))


class ShownWrench:
    """A cell whose gateway streams set points; the shipped program counts the readings."""

    def __init__(self, wrench: WrenchAtTcp | None = WRENCH, **overrides: object) -> None:
        """Connect and arm."""
        self.cell = Emulated(host="pc", **overrides)
        self.rig = self.cell.rig
        self.rig.connect()
        self.rig.arm()
        self.rig.wrench = wrench
        self.target = shifted(self.rig.T, z_m=0.002)
        self.rig.send("setpoint", pose=record_of(self.target))
        self.rig.advance(1.0)

    def readings(self, duration_s: float = 1.0) -> float:
        """Return how many readings the program receives in a time."""
        before = self.cell.machine.memory.read("fm.wn")
        self.rig.advance(duration_s)
        return float(self.cell.machine.memory.read("fm.wn")) - float(before)  # type: ignore[arg-type]


def test_the_reading_is_sent_at_the_rate_of_a_status_and_moves_nothing() -> None:
    """20 times a second while armed, whatever is commanded; not in a hold."""
    shown = ShownWrench(**{"gateway.send_wrench": True})
    memory = shown.cell.machine.memory
    assert shown.readings() == pytest.approx(20, abs=2)
    assert shown.rig.state.hold_reason == ""
    assert abs(shown.rig.T.translation - shown.target.translation).max() < 1e-4
    bank = int(float(memory.read("fm.wb")))  # type: ignore[arg-type]
    units = [memory.read(f"fm.w[{bank},{k}]") for k in range(1, 7)]
    assert units == [100, 0, 1200, 100, 200, 300]
    assert (memory.read("fm.mode"), memory.read("fm.zn")) == (0, 0)
    shown.rig.send("idle")
    assert shown.readings() == pytest.approx(20, abs=2)
    shown.rig.send_hold()
    shown.rig.advance(0.1)
    assert shown.readings() == 0


@pytest.mark.parametrize(("is_asked_for", "wrench"), [(False, WRENCH), (True, None)])
def test_none_is_sent_by_default_or_without_a_reading(
    is_asked_for: bool, wrench: WrenchAtTcp | None
) -> None:
    """Only what was measured, and only where the cell file has it."""
    shown = ShownWrench(wrench, **{"gateway.send_wrench": is_asked_for})
    assert shown.cell.machine.memory.read("fm.wn") == 0
