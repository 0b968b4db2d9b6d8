"""Sections `panel` and `recorder` of a cell file: helpers, which no control loop needs."""

from pydantic import Field, field_validator, model_validator

from forcemesh.connection import ConfigSection
from forcemesh.patterns import TOKEN

SHORTEST_TOKEN = 16
SAME_TOKEN = "token and view_token are the same: a viewer could operate"  # noqa: S105 - a sentence


class PanelSection(ConfigSection):
    """The web panel (docs/panel.md).

    Without a token the panel listens on this machine only.
    """

    host: str = Field("127.0.0.1", min_length=1, max_length=200)
    port: int = Field(8080, ge=1024, le=65535)
    # Grants the rights of an operator. FORCEMESH_PANEL_TOKEN takes precedence.
    token: str = Field("", pattern=TOKEN, max_length=200)
    view_token: str = Field("", pattern=TOKEN, max_length=200)  # read-only

    @field_validator("token", "view_token")
    @classmethod
    def _cannot_be_guessed(cls, token: str) -> str:
        if why := guessable(token):
            raise ValueError(why)
        return token

    @model_validator(mode="after")
    def _two_tokens_are_two(self) -> "PanelSection":
        if self.token and self.token == self.view_token:
            raise ValueError(SAME_TOKEN)
        return self


def guessable(token: str) -> str:
    """Return why a token can be guessed, empty when it cannot or is empty."""
    if not token or len(token) >= SHORTEST_TOKEN:
        return ""
    return (
        f"a token of {len(token)} characters can be guessed: use at least {SHORTEST_TOKEN}, "
        "`openssl rand -hex 16` makes one"
    )


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
