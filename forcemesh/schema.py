"""JSON Schema of every message of the bus, generated from the models.

The hub returns it to a plain Zenoh query on `<cell>/describe`, and `forcemesh topics --schema`
prints it without a cell. A client in another language needs nothing else.
"""

import json
from functools import cache
from inspect import cleandoc
from typing import Any, Literal

import msgspec

from forcemesh.bus import Bus, FixedReply, query_hub
from forcemesh.codec import SCHEMA_VERSION, Envelope, Header, Version
from forcemesh.messages import LARGEST
from forcemesh.patterns import NO_BREAK
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.topics import DESCRIBE, REQUESTS, TOPICS, Topic

Mode = Literal["serialization", "validation"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
NOTE = (
    "A payload is one flat MessagePack map. Keys are <cell>/<topic> to subscribe to and "
    "<cell>/<request> to query with a payload; the response is a `reply`. The field `topic` holds "
    "the full address; a request may omit it, and the other fields of its envelope. SI "
    "units, given in the names. Fields that are not listed are ignored."
)


def describe() -> dict[str, Any]:
    """Return every topic and request with the JSON Schema of its payload."""
    return {
        "title": "Topics and requests on the bus of a forcemesh cell",
        "description": NOTE,
        "encoding": "msgpack",
        "v": SCHEMA_VERSION,
        "topics": {
            topic.key: {
                "summary": topic.summary,
                "writer": topic.writer,
                "readers": list(topic.readers),
                "rate": topic.rate,
                "qos": topic.qos,
                "schema": topic_schema(topic),
            }
            for topic in TOPICS
        },
        "requests": {
            request.key: {
                "summary": request.summary,
                "server": request.server,
                "schema": schema_of(Envelope, request.message, "validation"),
            }
            for request in REQUESTS
        },
        "reply": schema_of(Version, Reply),
    }


def topic_schema(topic: Topic[Any]) -> dict[str, Any]:
    """Return the JSON Schema of a topic's payload: header and message side by side."""
    return schema_of(Header, topic.message)


def schema_of(
    head: type[Record], body: type[Record], mode: Mode = "serialization"
) -> dict[str, Any]:
    """Return the self-contained JSON Schema of a flat map of two records.

    Args:
        head: The header record.
        body: The message, request or reply.
        mode: `serialization`: published, with every field; `validation`: accepted in a request.
    """
    _, parts = msgspec.json.schema_components((head, body), ref_template="#/$defs/{name}")
    defs = {name: _cleaned(part, mode) for name, part in parts.items()}
    first, second = defs.pop(head.__name__), defs.pop(body.__name__)
    schema = {
        "$schema": DIALECT,
        "title": body.__name__,
        "description": second["description"],
        "type": "object",
        "properties": first["properties"] | second["properties"],
        "required": first["required"] + second["required"],
    }
    return schema | ({"$defs": defs} if defs else {})


def _cleaned(node: Any, mode: Mode) -> Any:
    """Drop what says nothing; in serialization mode mark every field as required.

    That is a title that only repeats a name, and the bounds of every finite number. `$` is the end
    in a JSON Schema.
    """
    if isinstance(node, list | tuple):
        return [_cleaned(item, mode) for item in node]
    if not isinstance(node, dict):
        return node
    cleaned = {
        key: {name: _cleaned(part, mode) for name, part in value.items()}
        if key == "properties"
        else cleandoc(value).removesuffix(NO_BREAK)
        if key in ("description", "pattern")
        else _cleaned(value, mode)
        for key, value in node.items()
        if key != "title" and value not in (-LARGEST, LARGEST)
    }
    if mode == "serialization" and "properties" in cleaned:
        cleaned["required"] = list(cleaned["properties"])
    return cleaned


@cache
def _answer() -> bytes:
    """Return the encoded description: it cannot change while a process runs."""
    return json.dumps(describe(), separators=(",", ":")).encode()


def describer(bus: Bus) -> FixedReply:
    """Return the server of the schema query of a bus."""
    return FixedReply(bus.transport, f"{bus.cell}/{DESCRIBE}", _answer())


def ask_for_description(bus: Bus, timeout_s: float = 2.0) -> dict[str, Any]:
    """Return the description from the hub of a cell. Raise LostError when it does not answer."""
    answer = query_hub(bus.transport, f"{bus.cell}/{DESCRIBE}", timeout_s)
    found: dict[str, Any] = json.loads(answer)
    return found
