"""How a calibration ends early: each with one clear sentence for the person."""

from common.errors import ForcemeshError


class CalibrationError(ForcemeshError):
    """The calibration cannot go on; what was recorded is kept."""


class StoppedError(CalibrationError):
    """The arbiter has stopped the arm; the text is its own."""


class PoseRefusedError(CalibrationError):
    """One pose cannot be gone to; the others may."""
