"""Writes docs/schema.json from the models of the bus: `python -m tools.schema_page`."""

import json
from pathlib import Path

from forcemesh.schema import describe

PAGE = Path(__file__).resolve().parent.parent / "docs" / "schema.json"


def page() -> str:
    """Return the file."""
    return json.dumps(describe(), indent=1) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
