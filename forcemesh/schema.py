"""What every message of the bus looks like, as JSON Schema, made from the models themselves.

The hub answers a plain Zenoh query on `<cell>/describe` with it, docs/schema.json holds it, and
`forcemesh topics --schema` prints it: whoever speaks to a cell in another language needs no more.
"""

import json
from functools import cache
from typing import Any, Literal

from forcemesh.bus import Bus, CallSource
from forcemesh.codec import SCHEMA_VERSION, Header, Version
from forcemesh.errors import LostError
from forcemesh.messages import Record
from forcemesh.requests import Reply
from forcemesh.topics import DESCRIBE, REQUESTS, TOPICS, Request, Topic

Mode = Literal["serialization", "validation"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
NOTE = (
    "A payload is one flat MessagePack map. Keys are <cell>/<topic> to subscribe to and "
    "<cell>/<request> to query with a payload; the answer is a `reply`. The field `topic` holds "
    "that whole address; a request may leave it out. SI units, in the names. Fields that are not "
    "listed are ignored."
)


def describe() -> dict[str, Any]:
    """Return every topic and request with the JSON Schema of its payload."""
    return {
        "title": "What is said on the bus of a forcemesh cell",
        "description": NOTE,
        "encoding": "msgpack",
        "v": SCHEMA_VERSION,
        "topics": {topic.key: _topic(topic) for topic in TOPICS},
        "requests": {request.key: _request(request) for request in REQUESTS},
        "reply": schema_of(Version, Reply),
    }


def topic_schema(topic: Topic[Any]) -> dict[str, Any]:
    """Return the JSON Schema of a topic's payload: header and message side by side."""
    return schema_of(Header, topic.message)


def schema_of(
    head: type[Record], body: type[Record], mode: Mode = "serialization"
) -> dict[str, Any]:
    """Return the JSON Schema of a flat map of two records; it needs nothing outside itself.

    Args:
        head: What stands before.
        body: The message, request or reply.
        mode: `serialization`: what is said, with every field; `validation`: what may be asked.
    """
    parts = [_tidy(record.model_json_schema(mode=mode), mode) for record in (head, body)]
    schema = {
        "$schema": DIALECT,
        "title": body.__name__,
        "description": parts[1].get("description", ""),
        "type": "object",
        "properties": {k: v for part in parts for k, v in part.get("properties", {}).items()},
        "required": [name for part in parts for name in part.get("required", [])],
    }
    if defs := {k: v for part in parts for k, v in part.get("$defs", {}).items()}:
        schema["$defs"] = defs
    return schema


def _tidy(node: Any, mode: Mode) -> Any:
    """Leave out titles that only repeat a name; of what is said, every field is there."""
    if isinstance(node, list):
        return [_tidy(item, mode) for item in node]
    if not isinstance(node, dict):
        return node
    tidy = {
        key: {name: _tidy(part, mode) for name, part in value.items()}
        if key in ("properties", "$defs")
        else _tidy(value, mode)
        for key, value in node.items()
        if key != "title"
    }
    if mode == "serialization" and "properties" in tidy:
        tidy["required"] = list(tidy["properties"])
    return tidy


def _topic(topic: Topic[Any]) -> dict[str, Any]:
    return {
        "summary": topic.summary,
        "writer": topic.writer,
        "readers": list(topic.readers),
        "rate": topic.rate,
        "qos": topic.qos,
        "schema": topic_schema(topic),
    }


def _request(request: Request[Any]) -> dict[str, Any]:
    return {
        "summary": request.summary,
        "server": request.server,
        "schema": schema_of(Version, request.message, "validation"),
    }


@cache
def _answer() -> bytes:
    """Return the description as the hub tells it: it cannot change while a process runs."""
    return json.dumps(describe(), separators=(",", ":")).encode()


class Describer:
    """Answers whoever asks what is said on this bus; the payload of the question is ignored."""

    def __init__(self, bus: Bus) -> None:
        """Make the answer before there is anybody to wait for it."""
        self._answer = _answer()
        self._calls: CallSource = bus.transport.serve(f"{bus.cell}/{DESCRIBE}")

    def step(self) -> None:
        """Answer what has come in."""
        while (call := self._calls.take()) is not None:
            call.answer(self._answer)


def ask_for_description(bus: Bus, timeout_s: float = 2.0) -> dict[str, Any]:
    """Return what the hub of a cell says of its bus. Raise LostError when it does not answer."""
    data = bus.transport.ask(f"{bus.cell}/{DESCRIBE}", b"", timeout_s)
    if data is None:
        raise LostError(
            f"the hub did not answer {bus.cell}/{DESCRIBE} in {timeout_s:g} s", ("hub",)
        )
    found: dict[str, Any] = json.loads(data)
    return found
