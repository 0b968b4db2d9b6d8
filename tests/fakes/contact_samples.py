"""Samples of wrench and pose for the contact events: a tool that points down."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from forcemesh.messages import ContactEvent
from services.regulator.contact_events import ContactInput, ContactTracker
from services.regulator.law import Contact
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import T_FLANGE_TCP

PERIOD_NS = 4_000_000
DOWN = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Phase:
    """A time of constant force and speed."""

    seconds: float
    up_N: float = 0.0  # force of the plane on the tool
    speed_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    law: Contact | None = None


class ContactRun:
    """A tracker and the samples that it has taken."""

    def __init__(self, noise_N: float = 0.0, noise_m: float = 0.0, seed: int = 0) -> None:
        """Start in the pose of the arm at rest."""
        self.tracker = ContactTracker(CELL)
        self.noise_N, self.noise_m = noise_N, noise_m
        self.random = np.random.default_rng(seed)
        self.T = T_START * T_FLANGE_TCP
        self.at_ns = 1_000_000_000
        self.sizes: list[tuple[int, float]] = []  # stamp and size of each force
        self.events: list[ContactEvent] = []  # the first message of each change
        self.newest: dict[int, ContactEvent] = {}  # by number

    def play(self, phases: Iterable[Phase]) -> list[str]:
        """Take the samples of phases; return the states so far."""
        for phase in phases:
            for _ in range(round(phase.seconds * 1e9 / PERIOD_NS)):
                self.step(phase)
        return [event.state for event in self.events]

    def step(self, phase: Phase) -> None:
        """Take one sample."""
        self.at_ns += PERIOD_NS
        shift = np.array(phase.speed_m_s) * PERIOD_NS / 1e9
        self.T = pin.SE3(self.T.rotation, self.T.translation + shift)
        place = self.T.translation + self.random.uniform(-1, 1, 3) * self.noise_m
        x, y, z = self.random.normal((0.0, 0.0, phase.up_N), self.noise_N)
        self.sizes.append((self.at_ns, float(np.hypot(np.hypot(x, y), z))))
        self.tracker.observe(
            ContactInput(
                at_ns=self.at_ns,
                posed_ns=self.at_ns,
                force_N=(float(x), float(y), float(z)),
                torque_Nm=(0.0, 0.0, 0.0),
                T_base_tcp=pin.SE3(self.T.rotation, place),
                law=phase.law,
                press_axis=DOWN if phase.law else (0.0, 0.0, 0.0),
            )
        )
        event = self.tracker.event
        if event.number and event.number not in self.newest:
            self.events.append(event)
        self.newest[event.number] = event
