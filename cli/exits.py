"""Exit codes: one table from exceptions to codes, for every verb."""

from forcemesh.errors import (
    BusError,
    ConfigError,
    DataError,
    ForcemeshError,
    RefusedError,
    SetupError,
)

OK, NOT_WELL, USAGE, REFUSED, NO_ANSWER, INTERRUPTED = 0, 1, 2, 3, 4, 130
EXITS = {
    OK: "success",
    NOT_WELL: "failure: a process died, a role is silent, a move did not reach its target",
    USAGE: "wrong usage, or an invalid file or certificate",
    REFUSED: "refused, with the reason",
    NO_ANSWER: "no reply: the cell is not up, or an expected message did not arrive",
    INTERRUPTED: "interrupted; a hold was requested for a moving arm",
}
TABLE: tuple[tuple[type[BaseException], int], ...] = (  # the first row that fits counts
    (ConfigError, USAGE),
    (DataError, USAGE),
    (SetupError, USAGE),
    (RefusedError, REFUSED),
    (BusError, NO_ANSWER),
    (ForcemeshError, NOT_WELL),
    (OSError, USAGE),
    (KeyboardInterrupt, INTERRUPTED),
)


def exit_code_of(error: BaseException) -> int:
    """Return the exit code of a verb that ends with an exception."""
    return next((code for kind, code in TABLE if isinstance(error, kind)), NOT_WELL)
