"""A random sequence of all events that the gateway can meet; every packet is checked.

The check is in tests/fakes/gateway_world.py: no motion without a valid permission, nothing of an
ended lease, the first set point at the arm's pose, IDs without a gap, holds with a reason.
"""

from math import nan
from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
)

from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, Com, Status
from forcemesh.messages import Feedback, Gains, PoseRecord, RobotCommand, WrenchAtTcp
from tests.contract.rig import DEADLINE_S, goal
from tests.fakes.gateway_world import GatewayWorld

small_m = st.floats(-2e-3, 2e-3)
steps = st.integers(1, 8)
modes = st.sampled_from(["position", "both"])
mostly_true = st.sampled_from([True, True, False])
LIGHTS = tuple(Status)


class GatewayMachine(RuleBasedStateMachine):
    """Commands, faults and time in any order."""

    def __init__(self) -> None:
        """Start a gateway with its controller."""
        super().__init__()
        self.world = GatewayWorld()
        self.goal_id = 0

    def recover(self, enabled: bool) -> None:
        """Remove all faults and arm again where the gateway holds, as an operator does."""
        if enabled and self.world.gateway.verdict.command is None:
            self.repair()
            self.world.live(80)
            self.arm()

    def send(self, kind: str, steps: int = 1, **content: Any) -> None:
        """Send a permitted command for a few periods, as the arbiter does."""
        for _ in range(steps):
            self.world.send(self.world.permitted(kind, **content))
            self.world.live(2)

    # --- the arbiter ------------------------------------------------------------------------------

    @initialize()
    def begin(self) -> None:
        """Arm."""
        self.arm()

    @rule()
    def arm(self) -> None:
        """Arm under a new lease, as an operator does."""
        self.world.lease, self.world.turn = self.world.lease + 1, 0
        self.send("idle", 3)

    @rule(n=steps)
    def idle(self, n: int) -> None:
        """Command no motion."""
        self.send("idle", n)

    @rule(n=steps, x_m=small_m, z_m=small_m, anew=mostly_true)
    def stream(self, n: int, x_m: float, z_m: float, anew: bool) -> None:
        """Stream set points of the regulator."""
        self.recover(anew)
        self.send("setpoint", n, pose=self.world.shifted(x_m, 0.0, z_m))

    @rule(n=steps, z_m=small_m)
    def stream_at_once(self, n: int, z_m: float) -> None:
        """Begin a new lease with a set point, without a pause."""
        self.repair()
        self.world.lease, self.world.turn = self.world.lease + 1, 0
        self.send("setpoint", n, pose=self.world.shifted(0.0, 0.0, z_m))

    @rule(n=steps, kind=st.sampled_from(["pose", "joints", "by"]), anew=mostly_true)
    def move(self, n: int, kind: str, anew: bool) -> None:
        """Command a new goal or the present one."""
        self.recover(anew)
        self.goal_id += anew
        turn = (0.01, 0.0, 0.0, 0.0, 0.0, 0.0)
        content: Any = {"joint_rad": turn}
        if kind == "pose":
            content = {"pose": self.world.shifted(0.0, 0.0, -5e-3)}
        elif kind == "joints":
            content = {"joint_rad": tuple(np.add(self.world.controller.joint_rad, turn).tolist())}
        self.send("goal", n, goal=goal(max(self.goal_id, 1), kind, **content))

    @rule(n=steps, mode=modes, gain=st.sampled_from([1e-5, 2e-5]), anew=mostly_true)
    def run_feedback(self, n: int, mode: Any, gain: float, anew: bool) -> None:
        """Command force feedback in the controller."""
        self.recover(anew)
        gains = Gains(force_p_m_per_N=(gain, gain, gain))
        self.send("feedback", n, feedback=Feedback(mode=mode, gains=gains))

    @rule()
    def next_owner(self) -> None:
        """Change the owner under the same lease."""
        self.world.turn += 1
        self.send("idle")

    @rule()
    def hold(self) -> None:
        """Command a hold."""
        self.world.send(RobotCommand(reason="test"))
        self.world.live(2)
        assert self.world.gateway.verdict.command is None

    @rule()
    def restart_the_arbiter(self) -> None:
        """Let another arbiter process arm."""
        world = self.world
        world.epoch, world.seq, world.lease, world.turn = world.epoch + 1, 0, 1, 0
        self.send("idle")

    # --- commands that no arbiter sends -----------------------------------------------------------

    @rule(back=st.sampled_from([(-1, 0), (0, -1), (-1, 5)]))
    def send_expired(self, back: tuple[int, int]) -> None:
        """Send a command of an earlier lease or turn."""
        pose = self.world.shifted(1e-3, 0.0, 0.0)
        self.world.send(
            self.world.permitted("setpoint", lease=back[0], turn=back[1], pose=pose), keep=False
        )
        self.world.live(2)

    @precondition(lambda self: len(self.world.sent) > 1)
    @rule(share=st.floats(0.0, 0.99))
    def replay(self, share: float) -> None:
        """Send the bytes of an older command again."""
        self.world.put(self.world.sent[int(share * (len(self.world.sent) - 1))])
        self.world.live(2)

    @rule(late_s=st.sampled_from([0.5, 2.0]) | st.floats(0.0, 2.0 * DEADLINE_S))
    def send_late(self, late_s: float) -> None:
        """Send a delayed command."""
        pose = self.world.shifted(1e-3, 0.0, 0.0)
        self.world.send(self.world.permitted("setpoint", pose=pose), late_s=late_s)
        self.world.live(2)

    @rule(kind=st.sampled_from(["setpoint", "goal"]), axis=st.integers(0, 2))
    def send_nan(self, kind: str, axis: int) -> None:
        """Send a pose with NaN."""
        x, y, z = (nan if number == axis else 0.3 for number in range(3))
        pose = PoseRecord(position_m=(x, y, z), orientation_xyzw=(0, 0, 0, 1))
        content: dict[str, Any] = {"pose": pose}
        if kind == "goal":
            content = {"goal": goal(self.goal_id, "joints").replaced(**content)}
        command = self.world.permitted("idle").replaced(**({"kind": kind} | content))
        self.world.send(command, keep=False)
        self.world.allowed = None
        self.world.live(2)

    @rule(kind=st.sampled_from(["setpoint", "pose", "joints", "feedback", "nothing"]))
    def exceed_limits(self, kind: str) -> None:
        """Send a command exceed_limits the limits, or one without content."""
        self.goal_id += 1
        far = self.world.shifted(0.0, 0.0, 1.5)
        content: dict[str, Any] = {}
        if kind == "pose":
            content = {"goal": goal(self.goal_id, "pose", pose=far)}
        elif kind == "joints":
            content = {"goal": goal(self.goal_id, "joints", joint_rad=(9.0,) * 6)}
        elif kind == "feedback":
            huge = Feedback(mode="position", setpoint_force_N=(0.0, 0.0, 1e4), gains=Gains())
            content = {"feedback": huge}
        elif kind == "setpoint":
            content = {"pose": far}
        sent_kind = {"pose": "goal", "joints": "goal", "nothing": "setpoint"}.get(kind, kind)
        self.world.send(self.world.permitted(sent_kind, **content))
        self.world.live(2)

    # --- everything else --------------------------------------------------------------------------

    @rule(force_N=st.sampled_from([None, 0.0, 20.0, 1e3]))
    def wrench(self, force_N: float | None) -> None:
        """Stop, resume or overload the wrench."""
        push = None if force_N is None else WrenchAtTcp(force_N=(0.0, 0.0, force_N))
        self.world.wrench = push

    @rule()
    def hang_up(self) -> None:
        """Close the link; it is opened again later."""
        self.world.controller.close("closed by the controller", self.world.clock.now_ns())
        self.world.live(2)
        assert self.world.gateway.verdict.command is None

    @rule(data=st.binary(min_size=63, max_size=130) | st.just(encode(Packet(ID_FIRST, Com.HELLO))))
    def receive_garbage(self, data: bytes) -> None:
        """Send malformed bytes, or a report out of place."""
        self.world.controller.insert(data)
        self.world.live(2)

    @rule(size=st.integers(1, 125))
    def receive_half_a_packet(self, size: int) -> None:
        """Split the received bytes at any place."""
        self.world.controller.held_back = size
        self.world.live(2)

    @rule(bit=st.sampled_from(LIGHTS), on=st.booleans())
    def set_status_bit(self, bit: Status, on: bool) -> None:
        """Set or clear a status bit that it should not be."""
        controller = self.world.controller
        controller.on, controller.off = (bit, Status(0)) if on else (Status(0), bit)

    @rule()
    def repair(self) -> None:
        """Remove all faults."""
        self.world.controller.on = self.world.controller.off = Status(0)
        self.world.wrench = WrenchAtTcp()

    @rule(n=st.sampled_from([1, 5, 30, 150]))
    def live(self, n: int) -> None:
        """Let time pass without a command."""
        self.world.live(n)


TestGatewayMachine = GatewayMachine.TestCase
TestGatewayMachine.settings = settings(max_examples=100, stateful_step_count=40)


def test_a_stream_after_a_hold_begins_where_the_arm_is() -> None:
    """With the next lease's first command at once; the random sequence rarely leads there."""
    machine = GatewayMachine()
    machine.begin()
    machine.stream(16, 1e-3, 1e-3, anew=False)
    machine.hold()
    machine.live(5)
    machine.stream_at_once(8, 2e-3)
    assert machine.world.states[-1].sent is not None
