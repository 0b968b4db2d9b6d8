"""Test of the last check with an authenticated hostile arbiter: `python -m tests.fuzz.commands`.

Random robot commands from a seed, a million by default, are sent to the gateway (with a controller
that executes everything) and to the simulated robot, on a virtual clock. No output may be outside
the limits of the cell. Prints the commands sent and executed, and the margins; exit code 1 if a
limit was violated.
"""

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from math import hypot, radians
from pathlib import Path as File
from unittest.mock import patch

import numpy as np
import pinocchio as pin

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.permission import GateDecision
from forcemesh import reader, topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.messages import RobotState, Vec3, WrenchAtTcp
from services.gateway.service import Gateway
from sim.robot.engine import mujoco
from sim.robot.service import SimRobot
from tests.fuzz.hostile_arbiter import HostileArbiter
from tests.fuzz.judges import ArmJudge, PacketJudge
from tests.fuzz.permissive_arbiter import PermissiveController

CELLS = File(__file__).resolve().parents[2] / "cells"
BLOCK = 5000  # messages per robot instance; the next block has a new instance and the next seed
TICK_NS = 1_000_000
WRENCH_MS = 4
MOVING = {b"000001", b"000002", b"000003", b"000004", b"000013"}
# Small limits, so that all of them are reached often.
LIMITS = {
    "limits.workspace_min_m": [-0.12, 0.36, 0.10],
    "limits.workspace_max_m": [0.12, 0.59, 0.34],
    "limits.tether_m": 0.15,
    "limits.tether_deg": 60,
    "sim.gap_m": 0.1,
}


