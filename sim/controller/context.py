"""What a step is compiled with: how to evaluate expressions, and the machine it acts on."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.controller.evaluate import Evaluate
    from sim.controller.machine import Machine


@dataclass(frozen=True, slots=True)
class Context:
    """Passed to every compiler of an instruction."""

    evaluate: "Evaluate"
    machine: "Machine"
