"""The section `bus` of a cell file: where the hub is, and who may say what on the way there."""

from typing import Annotated

from pydantic import Field

from common.config.cell_terms import Section
from forcemesh.patterns import CELL_NAME, ENDPOINT


class TlsSection(Section):
    """Where the certificates of this cell's bus are."""

    folder: str = Field(min_length=1)  # `~` is the user's home


class UpstreamSection(Section):
    """The hub of another cell, through which this cell can be watched."""

    endpoint: str = Field(pattern=ENDPOINT)
    cell: str = Field(pattern=CELL_NAME)


class BusSection(Section):
    """Where the hub is, and what keeps strangers off the bus (docs/network.md)."""

    endpoint: str = Field("tcp/127.0.0.1:7447", pattern=ENDPOINT)
    tls: TlsSection | None = None  # without it ~/.config/forcemesh/pki/<cell>
    insecure: bool = False  # true: anybody in reach of this address may move the arm
    monitor_may_hold: bool = False  # a certificate that only reads may also stop the arm
    upstream: UpstreamSection | None = None
    below: tuple[Annotated[str, Field(pattern=CELL_NAME)], ...] = Field((), max_length=32)
