"""Which forcemesh this is."""

from importlib.metadata import PackageNotFoundError, version


def forcemesh_version() -> str:
    """Return the installed version, or say that it runs from a bare checkout."""
    try:
        return version("forcemesh")
    except PackageNotFoundError:
        return "checkout"
