"""The runs whose outputs are kept: both laws, both hosts, all modes, faults, timely and late data.

A run is a cell file, what is changed in it, and what a client and a fault do to it. None of them is
ever changed: a new one is added beside them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from forcemesh import topics
from forcemesh.messages import Speed
from forcemesh.requests import BackOffRequest, Empty, PathRequest
from tests.kept.player import Player, shifted

SIM, TCP = "demo.yaml", "demo-tcp.yaml"
NEAR = {"sim.gap_m": 0.001}
TILTED = {**NEAR, "sim.tilt_deg": 3.0}
GIVEN_WAY_TO_N = {"position": 5.0, "orientation": 0.0, "both": 10.0}


@dataclass(frozen=True)
class Run:
    """One run."""

    play: Callable[[Player], None]
    file: str = SIM
    changes: dict[str, Any] = field(default_factory=lambda: dict(NEAR))
    is_short: bool = False  # `make test` plays it too

    def played(self) -> Player:
        """Play it from the start of a cell."""
        player = Player(self.file, **self.changes)
        self.play(player)
        return player


def press_then(player: Player, mode: Any, **how: Any) -> None:
    """Press in mode position, then go over to another mode and set point; over TCP with proof."""
    player.begin()
    if player.wire is not None:
        player.prove_axes()
    player.force(**how)
    player.until_force_N(18.0)
    player.wait(0.3)
    player.force(mode, GIVEN_WAY_TO_N[mode], **how)
    player.wait(0.7)
    player.ask(topics.FORCE_STOP, Empty())
    player.wait(0.1)
    player.hold()


def guided(player: Player) -> None:
    """A hand leads the tool to and fro in free space."""
    player.begin()
    player.prove_axes()
    player.force(setpoint_N=0.0, law="admittance")
    for force_N in ((8.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-8.0, 4.0, 0.0), (0.0, 0.0, 0.0)):
        player.push(*force_N)
        player.wait(0.3)
    player.hold()


def along(player: Player) -> None:
    """A path across the plate while it is pressed on."""
    player.begin()
    player.force()
    player.until_force_N(18.0)
    p = player.cell.arm.T_base_tcp.translation
    points = tuple((p[0] + dx, p[1] + dy, p[2]) for dx, dy in ((0.01, 0.0), (0.01, 0.01)))
    player.ask(topics.FORCE_PATH, PathRequest(points_m=points))
    player.wait(1.5)
    player.hold()


def moved(player: Player) -> None:
    """Moves of each kind, one taken over by the operator, and one that is refused."""
    player.begin()
    player.ask(topics.SPEED, Speed(mechanical_m_s=0.1, modular_fraction=0.5))
    player.move(kind="pose", pose=player.beside(0.02, 0.0, 0.03, turn_rad=(0.0, 0.1, 0.1)))
    player.wait(1.2)
    player.move(kind="by", joint_rad=(0.05, 0.0, 0.0, 0.0, 0.0, -0.1), commander="program")
    player.wait(0.2)
    player.move(kind="pose", pose=player.beside(0.0, 0.02, 0.0))
    player.wait(1.5)
    player.move(kind="pose", pose=player.beside(2.0, 0.0, 0.0))
    player.wait(0.2)
    player.hold()


def spoiled(player: Player, change: Any, for_s: float = 0.15) -> None:
    """A fault of the sensor while the tool presses; then armed again, and pressed again."""
    player.begin()
    player.force()
    player.until_force_N(18.0)
    player.disturb(change)
    player.wait(for_s)
    player.disturb(None)
    player.wait(1.3)
    player.arm()
    player.force()
    player.wait(0.5)
    player.hold()


def failed(sample: Any) -> Any:
    """Let the sensor say that it has failed."""
    return type(sample)(sample.force_N, sample.torque_Nm, "fault", sample.counter)


def backed_off(player: Player) -> None:
    """Above the force's ceiling: held, backed off, armed."""
    player.begin()
    player.force()
    player.until_force_N(18.0)
    player.disturb(shifted(0.0, 0.0, -70.0, 0.0, 0.0, 0.0))
    player.wait(0.3)
    player.disturb(shifted(0.0, 0.0, -50.0, 0.0, 0.0, 0.0))
    player.wait(1.3)
    player.ask(topics.BACK_OFF, BackOffRequest())
    player.wait(1.0)
    player.disturb(None)
    player.wait(1.3)
    player.arm("jog")
    player.hold()


def frozen(player: Player, *, role: str, stalls_s: tuple[float, ...], **how: Any) -> None:
    """A process stands still again and again, in approach and in contact; armed again, if held."""
    player.begin()
    player.force(**how)
    for stall_s in stalls_s:
        player.wait(0.25)
        player.freeze(role, stall_s)
    player.wait(1.3)
    player.arm()
    player.force(**how)
    player.wait(0.4)
    player.hold()


def killed(player: Player, role: str) -> None:
    """A process dies while the tool presses."""
    player.begin()
    player.force()
    player.until_force_N(18.0)
    player.cell.kill(role)
    player.wait(0.5)


def stalled(
    player: Player, *, out_s: tuple[float, ...], in_s: tuple[float, ...], **how: Any
) -> None:
    """One direction of the wire stalls while the tool presses, then the other one."""
    player.begin()
    player.force(**how)
    player.until_force_N(15.0)
    for direction, stalls_s in (("out", out_s), ("in", in_s)):
        for stall_s in stalls_s:
            player.stall(direction, stall_s)
            player.wait(stall_s + 0.3)
    player.hold()


def emergency(player: Player, **how: Any) -> None:
    """An emergency stop while the tool presses; reset, armed, pressed again."""
    player.begin()
    player.force(**how)
    player.until_force_N(15.0)
    pendant = player.machine.pendant
    pendant.emergency_stop()
    player.wait(1.0)
    pendant.release_emergency_stop()
    pendant.motor_power(on=True)
    pendant.error_reset()
    pendant.run()
    player.wait(1.5)
    player.arm()
    player.force(**how)
    player.wait(0.6)
    player.hold()


def _modes(short: str, file: str, **how: Any) -> dict[str, Run]:
    name = "-".join([*how.values(), "tcp" if file == TCP else "sim"])
    return {
        f"{name}-{mode}": Run(partial(press_then, mode=mode, **how), file, TILTED, mode == short)
        for mode in GIVEN_WAY_TO_N
    }


RUNS: dict[str, Run] = {
    **_modes("both", SIM, law="plain"),
    **_modes("position", SIM, law="adaptive"),
    **_modes("", TCP, law="plain", host="pc"),
    **_modes("", TCP, law="adaptive", host="pc"),
    **_modes("both", TCP, law="plain", host="controller"),
    **_modes("", TCP, law="adaptive", host="controller"),
    "guided": Run(guided),
    "path": Run(along, changes=TILTED),
    "moves-sim": Run(moved, changes={"sim.gap_m": 0.05}, is_short=True),
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
    "stalls-pc": Run(
        partial(stalled, out_s=(0.05, 0.12), in_s=(0.05, 0.12), host="pc"), TCP, is_short=True
    ),
    "stalls-controller": Run(
        partial(stalled, out_s=(0.05, 0.2), in_s=(0.05,), host="controller"), TCP
    ),
    "emergency-stop": Run(partial(emergency, host="controller"), TCP),
}
