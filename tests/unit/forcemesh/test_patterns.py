"""The form of a name is described in words: a regular expression is not a sentence."""

from collections.abc import Iterator
from typing import Any

import pytest

from common.config.cell import CellConfig
from common.config.load import cell_from_tree, load_cell
from forcemesh.errors import ConfigError
from forcemesh.patterns import WORDS

PLACES = {
    "cell": "Not A Name",
    "bus.endpoint": "127.0.0.1:7447",
    "bus.below": ["9"],
    "panel.token": "with a blank in it",
}


def patterns(schema: Any) -> Iterator[str]:
    """Yield every pattern of a JSON Schema."""
    if isinstance(schema, dict):
        if isinstance(found := schema.get("pattern"), str):
            yield found
        for part in schema.values():
            yield from patterns(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from patterns(part)


def test_every_pattern_of_a_cell_file_has_its_words() -> None:
    """No pattern is left out: one without words could only be shown as it is."""
    assert set(patterns(CellConfig.model_json_schema())) == set(WORDS)


@pytest.mark.parametrize(("place", "found"), PLACES.items())
def test_a_wrong_name_is_reported_in_words(place: str, found: object) -> None:
    """With its place and what was found, and no regular expression."""
    tree: dict[str, Any] = load_cell("cells/demo.yaml").model_dump(mode="json")
    tree["panel"] = tree["panel"] or {}
    *sections, field = place.split(".")
    section = tree
    for name in sections:
        section = section[name]
    section[field] = found
    with pytest.raises(ConfigError) as caught:
        cell_from_tree(tree, "cell.yaml")
    text = str(caught.value)
    assert text.startswith(f"cell.yaml: {place}")
    assert any(words in text for words in WORDS.values())
    assert not set(text) & set("^$\\{}")
