"""Messages with markup in every text field, which a browser must show as text."""

import types
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from msgspec.structs import asdict, fields

from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.codec import Header
from forcemesh.messages import Message
from forcemesh.records import Record
from services.panel.watch import Snapshot

MARKUP = (
    "<b id=x>bold</b><iframe id=x srcdoc='<script>parent.ran=1</script>'></iframe>"
    "<img id=x src=x onerror='window.ran=1'><script>window.ran=1</script><object data=x></object>"
    " _em_ *em* **strong** `code` ``c`d`` | a | b | ~~del~~ [a](http://a.example) ![p](/etc/passwd)"
    " https://b.example www.c.example d@e.example # h &lt;i&gt; {} {0} \\ \"'=> $x$ {{y}} #ff0000 "
)
LONGEST = 500
PLAIN: dict[Any, Any] = {int: 1, bool: False, float: 0.0}


def hostile(name: str) -> str:
    """Return a text of full length that names its field at both ends."""
    inside = LONGEST - 2 * len(name) - 2
    return f"{name} {(MARKUP * 3)[:inside]} {name}"


def filled(model: type[Record], text: Any, where: str = "") -> Any:
    """Return a message with `text(name of the field)` in every text field at any depth."""
    values = {}
    hints = get_type_hints(model)
    for field in fields(model):
        value = _value(hints[field.name], text, f"{where or model.__name__}.{field.name}")
        if value is None and field.required:
            value = PLAIN.get(hints[field.name])
        if value is not None:
            values[field.name] = value
    return model(**values)


def _value(kind: Any, text: Any, where: str) -> Any:
    """Return a value for a type that can hold a text, None for another type."""
    if kind is str:
        return text(where)
    if isinstance(kind, type) and issubclass(kind, Record):
        return filled(kind, text, where) if _holds_text(kind) else None
    origin, inner = get_origin(kind), get_args(kind)
    if origin is tuple and inner[-1] is Ellipsis:
        one = _value(inner[0], text, where)
        return None if one is None else (one,)
    if origin in (Union, types.UnionType):
        found = [_value(each, text, where) for each in inner if each is not type(None)]
        return next((each for each in found if each is not None), None)
    return None


def _holds_text(kind: Any) -> bool:
    if get_origin(kind) is Literal:
        return False
    if isinstance(kind, type) and issubclass(kind, Record):
        return any(map(_holds_text, get_type_hints(kind).values()))
    return kind is str or any(_holds_text(each) for each in get_args(kind))


def reading(message: Message, fault: str = "") -> Reading[Any]:
    """Return a reading of a message, fresh unless it has a fault."""
    header = Header(seq=1, epoch=1, boot="b", stamp_ns=0)
    return Reading(message, header, 0.004, fault, silent=False)


def snapshot(text: Any) -> Snapshot:
    """Return the snapshot of a cell whose processes all publish such texts."""
    of = {topic.key: filled(topic.message, text) for topic in topics.TOPICS}
    status = of["arbiter/status"].replaced(state="FAULT", valid=True)
    wrench = of["wrench"].replaced(calibrated=False)
    return Snapshot(
        now_ns=1,
        hub_fault="",
        robot=reading(of["robot/state"]),
        wrench=reading(wrench),
        sensor=reading(of["sensor/wrench"]),
        target=reading(of["regulator/target"]),
        command=reading(of["robot/command"]),
        arbiter=reading(status),
        health={
            role: reading(of[topic.key], text(f"fault.{role}"))
            for role, topic in topics.HEALTH.items()
        },
    )


def texts_of(message: Any) -> list[str]:
    """Return every text in a message, a tuple or a trip."""
    if isinstance(message, str):
        return [message]
    if isinstance(message, Record):
        return [one for value in asdict(message).values() for one in texts_of(value)]
    if isinstance(message, tuple):
        return [one for value in message for one in texts_of(value)]
    return []
