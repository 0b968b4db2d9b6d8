"""Fault-injection switches of the simulated sensor, set at run time by HTTP. Pure."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from forcemesh.errors import first_mistake

EVENT = "restart"  # an event, not a state
Share = Annotated[float, Field(ge=0.0, le=1.0)]  # of the records
Word = Annotated[int, BeforeValidator(lambda word: int(str(word), 0)), Field(ge=0, lt=2**32)]


class FaultSwitches(BaseModel):
    """Fault switches, all off by default."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    loss: Share = 0.0
    duplicate: Share = 0.0
    reorder: Share = 0.0
    stall: bool = False  # sample and sequence number stay constant
    freeze: bool = False  # the reading stays constant, the sequence number increases
    saturate: bool = False
    mute: bool = False  # nothing is sent
    garbage: bool = False  # malformed records are sent
    steal: bool = False  # a second client requests the stream repeatedly
    status: Word = 0

    def changed(self, words: Mapping[str, str]) -> "FaultSwitches":
        """Return a copy with some switches set by name.

        Raises:
            ValueError: A name or a value is invalid; the text lists the valid names.
        """
        if unknown := [name for name in words if name not in FaultSwitches.model_fields]:
            names = ", ".join((*FaultSwitches.model_fields, EVENT))
            raise ValueError(f"no switch {unknown[0]!r}: use one of {names}")
        try:
            changes = {name: word.strip() for name, word in words.items()}
            return FaultSwitches.model_validate(self.model_dump() | changes)
        except ValidationError as error:
            raise ValueError(first_mistake(error).text) from None
