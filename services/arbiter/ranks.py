"""Priorities of the commanders, as one table. Pure.

Rule: a higher rank takes the arm from a lower one; the same or a lower rank is refused as busy.
"""

from forcemesh.messages import Commander

# fmt: off
RANKS: dict[Commander, int] = {
    "none":      0,  # no commander
    "regulator": 1,  # force feedback, started by any client
    "program":   2,  # a script
    "operator":  3,  # a person
}
# fmt: on


def outranks(asker: Commander, holder: Commander) -> bool:
    """Return whether a commander may take the arm from its holder."""
    return RANKS[asker] > RANKS[holder]
