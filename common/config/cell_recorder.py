"""The section `recorder` of a cell file: where recordings go, and how much may be kept."""

from pydantic import Field

from forcemesh.connection import Section


class RecorderSection(Section):
    """What records every topic (docs/recordings.md). It never fills the disk or the memory."""

    # Relative to the project. The environment's FORCEMESH_RECORDINGS goes first.
    folder: str = Field("recordings", min_length=1, max_length=500)
    keep_min: float = Field(2.0, ge=0.0, le=60.0)  # so far back memory reaches, if it has the room
    memory_MB: float = Field(64.0, ge=1.0, le=4000.0)  # and no more than this
    after_fault_s: float = Field(10.0, ge=0.0, le=600.0)  # so long a fault is still recorded
    faults_kept: int = Field(20, ge=1, le=10_000)  # files of one fault: the oldest goes
    file_MB: float = Field(500.0, ge=1.0, le=100_000.0)  # then the next file begins
    file_min: float = Field(60.0, ge=0.1, le=1440.0)  # the same
    least_free_GB: float = Field(1.0, ge=0.0, le=10_000.0)  # with less on the disk it stops
