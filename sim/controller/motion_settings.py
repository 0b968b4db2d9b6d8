"""Motion settings SPEED, ACCURACY, ACCEL, DECEL: for all motions, or for the next one only."""

from dataclasses import replace
from typing import Any

import pinocchio as pin

from sim.controller.motion_requests import MotionParameters, ProgramSpeed


class MotionSettings:
    """Settings for the next motion instruction."""

    def __init__(self) -> None:
        """Start with the defaults of a program: 100 %, 1 mm."""
        self._always: dict[str, Any] = {}
        self._next: dict[str, Any] = {}

    def reset(self) -> None:
        """Restore the defaults at the start of a program."""
        self._always, self._next = {}, {}

    def change(self, field: str, value: Any, *, always: bool) -> None:
        """Set one field of `MotionParameters`, permanently or for the next motion only."""
        self._next.pop(field, None)
        (self._always if always else self._next)[field] = value

    def take(self, T_flange_tcp: pin.SE3, speed: ProgramSpeed | None = None) -> MotionParameters:
        """Return the parameters of the motion to be queued, optionally with its own speed."""
        manner = MotionParameters(**{**self._always, **self._next})
        self._next = {}
        return replace(manner, T_flange_tcp=T_flange_tcp, speed=speed or manner.speed)