@dataclass(slots=True)
class Table:
    """Results of the test."""

    messages: int = 0
    obeyed: int = 0  # commands accepted as new under a permission
    moved_ms: int = 0  # time with commanded motion [ms], or number of motion packets
    virtual_s: float = 0.0
    kinds: Counter[str] = field(default_factory=Counter)
    holds: Counter[str] = field(default_factory=Counter)
    broken: Counter[str] = field(default_factory=Counter)
    first_broken: str = ""
    most_m: float = 0.0  # in 250 ms
    most_m_s: float = 0.0

    def add(self, other: "Table") -> None:
        """Add the results of another block."""
        for name in ("messages", "obeyed", "moved_ms", "virtual_s"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("kinds", "holds", "broken"):
            getattr(self, name).update(getattr(other, name))
        self.first_broken = self.first_broken or other.first_broken
        self.most_m = max(self.most_m, other.most_m)
        self.most_m_s = max(self.most_m_s, other.most_m_s)


class World:
    """Robot on a virtual clock with the hostile arbiter, a correct wrench, and the judge."""

    def __init__(self, robot: str, seed: int) -> None:
        """Start all components."""
        name = "demo.yaml" if robot == "sim" else "demo-tcp.yaml"
        self.cell: CellConfig = load_cell(CELLS / name, LIMITS)
        self.clock, self.transport = ManualClock(), MemoryTransport()
        self.table, self._robot, self._seed = Table(), robot, seed
        limits = self.cell.limits
        self._hostile = HostileArbiter(
            seed,
            self.cell.cell,
            self.clock.boot,
            speed_m_s=limits.speed_m_s,
            speed_rad_s=radians(limits.speed_deg_s),
        )
        self._force_rng = np.random.default_rng(seed)
        self._push_N = 0.0
        self._wrench = self._bus("wrench").publisher(topics.WRENCH)
        topic = topics.ROBOT_COMMAND
        self._put = self.transport.publish(f"{self.cell.cell}/{topic.key}", topic.qos)
        self._state = self._bus("arbiter").reader(topics.ROBOT_STATE)
        self._above = False
        self._permitted_ns = -NS_PER_S
        self._last_state: object = None
        self._start()

    def _bus(self, role: str) -> Bus:
        epoch = 7 if role == "robot" else 9
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock, epoch)

    def _start(self) -> None:
        if self._robot == "sim":
            self._sim = SimRobot(self._bus("robot"), self.cell)
            self._arm_judge = ArmJudge(self.cell)
            self._twin = mujoco.MjData(self._sim.arm.model)
        else:
            self._controller = PermissiveController((0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0))
            self._gateway = Gateway(self._bus("robot"), self.cell, self._controller)
            self._packet_judge = PacketJudge(self.cell)

    @property
    def _judge(self) -> ArmJudge | PacketJudge:
        return self._arm_judge if self._robot == "sim" else self._packet_judge

    def run(self, messages: int) -> Table:
        """Let the hostile arbiter send this many messages."""
        for _ in range(100):
            self._live()
        pause_ms = 0
        for _ in range(messages):
            state = self._state.read(self.clock.now_ns()).message
            timed = self._hostile.next_message(self.clock.now_ns(), state)
            self._put(timed.data)
            self.table.kinds[timed.kind] += 1
            if timed.permitted:
                self._permitted_ns = self.clock.now_ns()
            pause_ms = timed.pause_ms
            for _ in range(pause_ms):
                self._live()
        table, judge = self.table, self._judge
        table.messages, table.broken = messages, judge.broken
        table.virtual_s = self.clock.now_ns() / NS_PER_S
        table.most_m, table.most_m_s = judge.path.most_m, judge.path.most_m_s
        return table

    def _live(self) -> None:
        """Advance by one millisecond."""
        self.clock.advance_ns(TICK_NS)
        now_ns = self.clock.now_ns()
        if now_ns // TICK_NS % WRENCH_MS == 0:
            self._push()
        before = sum(self._judge.broken.values())
        if self._robot == "sim":
            self._live_sim(now_ns)
        else:
            self._live_gateway(now_ns)
        if sum(self._judge.broken.values()) > before and not self.table.first_broken:
            where = f"seed {self._seed}, {now_ns / NS_PER_S:.3f} s"
            self.table.first_broken = f"{where}: {dict(self._judge.broken)}"
        if self._state.poll():
            state = self._state.read(now_ns).message
            if state is not None:
                self._note(state)

    def _note(self, state: RobotState) -> None:
        if state.hold_reason:
            self.table.holds[state.hold_code] += 1
        accepted_now = (
            None if state.accepted is None else (state.accepted.epoch, state.accepted.seq)
        )
        if accepted_now != self._last_state:
            self._last_state, self.table.obeyed = accepted_now, self.table.obeyed + 1

    def _push(self) -> None:
        """Publish a correct wrench: contact, and occasionally a force above the ceiling."""
        if self._force_rng.random() < 0.005:
            self._push_N = float(self._force_rng.choice([0.0, 0.0, 0.0, 0.0, 5.0, 30.0, 100.0]))
        force: Vec3 = (0.0, 0.0, self._push_N)
        torque: Vec3 = (0.0, 0.0, 0.0)
        if self._robot == "sim":
            true = self._sim.arm.true_wrench()
            force, torque = vec3(true.force_N + np.array(force)), vec3(true.torque_Nm)
        self._wrench.put(WrenchAtTcp(force_N=force, torque_Nm=torque))
        limits = self.cell.limits
        self._above = hypot(*force) > limits.force_N or hypot(*torque) > limits.torque_Nm

    def _live_sim(self, now_ns: int) -> None:
        robot, judge, at_s = self._sim, self._arm_judge, now_ns / NS_PER_S
        judge.force(at_s, above=self._above)
        before = robot.arm.q_command
        robot.step(now_ns)
        q = robot.arm.q_command
        twin = self._twin
        twin.qpos[:6] = q
        mujoco.mj_kinematics(robot.arm.model, twin)
        tool_m = np.array(twin.site("tcp").xpos)
        R = twin.site("tcp").xmat.reshape(3, 3)
        T_flange_tcp = self.cell.tool.T_flange_tcp.pose
        flange = pin.SE3(np.array(R), tool_m) * T_flange_tcp.inverse()
        lease, backs_off = lease_of(robot.verdict), is_backing_off(robot.verdict)
        judge.check(at_s, q, flange, tool_m, lease=lease, backs_off=backs_off)
        self.table.moved_ms += not np.array_equal(q, before)

    def _live_gateway(self, now_ns: int) -> None:
        controller, gateway, judge = self._controller, self._gateway, self._packet_judge
        joints, above = controller.joint_rad.copy(), self._above
        lease = lease_of(gateway.verdict)
        gateway.step(now_ns)
        measured = gateway.driver.measured
        T = controller.T if measured is None else measured.T_base_flange
        if lease_of(gateway.verdict) not in {None, lease}:
            judge.start = T.copy()
        deadline_ns = self.cell.stale_after_s(topics.ROBOT_COMMAND) * NS_PER_S
        may_move = now_ns - self._permitted_ns <= deadline_ns and (
            not above or is_backing_off(gateway.verdict)
        )
        command = gateway.verdict.command
        kind = "" if command is None else command.kind
        for chars in controller.sent:
            judge.packet(now_ns / NS_PER_S, chars, kind=kind, may_move=may_move, T=T, q=joints)
            self.table.moved_ms += chars[7:13] in MOVING
        controller.sent.clear()


