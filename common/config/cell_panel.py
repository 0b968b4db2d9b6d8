"""The section `panel` of a cell file: where the cockpit is served, and who may open it."""

from pydantic import Field, field_validator, model_validator

from forcemesh.connection import Section
from forcemesh.patterns import TOKEN

SHORTEST_TOKEN = 16
SAME_TOKEN = "token and view_token are the same: who looks could operate"  # noqa: S105 - a sentence


class PanelSection(Section):
    """The cockpit in a browser (docs/panel.md).

    Others than this machine reach it only by a token: the panel refuses to listen wider without.
    """

    host: str = Field("127.0.0.1", min_length=1, max_length=200)
    port: int = Field(8080, ge=1024, le=65535)
    # Whoever has it may do what an operator may. FORCEMESH_PANEL_TOKEN goes before it.
    token: str = Field("", pattern=TOKEN, max_length=200)
    view_token: str = Field("", pattern=TOKEN, max_length=200)  # may look, no more

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
    """Return why a token can be guessed, empty when it cannot, or when there is none."""
    if not token or len(token) >= SHORTEST_TOKEN:
        return ""
    return (
        f"a token of {len(token)} characters can be guessed: take at least {SHORTEST_TOKEN}, "
        "`openssl rand -hex 16` makes one"
    )
