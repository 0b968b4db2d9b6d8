"""Which forcemesh this is."""

from functools import cache
from importlib.metadata import PackageNotFoundError, version


@cache
def forcemesh_version() -> str:
    """Return the installed version, or say that it runs from a bare checkout."""
    try:
        return version("forcemesh")
    except PackageNotFoundError:
        return "checkout"
