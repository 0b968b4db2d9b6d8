"""Section `recorder` of a cell file: folder of the recordings, and limits on their size."""

from pydantic import Field

from forcemesh.connection import ConfigSection


class RecorderSection(ConfigSection):
    """Recorder of every topic (docs/recordings.md), with bounded disk and memory use."""

    # Relative to the project. The environment variable FORCEMESH_RECORDINGS takes precedence.
    folder: str = Field("recordings", min_length=1, max_length=500)
    keep_min: float = Field(2.0, ge=0.0, le=60.0)  # time span of the ring buffer, within memory_MB
    memory_MB: float = Field(64.0, ge=1.0, le=4000.0)  # largest size of the ring buffer
    after_fault_s: float = Field(10.0, ge=0.0, le=600.0)  # recording time after a fault
    faults_kept: int = Field(20, ge=1, le=10_000)  # recordings of faults; the oldest is deleted
    file_MB: float = Field(500.0, ge=1.0, le=100_000.0)  # size at which the next file begins
    file_min: float = Field(60.0, ge=0.1, le=1440.0)  # duration at which the next file begins
    least_free_GB: float = Field(1.0, ge=0.0, le=10_000.0)  # free disk space to keep
