"""How a calibration ends early: each with one clear sentence for the person."""

from forcemesh.errors import ForcemeshError, RefusedError


class CalibrationError(ForcemeshError):
    """The calibration cannot go on; what was recorded is kept."""


class StoppedError(CalibrationError):
    """The arbiter has stopped the arm; the text is its own."""


class NotBegunError(CalibrationError, RefusedError):
    """It was refused before anything moved: somebody else has the arm, or the tool is loaded."""

    def __init__(self, code: str, text: str) -> None:
        """Keep the code for programs."""
        RefusedError.__init__(self, code, text)


class InContactError(CalibrationError):
    """The tool was in contact where the calibration began; it was lifted, and is not armed."""


class PoseRefusedError(CalibrationError):
    """One pose cannot be gone to; the others may."""
