"""Compose secrets generator: certificate and key of each name, from the table of roles.

python -m tools.compose_secrets writes the last section of docker-compose.yml, and for each secret
the file that stands for it until `make pki`.
"""

from forcemesh.identity import AUTHORITY, PAGE, PANEL
from forcemesh.topics import HELPERS, ROLES
from tools.tree import ROOT

FILE = ROOT / "docker-compose.yml"
WITHOUT = ROOT / "tools" / "no-certificates"
TEXT = "There is no certificate: `make pki` makes them, and .env says where they are.\n"
BEGIN = "\nsecrets:\n"


def secrets() -> list[str]:
    """Return the names of all secrets of containers."""
    pairs = [(f"{name}.pem", f"{name}.key") for name in (*ROLES, *HELPERS, PANEL, PAGE)]
    return [f"{AUTHORITY}.pem", *(name for pair in pairs for name in pair)]


def with_secrets(text: str) -> str:
    """Return the compose file with the current section, its last one."""
    folder = "${FORCEMESH_PKI:-./tools/no-certificates}"
    lines = "".join(f'  {name}: {{file: "{folder}/{name}"}}\n' for name in secrets())
    return text.partition(BEGIN)[0] + BEGIN + lines


def main() -> None:
    """Write both."""
    FILE.write_text(with_secrets(FILE.read_text(encoding="utf-8")), encoding="utf-8")
    for name in secrets():
        (WITHOUT / name).write_text(TEXT, encoding="utf-8")


if __name__ == "__main__":
    main()
