"""What is tried: who is hit, how, and in which phase of the job."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

CellName = Literal["sim", "tcp"]
Kind = Literal[
    "kill", "freeze-0.1", "freeze-1", "freeze-5", "terminate", "restart",
    "memory", "two-killed", "two-frozen-1", "killed-in-freeze-1",
]  # fmt: skip
Phase = Literal["approach", "press", "retreat"]

CELLS: tuple[CellName, ...] = get_args(CellName)
KINDS: tuple[Kind, ...] = get_args(Kind)
PHASES: tuple[Phase, ...] = get_args(Phase)
FREEZES = ("freeze", "two-frozen", "killed-in-freeze")
TWO: tuple[Kind, ...] = ("two-killed", "two-frozen-1", "killed-in-freeze-1")
ROLES = ("hub", "robot", "sensor", "wrench", "regulator", "arbiter")


@dataclass(frozen=True, slots=True)
class Case:
    """One injection. The seed decides at which moment of the phase it comes."""

    cell: CellName
    role: str
    kind: Kind
    phase: Phase
    seed: int

    @property
    def name(self) -> str:
        """As `--only` takes it."""
        return f"{self.role}/{self.kind}/{self.phase}"

    @property
    def again(self) -> str:
        """The command that repeats this very trial."""
        return f"python -m tests.chaos --cell {self.cell} --only {self.name} --seed {self.seed}"

    @property
    def frozen_s(self) -> float:
        """How long the process is stopped before it goes on [s]; 0 when it ends."""
        name, _, seconds = self.kind.rpartition("-")
        return float(seconds) if name in FREEZES else 0.0

    @property
    def second_role(self) -> str:
        """The process that is hit beside it, empty where one alone is hit.

        Never the robot's or the arm's: what they do is what is measured.
        """
        if self.kind not in TWO:
            return ""
        others = [role for role in ROLES if role not in (self.role, "robot", "sensor")]
        return random.Random(f"second {self.name}/{self.seed}").choice(others)

    @property
    def hits_the_arm(self) -> bool:
        """Whether the process that is hit is the one in which the arm lives."""
        return self.role == ("robot" if self.cell == "sim" else "sensor")

    @property
    def hits_the_robot(self) -> bool:
        """Whether the process that is hit is the one that judges the commands."""
        return self.role == "robot"

    def random(self) -> random.Random:
        """Return the trial's own numbers."""
        return random.Random(f"{self.cell}/{self.name}/{self.seed}")


def matrix(each: int, seed: int) -> list[Case]:
    """Return `each` cases per service and kind, cell by cell, cells and phases in turn.

    In the simulated cell the sensor is the robot's process, so the sensor is hit over TCP only:
    there it is the emulated controller with the arm.
    """
    cases = [case for role in ROLES for kind in KINDS for case in _rotate(role, kind, each, seed)]
    return sorted(cases, key=lambda case: CELLS.index(case.cell))


def _rotate(role: str, kind: Kind, each: int, seed: int) -> Iterator[Case]:
    turn = ROLES.index(role) + KINDS.index(kind) + seed
    for number in range(each):
        cell = "tcp" if role == "sensor" else CELLS[number % len(CELLS)]
        # Both cells see all phases: three of them and two cells come together every six times.
        yield Case(cell, role, kind, PHASES[(turn + number) % len(PHASES)], seed + number)


def named(name: str) -> tuple[str, Kind, Phase]:
    """Return role, kind and phase of a name as "regulator/freeze-1/press".

    Raises ValueError for a name that is none.
    """
    role, kind, phase = (*name.split("/"), "", "", "")[:3]
    if role in ROLES and kind in KINDS and phase in PHASES and name.count("/") == 2:
        return role, kind, phase
    choices = f"{'|'.join(ROLES)} / {'|'.join(KINDS)} / {'|'.join(PHASES)}"
    raise ValueError(f"{name}: must be {choices}")