def lease_of(verdict: GateDecision) -> tuple[int, int, int, str] | None:
    """Return arbiter epoch, number, challenge and purpose of the lease in force, or None.

    A number that is used again with another challenge or purpose is another lease.
    """
    command, accepted = verdict.command, verdict.accepted
    if command is None or command.permission is None or accepted is None:
        return None
    given = command.permission
    return accepted.epoch, given.lease, given.challenge, given.purpose


def is_backing_off(verdict: GateDecision) -> bool:
    """Return whether the lease in force is a back-off: it may move above the force ceiling."""
    permission = None if verdict.command is None else verdict.command.permission
    return permission is not None and permission.purpose == "back_off"


def fuzz(robot: str, messages: int, seed: int, *, verbose: bool = False) -> Table:
    """Fuzz one robot in blocks; return the results.

    Repeated change of the publisher identity would hold the arm by itself (`two_writers`). It is
    left out here, so that the limits themselves are tested.
    """
    table, began_s = Table(), time.monotonic()
    while table.messages < messages:
        block = min(BLOCK, messages - table.messages)
        with patch.object(reader, "CONFLICT_NS", 0):
            table.add(World(robot, seed).run(block))
        seed += 1
        if verbose and seed % 10 == 0:
            rate = table.messages / (time.monotonic() - began_s)
            print(f"{robot}: {table.messages} messages, {rate:.0f}/s", flush=True)
    return table


def report(robot: str, table: Table, took_s: float) -> None:
    """Print a table."""
    rate = table.messages / took_s
    print(f"--- {robot}: {table.messages} messages in {took_s:.0f} s, {rate:.0f}/s")
    print(f"virtual time      {table.virtual_s:.0f} s")
    print(f"executed          {table.obeyed}")
    print(f"moved             {table.moved_ms} {'ms' if robot == 'sim' else 'packets'}")
    print(f"most in 250 ms    {table.most_m * 1e3:.1f} mm")
    print(f"fastest in 60 ms  {table.most_m_s * 1e3:.0f} mm/s")
    print(f"kinds             {dict(table.kinds.most_common())}")
    print(f"held for          {dict(table.holds.most_common())}")
    print(f"violations        {dict(table.broken) or 0}")
    if table.first_broken:
        print(f"first             {table.first_broken}")


def main() -> int:
    """Fuzz both robots, or one."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.commands", description=__doc__)
    parser.add_argument("robots", nargs="*", default=["gateway", "sim"], metavar="gateway|sim")
    parser.add_argument("--messages", type=int, default=1_000_000, help="in all")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    broken = 0
    for robot in arguments.robots:
        began_s = time.monotonic()
        share = arguments.messages // len(arguments.robots)
        table = fuzz(robot, share, arguments.seed, verbose=True)
        report(robot, table, time.monotonic() - began_s)
        broken += sum(table.broken.values())
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
