"""Who goes before whom, as one table. Pure.

Rule: a higher rank takes the arm from a lower one; the same or a lower rank is refused as busy.
"""

from forcemesh.messages import Commander

# fmt: off
RANKS: dict[Commander, int] = {
    "none":      0,  # nobody
    "regulator": 1,  # force feedback, whoever started it
    "program":   2,  # a script
    "operator":  3,  # a person
}
# fmt: on


def goes_before(asker: Commander, holder: Commander) -> bool:
    """Tell whether somebody may take the arm from who has it."""
    return RANKS[asker] > RANKS[holder]
