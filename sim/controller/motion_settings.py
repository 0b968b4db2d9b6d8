"""SPEED, ACCURACY, ACCEL and DECEL of the robot program: for all motions, or the next one only."""

from dataclasses import replace
from typing import Any

import pinocchio as pin

from sim.controller.motion_requests import Manner, Speed


class MotionSettings:
    """What the next motion instruction will be done with."""

    def __init__(self) -> None:
        """Begin as a program does: 100 %, 1 mm."""
        self._always: dict[str, Any] = {}
        self._next: dict[str, Any] = {}

    def reset(self) -> None:
        """A program begins."""
        self._always, self._next = {}, {}

    def change(self, field: str, value: Any, *, always: bool) -> None:
        """Set one field of `Manner`, for good or for the next motion only."""
        self._next.pop(field, None)
        (self._always if always else self._next)[field] = value

    def take(self, T_flange_tcp: pin.SE3, speed: Speed | None = None) -> Manner:
        """Return the manner of the motion that is handed over now, with a speed of its own."""
        manner = Manner(**{**self._always, **self._next})
        self._next = {}
        return replace(manner, T_flange_tcp=T_flange_tcp, speed=speed or manner.speed)
