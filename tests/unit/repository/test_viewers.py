"""Layouts for other viewers show topics and fields that exist."""

import json
from pathlib import Path
from typing import Any

from forcemesh.topics import TOPICS
from services.recorder.layout import schema_of

LAYOUT = Path(__file__).parents[3] / "examples" / "viewers" / "foxglove.json"
CHANNELS = {topic.key: schema_of(topic) for topic in TOPICS}


def paths(node: Any) -> list[str]:
    """Return every message path of a layout: a topic, and fields behind it."""
    if isinstance(node, list):
        return [path for each in node for path in paths(each)]
    if not isinstance(node, dict):
        return []
    own = [node[name] for name in ("value", "topicPath") if name in node]
    return own + [path for each in node.values() for path in paths(each)]


def test_the_paths_of_foxglove_are_in_every_recording() -> None:
    """Each path leads to a topic and to a field of its schema; each panel is on the page."""
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    found = paths(layout["configById"])
    assert len(found) > 10
    for path in found:
        topic, *fields = path.split(".")
        schema = CHANNELS[topic]
        for field in fields:
            schema = schema["properties"][field]
    shown = json.dumps(layout["layout"])
    assert all(f'"{panel}"' in shown for panel in layout["configById"])
