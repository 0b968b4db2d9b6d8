"""Errors of a calibration, each with one message for the user."""

from forcemesh.errors import ForcemeshError, RefusedError


class CalibrationError(ForcemeshError):
    """The calibration cannot continue; the recorded readings are kept."""


class NotBegunError(CalibrationError, RefusedError):
    """Refused before any motion: another commander moves the arm, or the tool is loaded."""

    def __init__(self, code: str, text: str) -> None:
        """Keep the machine-readable code."""
        RefusedError.__init__(self, code, text)


class InContactError(CalibrationError):
    """The tool was in contact at the start; it was lifted, and the arm is not armed."""


class PoseRefusedError(CalibrationError):
    """One pose was refused; others may be possible."""
