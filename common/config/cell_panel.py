"""Section `panel` of a cell file: address of the web panel, and its access tokens."""

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
