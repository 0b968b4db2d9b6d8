"""Connection to a cell: its name and its hub, as the sections `cell` and `bus` of a cell file."""

from pathlib import Path
from typing import Annotated, Any, Protocol

from pydantic import BaseModel, ConfigDict, Field

from forcemesh.patterns import CELL_NAME, ENDPOINT
from forcemesh.yaml_file import read_yaml, validated


class ConfigSection(BaseModel):
    """Base of every section of a cell file: unknown keys and non-finite numbers are mistakes."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class TlsSection(ConfigSection):
    """Location of the certificates of this cell's bus."""

    folder: str = Field(min_length=1)  # `~` is the user's home


class UpstreamSection(ConfigSection):
    """The hub of another cell, through which this cell can be monitored."""

    endpoint: str = Field(pattern=ENDPOINT)
    cell: str = Field(pattern=CELL_NAME)


class BusSection(ConfigSection):
    """Address of the hub, and protection against unauthorised clients (docs/network.md)."""

    endpoint: str = Field("tcp/127.0.0.1:7447", pattern=ENDPOINT)
    tls: TlsSection | None = None  # without it ~/.config/forcemesh/pki/<cell>
    insecure: bool = False  # true: any client that reaches this address may move the arm
    monitor_may_hold: bool = False  # a certificate that only reads may also stop the arm
    upstream: UpstreamSection | None = None
    below: tuple[Annotated[str, Field(pattern=CELL_NAME)], ...] = Field((), max_length=32)


class Reachable(Protocol):
    """Anything that says which cell it is and where its hub is: a cell file, or a `Connection`."""

    @property
    def cell(self) -> str:
        """Name of the cell: the first part of every key."""

    @property
    def bus(self) -> BusSection:
        """Where the hub is, and how to reach it."""


class Connection(BaseModel):
    """Name and hub of a cell. Other sections of a cell file are not read."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    cell: str = Field(pattern=CELL_NAME)
    bus: BusSection = BusSection()


def read_connection(path: Path | str) -> Connection:
    """Read the sections `cell` and `bus` of a cell file.

    Raises:
        ConfigError: The file cannot be read, or one of the two sections holds a mistake.
    """
    return connection(read_yaml(Path(path), str(path)), str(path))


def connection(tree: Any, source: str) -> Connection:
    """Validate name and hub of a cell. Raise ConfigError, which lists every mistake."""
    return validated(Connection, tree, source)
