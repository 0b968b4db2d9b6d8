"""Model of probe.yaml: fingerprint of a controller, written by `forcemesh probe`.

A result is a value with its unit, or null with the reason. The cell file takes the sections `robot`
and `gateway` (`robot.probe: probe.yaml`), the emulated controller the section `behaviour`.
"""

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from forcemesh.connection import ConfigSection

MOST_MOTIONS_AHEAD = 10

MotionsAhead = Annotated[int, Field(ge=1, le=MOST_MOTIONS_AHEAD)]


class ProbeResult(ConfigSection):
    """One measured value with its unit; null with the reason why it could not be measured."""

    value: float | bool | str | None = None
    unit: str = ""
    why: str = ""


class LineCheck(ConfigSection):
    """One line of forcemesh.as: the value that it must give, and the one that it gives."""

    expected: str
    found: str
    same: bool


class ProbedRobot(ConfigSection):
    """Values for the section `robot` of a cell file, which has the bounds; null: as it is there."""

    delay_s: float | None = None
    lag_s: float | None = None
    motions_ahead: MotionsAhead | None = None


class ProbedGateway(ConfigSection):
    """Values for the section `gateway` of a cell file, as for `robot`."""

    least_segment_s: float | None = None
    least_speed_m_s: float | None = None


class ProbeFile(ConfigSection):
    """Content of probe.yaml. No section is required."""

    probe: Literal[1] = 1  # version of the file
    measured_at: datetime | None = None
    controller: str = ""  # as a person named it: no line of AS gives the version
    address: str = ""
    stages: tuple[Literal["a", "b", "c"], ...] = ()
    robot: ProbedRobot = ProbedRobot()
    gateway: ProbedGateway = ProbedGateway()
    results: dict[str, ProbeResult] = Field({})
    lines: dict[str, LineCheck] = Field({})
    behaviour: dict[str, Any] = Field({})  # checked by the emulated controller

    @property
    def differing(self) -> Mapping[str, LineCheck]:
        """Lines of forcemesh.as that give another value than expected."""
        return {name: line for name, line in self.lines.items() if not line.same}

    def number(self, name: str) -> float | None:
        """Return a result as a number, None if it was not measured."""
        value = self.results[name].value if name in self.results else None
        return None if value is None or isinstance(value, str) else float(value)
