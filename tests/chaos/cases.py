"""Test matrix: target process, kind of fault, and phase of the job."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

from forcemesh.topics import ROLES

CellName = Literal["sim", "tcp"]
FailureKind = Literal[
    "kill", "freeze-0.1", "freeze-1", "freeze-5", "terminate", "restart",
    "memory", "two-killed", "two-frozen-1", "killed-in-freeze-1",
]  # fmt: skip
Phase = Literal["approach", "press", "retreat"]

CELLS: tuple[CellName, ...] = get_args(CellName)
KINDS: tuple[FailureKind, ...] = get_args(FailureKind)
PHASES: tuple[Phase, ...] = get_args(Phase)
FREEZES = ("freeze", "two-frozen", "killed-in-freeze")
TWO: tuple[FailureKind, ...] = ("two-killed", "two-frozen-1", "killed-in-freeze-1")


@dataclass(frozen=True, slots=True)
class Case:
    """One injection. The seed determines its time within the phase."""

    cell: CellName
    role: str
    kind: FailureKind
    phase: Phase
    seed: int

    @property
    def name(self) -> str:
        """Name in the format of `--only`."""
        return f"{self.role}/{self.kind}/{self.phase}"

    @property
    def again(self) -> str:
        """The command that repeats this trial."""
        return f"python -m tests.chaos --cell {self.cell} --only {self.name} --seed {self.seed}"

    @property
    def frozen_s(self) -> float:
        """Duration of a freeze [s]; 0 if the process is ended."""
        name, _, seconds = self.kind.rpartition("-")
        return float(seconds) if name in FREEZES else 0.0

    @property
    def second_role(self) -> str:
        """Second target process of a double fault, otherwise empty.

        Never the robot's or the arm's: their behaviour is what is measured.
        """
        if self.kind not in TWO:
            return ""
        others = [role for role in ROLES if role not in (self.role, "robot", "sensor")]
        return random.Random(f"second {self.name}/{self.seed}").choice(others)

    @property
    def ends_who_reports(self) -> bool:
        """Whether robot and arbiter end together: no process is left that knows a cause."""
        return {self.role, self.second_role} == {"robot", "arbiter"}

    @property
    def hits_the_arm(self) -> bool:
        """Whether the target process contains the arm."""
        return self.role == ("robot" if self.cell == "sim" else "sensor")

    @property
    def hits_the_robot(self) -> bool:
        """Whether the target process is the one that checks the commands."""
        return self.role == "robot"

    def random(self) -> random.Random:
        """Return the random generator of the trial."""
        return random.Random(f"{self.cell}/{self.name}/{self.seed}")


def matrix(each: int, seed: int) -> list[Case]:
    """Return `each` cases per service and kind, cell by cell, with alternating cells and phases.

    In the simulated cell the sensor is part of the robot process, so the sensor is a target only
    over TCP: there it is the emulated controller with the arm.
    """
    cases = [case for role in ROLES for kind in KINDS for case in _rotate(role, kind, each, seed)]
    return sorted(cases, key=lambda case: CELLS.index(case.cell))


def one_of_each_kind(seed: int) -> list[Case]:
    """Return one case per cell and kind; roles and phases alternate, each role is a target."""
    cases = []
    for number, (cell, kind) in enumerate((cell, kind) for cell in CELLS for kind in KINDS):
        roles = [role for role in ROLES if (cell, role) != ("sim", "sensor")]
        role = roles[(number + seed) % len(roles)]
        cases.append(Case(cell, role, kind, PHASES[(number + seed) % len(PHASES)], seed))
    return cases


def _rotate(role: str, kind: FailureKind, each: int, seed: int) -> Iterator[Case]:
    turn = ROLES.index(role) + KINDS.index(kind) + seed
    for number in range(each):
        cell = "tcp" if role == "sensor" else CELLS[number % len(CELLS)]
        # Both cells cover all phases: three phases and two cells repeat after six cases.
        yield Case(cell, role, kind, PHASES[(turn + number) % len(PHASES)], seed + number)


def named(name: str) -> tuple[str, FailureKind, Phase]:
    """Return role, kind and phase of a name such as "regulator/freeze-1/press".

    Raises ValueError for an invalid name.
    """
    role, kind, phase = (*name.split("/"), "", "", "")[:3]
    if role in ROLES and kind in KINDS and phase in PHASES and name.count("/") == 2:
        return role, kind, phase
    choices = f"{'|'.join(ROLES)} / {'|'.join(KINDS)} / {'|'.join(PHASES)}"
    raise ValueError(f"{name}: must be {choices}")
