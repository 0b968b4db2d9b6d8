"""Some of the abuses on real sockets, with a proxy between gateway and controller.

Bounds are in the controller's time, so a slow machine does not make them longer.
"""

import random
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.contract.test_abuse_wire import BREAKING, DOWN, UP
from tests.fakes.hostile_cell import LoneController, SocketCell
from tests.fakes.hostile_stream import Freeze, Gather

pytestmark = [pytest.mark.judged_once, pytest.mark.realtime]

ROOT = Path(__file__).resolve().parents[2]
LATE_S = 0.02  # the proxy's thread and the loop that steps gateway and controller take turns
CASES = [
    ("half a packet, then silence", DOWN, "goal"),
    ("a byte replaced", UP, "stream"),
    ("a reset", DOWN, "feedback"),
]


@pytest.mark.parametrize(("name", "direction", "motion"), CASES)
def test_an_abuse_ends_in_a_hold_that_only_arming_ends(
    name: str, direction: str, motion: str
) -> None:
    """As in lock step; the gateway's link detects the abuse and connects again."""
    case = BREAKING[name]
    with ExitStack() as stack:
        cell = SocketCell(stack)
        cell.begin(motion)
        abuse = cell.proxy.strike(direction, case.make(random.Random(name)))
        cell.rig.until(lambda: abuse.bites)
        bitten_ns = cell.machine.now_ns
        cell.rig.advance(0.8)
        took_s = (cell.stopped_ns(bitten_ns) - bitten_ns) / 1e9
        assert took_s <= case.bound_s + LATE_S
        assert cell.rig.state.hold_reason
        cell.assert_stays(2.0 if isinstance(abuse, Freeze) else 0.3)
        cell.rig.wrench = None
        cell.assert_obeys_after_arming()
        assert len(cell.hops) >= 2
        cell.assert_nothing_misread()


def test_how_bytes_are_cut_makes_no_difference() -> None:
    """Chunks of 100 bytes in both directions: a goal is done, and every packet was decoded."""
    with ExitStack() as stack:
        cell = SocketCell(stack)
        cell.proxy.standing = {UP: lambda: Gather(size=100), DOWN: lambda: Gather(size=100)}
        cell.begin("goal")
        cell.assert_obeys_after_arming()
        assert any(hop.to_controller.abuse.bites for hop in cell.hops)
        assert any(hop.to_gateway.abuse.bites for hop in cell.hops)
        cell.assert_nothing_misread()


@pytest.mark.processes
def test_a_gateway_that_is_killed_while_force_feedback_runs_leaves_an_arm_that_holds() -> None:
    """SIGKILL; a gateway that is started again moves nothing before a person arms."""
    with ExitStack() as stack:
        cell = LoneController(stack)

        def start(what: str) -> subprocess.Popen[str]:
            words = [sys.executable, "-m", "tests.fakes.hostile_gateway", str(cell.proxy.port)]
            process = stack.enter_context(subprocess.Popen([*words, what], cwd=ROOT, text=True))
            stack.callback(process.kill)
            return process

        gateway = start("feedback")
        cell.rig.until(lambda: cell.machine.memory.read("fm.mode") == 1.0, within_s=30.0)
        cell.rig.until(lambda: cell.moves)
        cell.rig.advance(0.2)
        killed_ns = cell.machine.now_ns
        gateway.kill()
        cell.rig.advance(0.6)
        assert (cell.stopped_ns(killed_ns) - killed_ns) / 1e9 <= BREAKING[
            "a reset"
        ].bound_s + LATE_S
        assert cell.machine.memory.read("fm.mode") == 0.0
        cell.assert_stays(0.5)
        start("idle")
        cell.rig.until(lambda: cell.machine.memory.read("fm.link") == 1.0, within_s=30.0)
        cell.assert_stays(1.0)
        cell.assert_nothing_misread()
