"""Registry of the control laws: a new law is one file, and one row here.

    step(state, sample, settings) -> (state, motion)

`state` is the law's own; a step may advance it in place, and the one that it returns is the next.
`advance` runs each row the same: the law, the compliant axes, and the limits of both.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Rows, Vector
from control import adaptive
from control.adaptive import AdaptiveSettings, ContactStiffness
from control.compliance import ComplianceSettings, ComplianceState, comply
from control.law import LawInput, LawMotion, LawSettings, next_motion
from control.measured_range import restriction, softest_N_m
from control.shape import MotionLimits, shape
from forcemesh.errors import ConfigError
from forcemesh.messages import Gains, Vec3


@dataclass(frozen=True, slots=True)
class Law:
    """Control law: constants of a cell, initial state, step, and properties."""

    settings: Callable[[CellConfig], Any]
    # Of a tool at rest: commanded pose, measured pose, stiffness identified here before, settings.
    begin: Callable[[pin.SE3, pin.SE3, Vector | None, Any], Any]
    step: Callable[[Any, LawInput, Any], tuple[Any, LawMotion]]
    predicts: bool = False  # from its own commands: it takes other motion for that of the contact
    # Whether the law may run in a cell; otherwise the plain law does. The remark is for the reply.
    covers: Callable[[CellConfig], bool] = lambda _: True
    remark: Callable[[CellConfig], str] = lambda _: ""
    # Stiffness of the present contact, kept for a start in place.
    identified: Callable[[Any, Any], ContactStiffness | None] = lambda _, __: None
    # Integral gains of the host controller, base axes; None: those requested.
    controller_gain: Callable[[Any, Gains, Rows, Any], Vec3 | None] = lambda *_: None


LAWS: dict[str, Law] = {
    "plain": Law(
        LawSettings.of,
        begin=lambda *_: None,
        step=lambda _, sample, settings: (None, next_motion(sample, settings)),
    ),
    "adaptive": Law(
        AdaptiveSettings.of,
        adaptive.begin,
        adaptive.step,
        predicts=True,
        covers=lambda cell: softest_N_m(cell) is not None,
        remark=restriction,
        identified=adaptive.identified,
        controller_gain=adaptive.controller_gain,
    ),
}


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """A law with its constants in one cell, those of compliance, and the limits of motion."""

    law: Law
    of_law: Any
    compliance: ComplianceSettings
    limits: MotionLimits

    @classmethod
    def of(cls, cell: CellConfig, law: Law) -> "ControlSettings":
        """Return those of a cell."""
        limits = MotionLimits.of(cell, predicts=law.predicts)
        return cls(law, law.settings(cell), ComplianceSettings.of(cell), limits)


def advance(
    state: Any, compliance: ComplianceState, sample: LawInput, settings: ControlSettings
) -> tuple[Any, LawMotion]:
    """Advance law and compliant axes by one sample; return the law's state and the command."""
    state, motion = settings.law.step(state, sample, settings.of_law)
    complied = comply(compliance, sample, settings.compliance)
    shape(motion, complied, sample, compliance, limits=settings.limits)
    return state, motion


def refuse_unknown_law(cell: CellConfig, source: str) -> None:
    """Raise ConfigError with the source unless the cell's law exists."""
    if cell.force.law not in LAWS:
        mistake = f"force.law: must be {' or '.join(LAWS)}, found {cell.force.law!r}"
        raise ConfigError(source, [mistake])
