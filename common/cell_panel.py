"""The section `panel` of a cell file: where the cockpit is served, and who may open it."""

from pydantic import Field

from common.cell_terms import Section

SHORTEST_TOKEN = 16


class PanelSection(Section):
    """The cockpit in a browser (docs/panel.md).

    Others than this machine reach it only by a token: the panel refuses to listen wider without.
    """

    host: str = Field("127.0.0.1", min_length=1, max_length=200)
    port: int = Field(8080, ge=1024, le=65535)
    # Whoever has it may do what an operator may. FORCEMESH_PANEL_TOKEN goes before it.
    token: str = Field("", pattern=r"^[A-Za-z0-9_-]*$", max_length=200)
    view_token: str = Field("", pattern=r"^[A-Za-z0-9_-]*$", max_length=200)  # may look, no more
