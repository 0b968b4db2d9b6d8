"""Layout of a message in a recording: a JSON object that plots, and its JSON Schema. Pure.

Vectors become objects with x, y, z (and w), so that a viewer offers each component by name. None is
omitted, because viewers take one type for each field. Names are those of the bus. The schema is
written in full: some viewers support neither references nor alternatives.

A recorder reads 1500 messages a second at little CPU load. Messages are decoded into types that are
created here once, which is four times as fast as decoding into maps.
"""

import types
from collections.abc import Callable
from functools import cache, partial
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

from forcemesh.codec import Header
from forcemesh.errors import MessageError
from forcemesh.messages import Message
from forcemesh.records import Record
from forcemesh.topics import Topic

SCALARS = {bool: "boolean", int: "integer", float: "number", str: "string"}
# UnicodeDecodeError is a ValueError; excessive nesting ends in a RecursionError.
NOT_OURS = (msgspec.MsgspecError, ValueError, RecursionError)

Change = Callable[[Any], Any]
to_json = msgspec.json.Encoder().encode  # non-finite numbers become null


class Vector(msgspec.Struct, gc=False):
    """Vector with named components."""

    x: float
    y: float
    z: float


class Quaternion(msgspec.Struct, gc=False):
    """Quaternion with named components."""

    x: float
    y: float
    z: float
    w: float


VECTORS: dict[int, type[msgspec.Struct]] = {3: Vector, 4: Quaternion}


class FieldLayout(NamedTuple):
    """Type of a field: its schema, the type it is decoded to, and the conversion if any."""

    schema: dict[str, Any]
    read_as: Any
    change: Change | None = None
    optional: bool = False


class Layout:
    """Layout of named fields."""

    def __init__(self, *models: type[msgspec.Struct]) -> None:
        """Collect the fields of the models in order."""
        kinds = {
            name: _kind(annotation)
            for model in models
            for name, annotation in get_type_hints(model).items()
        }
        self.schema: dict[str, Any] = {
            "type": "object",
            "properties": {name: kind.schema for name, kind in kinds.items()},
            "required": [name for name, kind in kinds.items() if not kind.optional],
        }
        defaults = {
            field.name: field.default
            for model in models
            for field in msgspec.structs.fields(model)
            if field.default is not msgspec.NODEFAULT
        }
        self.read_as = msgspec.defstruct(
            models[-1].__name__,
            [_field(name, kind, defaults) for name, kind in kinds.items()],
            omit_defaults=True,
            kw_only=True,
        )
        self._changes = [(name, kind.change) for name, kind in kinds.items() if kind.change]
        self._decode = msgspec.msgpack.Decoder(self.read_as).decode

    def read(self, data: bytes) -> Any:
        """Decode a message, its fields as attributes; unknown fields are ignored.

        Raises MessageError if it is not of this layout.
        """
        try:
            return self._decode(data)
        except NOT_OURS as error:
            raise MessageError(f"not of this layout: {error}") from error

    def text(self, message: Any) -> bytes:
        """Return a decoded message as JSON; converts it in place."""
        return to_json(self.change(message))

    def change(self, message: Any) -> Any:
        """Convert the fields of a decoded message to their recorded form, in place."""
        for name, change in self._changes:
            value = getattr(message, name)
            if value is not None:
                setattr(message, name, change(value))
        return message


@cache
def layout_of(topic: Topic[Any]) -> Layout:
    """Return the layout of a topic: the header's fields, then the message's."""
    return Layout(Header, topic.message)


def schema_of(topic: Topic[Message]) -> dict[str, Any]:
    """Return the JSON Schema of a topic's channel."""
    about = {"title": topic.message.__name__, "description": topic.summary}
    return about | layout_of(topic).schema


def _field(name: str, kind: FieldLayout, defaults: dict[str, Any]) -> tuple[Any, ...]:
    """Return a field of the type to decode to; an older publisher may omit one with a default."""
    if kind.optional:
        return (name, kind.read_as | None, None)
    if name not in defaults:
        return (name, kind.read_as)
    # A factory: the value is recorded also where it equals the default.
    made = partial(msgspec.convert, defaults[name], kind.read_as, from_attributes=True)
    return (name, kind.read_as, msgspec.field(default_factory=made))


def _kind(annotation: Any) -> FieldLayout:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        inner = _kind(next(arg for arg in args if arg is not types.NoneType))
        return FieldLayout(inner.schema, inner.read_as, inner.change, optional=True)
    if origin is Literal:
        return FieldLayout({"type": "string", "enum": list(args)}, annotation)
    if origin is dict:
        values = _kind(args[1]).schema
        schema = {"type": "object", "properties": {}, "additionalProperties": values}
        return FieldLayout(schema, annotation)
    if origin is tuple:
        return _tuple(args)
    if isinstance(annotation, type) and issubclass(annotation, Record):
        inside = Layout(annotation)
        return FieldLayout(inside.schema, inside.read_as, inside.change)
    return FieldLayout({"type": SCALARS[annotation]}, annotation)


def _tuple(args: tuple[Any, ...]) -> FieldLayout:
    """Return the kind of a tuple: an object for a vector, else a list."""
    vector = VECTORS.get(len(args)) if set(args) == {float} else None
    if vector is not None:
        named = Layout(vector).schema
        return FieldLayout(named, tuple[args], lambda numbers: vector(*numbers))  # type: ignore[valid-type]
    item = _kind(args[0])
    schema: dict[str, Any] = {"type": "array", "items": item.schema}
    part: Any = item.read_as
    read_as: Any = tuple[part, ...]
    if args[-1] is not Ellipsis:
        schema |= {"minItems": len(args), "maxItems": len(args)}
        read_as = tuple[(part,) * len(args)]  # type: ignore[misc]
    change = item.change
    return FieldLayout(
        schema, read_as, change and (lambda values: [change(value) for value in values])
    )
