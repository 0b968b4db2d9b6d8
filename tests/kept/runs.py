"""Reference runs: both laws, both hosts, all modes, faults, timely and late data.

A run is a cell file, changed values, and the actions of a client and of a fault. A run is never
changed: new ones are added.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from forcemesh import topics
from forcemesh.force_task import GUIDED, parse_task
from forcemesh.messages import Speed
from forcemesh.requests import BackOffRequest, Empty, PathRequest
from tests.kept.rig import KeptRig, shifted

SIM, TCP = "demo.yaml", "demo-tcp.yaml"
NEAR = {"sim.gap_m": 0.001}
TILTED = {**NEAR, "sim.tilt_deg": 3.0}
SECOND_SETPOINT_N = {"position": 5.0, "orientation": 0.0, "both": 10.0}


@dataclass(frozen=True)
class Run:
    """One run."""

    actions: Callable[[KeptRig], None]
    file: str = SIM
    changes: dict[str, Any] = field(default_factory=lambda: dict(NEAR))

    def run_cell(self) -> KeptRig:
        """Run it from the start of a cell."""
        rig = KeptRig(self.file, **self.changes)
        self.actions(rig)
        return rig


def press_then(rig: KeptRig, mode: Any, **how: Any) -> None:
    """Press in mode position, then change mode and set point; over TCP with confirmed axes."""
    rig.begin()
    if rig.wire is not None:
        rig.confirm_axes()
    rig.force(**how)
    rig.until_force_N(18.0)
    rig.wait(0.3)
    rig.force(mode, SECOND_SETPOINT_N[mode], **how)
    rig.wait(0.7)
    rig.send_request(topics.FORCE_STOP, Empty())
    rig.wait(0.1)
    rig.hold()


def guided(rig: KeptRig) -> None:
    """Guide the tool by hand back and forth in free space."""
    rig.begin()
    rig.confirm_axes()
    rig.force(setpoint_N=0.0, task=parse_task(GUIDED["position"]))
    for force_N in ((8.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-8.0, 4.0, 0.0), (0.0, 0.0, 0.0)):
        rig.push(*force_N)
        rig.wait(0.3)
    rig.hold()


def follow_path(rig: KeptRig) -> None:
    """Follow a path across the plate while pressing."""
    rig.begin()
    rig.force()
    rig.until_force_N(18.0)
    p = rig.cell.arm.T_base_tcp.translation
    points = tuple((p[0] + dx, p[1] + dy, p[2]) for dx, dy in ((0.01, 0.0), (0.01, 0.01)))
    rig.send_request(topics.FORCE_PATH, PathRequest(points_m=points))
    rig.wait(1.5)
    rig.hold()


def moved(rig: KeptRig) -> None:
    """Move in each way, once pre-empted by the operator, once refused."""
    rig.begin()
    rig.send_request(topics.SPEED, Speed(mechanical_m_s=0.1, modular_fraction=0.5))
    rig.move(kind="pose", pose=rig.shifted_pose(0.02, 0.0, 0.03, turn_rad=(0.0, 0.1, 0.1)))
    rig.wait(1.2)
    rig.move(kind="by", joint_rad=(0.05, 0.0, 0.0, 0.0, 0.0, -0.1), commander="program")
    rig.wait(0.2)
    rig.move(kind="pose", pose=rig.shifted_pose(0.0, 0.02, 0.0))
    rig.wait(1.5)
    rig.move(kind="pose", pose=rig.shifted_pose(2.0, 0.0, 0.0))
    rig.wait(0.2)
    rig.hold()


def spoiled(rig: KeptRig, change: Any, for_s: float = 0.15) -> None:
    """Inject a sensor fault while the tool presses; then arm and press again."""
    rig.begin()
    rig.force()
    rig.until_force_N(18.0)
    rig.disturb(change)
    rig.wait(for_s)
    rig.disturb(None)
    rig.wait(1.3)
    rig.arm()
    rig.force()
    rig.wait(0.5)
    rig.hold()


def failed(sample: Any) -> Any:
    """Return the sample of a failed sensor."""
    return type(sample)(sample.force_N, sample.torque_Nm, "fault", sample.counter)


def backed_off(rig: KeptRig) -> None:
    """Exceed the force ceiling: held, backed off, armed."""
    rig.begin()
    rig.force()
    rig.until_force_N(18.0)
    rig.disturb(shifted(0.0, 0.0, -70.0, 0.0, 0.0, 0.0))
    rig.wait(0.3)
    rig.disturb(shifted(0.0, 0.0, -50.0, 0.0, 0.0, 0.0))
    rig.wait(1.3)
    rig.send_request(topics.BACK_OFF, BackOffRequest())
    rig.wait(1.0)
    rig.disturb(None)
    rig.wait(1.3)
    rig.arm("jog")
    rig.hold()


def frozen(rig: KeptRig, *, role: str, stalls_s: tuple[float, ...], **how: Any) -> None:
    """Freeze a process repeatedly, in approach and in contact; arm again if held."""
    rig.begin()
    rig.force(**how)
    for stall_s in stalls_s:
        rig.wait(0.25)
        rig.freeze(role, stall_s)
    rig.wait(1.3)
    rig.arm()
    rig.force(**how)
    rig.wait(0.4)
    rig.hold()


def killed(rig: KeptRig, role: str) -> None:
    """Kill a process while the tool presses."""
    rig.begin()
    rig.force()
    rig.until_force_N(18.0)
    rig.cell.kill(role)
    rig.wait(0.5)


def stalled(rig: KeptRig, *, out_s: tuple[float, ...], in_s: tuple[float, ...], **how: Any) -> None:
    """Stall one direction of the wire while the tool presses, then the other one."""
    rig.begin()
    rig.force(**how)
    rig.until_force_N(15.0)
    for direction, stalls_s in (("out", out_s), ("in", in_s)):
        for stall_s in stalls_s:
            rig.stall(direction, stall_s)
            rig.wait(stall_s + 0.3)
    rig.hold()


def emergency(rig: KeptRig, **how: Any) -> None:
    """Press the emergency stop while the tool presses; reset, arm, press again."""
    rig.begin()
    rig.force(**how)
    rig.until_force_N(15.0)
    pendant = rig.machine.pendant
    pendant.emergency_stop()
    rig.wait(1.0)
    pendant.release_emergency_stop()
    pendant.motor_power(on=True)
    pendant.error_reset()
    pendant.run()
    rig.wait(1.5)
    rig.arm()
    rig.force(**how)
    rig.wait(0.6)
    rig.hold()


def _modes(file: str, **how: Any) -> dict[str, Run]:
    name = "-".join([*how.values(), "tcp" if file == TCP else "sim"])
    return {
        f"{name}-{mode}": Run(partial(press_then, mode=mode, **how), file, TILTED)
        for mode in SECOND_SETPOINT_N
    }


RUNS: dict[str, Run] = {
    **_modes(SIM, law="plain"),
    **_modes(SIM, law="adaptive"),
    **_modes(TCP, law="plain", host="pc"),
    **_modes(TCP, law="adaptive", host="pc"),
    **_modes(TCP, law="plain", host="controller"),
    **_modes(TCP, law="adaptive", host="controller"),
    "guided": Run(guided),
    "path": Run(follow_path, changes=TILTED),
    "moves-sim": Run(moved, changes={"sim.gap_m": 0.05}),
    "moves-tcp": Run(moved, TCP, {"sim.gap_m": 0.05}),
    "sensor-silent": Run(partial(spoiled, change=lambda _: None)),
    "sensor-fault": Run(partial(spoiled, change=failed)),
    "sensor-saturated": Run(partial(spoiled, change=shifted(0.0, 0.0, 490.0, 0.0, 0.0, 0.0))),
    "sensor-jump": Run(partial(spoiled, change=shifted(400.0, 0.0, 0.0, 0.0, 0.0, 0.0))),
    "back-off": Run(backed_off),
    "regulator-killed": Run(partial(killed, role="regulator")),
    "arbiter-killed": Run(partial(killed, role="arbiter")),
    "late-wrench": Run(partial(frozen, role="wrench", stalls_s=(0.01, 0.03, 0.06))),
    "late-regulator-adaptive": Run(
        partial(frozen, role="regulator", stalls_s=(0.02, 0.05), law="adaptive")
    ),
    "late-arbiter": Run(partial(frozen, role="arbiter", stalls_s=(0.03, 0.15))),
    "stalls-pc": Run(partial(stalled, out_s=(0.05, 0.12), in_s=(0.05, 0.12), host="pc"), TCP),
    "stalls-controller": Run(
        partial(stalled, out_s=(0.05, 0.2), in_s=(0.05,), host="controller"), TCP
    ),
    "emergency-stop": Run(partial(emergency, host="controller"), TCP),
}
