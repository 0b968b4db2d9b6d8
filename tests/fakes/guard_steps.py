"""One step of the regulator's monitors from a state that stays as it is."""

from copy import deepcopy
from dataclasses import replace

from forcemesh.messages import Trip
from services.regulator.guards import GuardSample, GuardSettings, GuardState, watch


def watched(
    before: GuardState, sample: GuardSample, settings: GuardSettings
) -> tuple[GuardState, Trip | None]:
    """Return the state after one sample, and the trip."""
    now = replace(before, swing=deepcopy(before.swing), yielding=deepcopy(before.yielding))
    return now, watch(now, sample, settings)
