"""How a message stands in a recording: as a JSON object that plots, and its JSON Schema. Pure.

Vectors become objects with x, y, z (and w), so that a viewer offers each part by its name; what is
None is left out, because viewers take one type for each field. Names stay those of the bus. The
schema is written out in full: some viewers follow no reference and know no alternatives.
"""

import types
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from common.codec import Header
from common.messages import Gain, Message
from common.topics import Topic

SCALARS = {bool: "boolean", int: "integer", float: "number", str: "string"}

Change = Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class Kind:
    """One type of field: its schema, and how its value changes, where it does."""

    schema: dict[str, Any]
    change: Change | None = None
    optional: bool = False


class Layout:
    """A flat map of named fields."""

    def __init__(self, kinds: dict[str, Kind]) -> None:
        """Sort out which fields change: most of them stay as they are."""
        self.schema: dict[str, Any] = {
            "type": "object",
            "properties": {name: kind.schema for name, kind in kinds.items()},
            "required": [name for name, kind in kinds.items() if not kind.optional],
        }
        self._changes = [(name, kind.change) for name, kind in kinds.items() if kind.change]
        self._optional = [name for name, kind in kinds.items() if kind.optional]

    def shape(self, fields: dict[str, Any]) -> dict[str, Any]:
        """Return the fields of a message as they are recorded; the map itself is changed.

        Raises TypeError, ValueError or KeyError where they are not of this layout.
        """
        for name in self._optional:
            if fields[name] is None:
                del fields[name]
        for name, change in self._changes:
            if name in fields:
                fields[name] = change(fields[name])
        return fields


@cache
def layout_of(topic: Topic[Any]) -> Layout:
    """Return the layout of a topic: the header's fields, then the message's."""
    return Layout({**_kinds(Header), **_kinds(topic.message)})


def schema_of(topic: Topic[Message]) -> dict[str, Any]:
    """Return the JSON Schema of a topic's channel."""
    about = {"title": topic.message.__name__, "description": topic.summary}
    return about | layout_of(topic).schema


def _kinds(model: type[BaseModel]) -> dict[str, Kind]:
    return {name: _kind(info.annotation) for name, info in model.model_fields.items()}


def _kind(annotation: Any) -> Kind:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(args[0])
    if origin in (Union, types.UnionType):
        inner = _kind(next(arg for arg in args if arg is not types.NoneType))
        return Kind(inner.schema, inner.change, optional=True)
    if origin is Literal:
        return Kind({"type": "string", "enum": list(args)})
    if origin is dict:
        values = _kind(args[1]).schema
        return Kind({"type": "object", "properties": {}, "additionalProperties": values})
    if origin is tuple:
        return _tuple(args)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        inside = Layout(_kinds(annotation))
        return Kind(inside.schema, inside.shape)
    return Kind({"type": SCALARS[annotation]})


def _tuple(args: tuple[Any, ...]) -> Kind:
    """Return what becomes of a tuple: a vector becomes an object, anything else a list."""
    if set(args) <= {float, Gain} and len(args) == 3:
        return Kind(_parts("xyz"), _xyz)
    if set(args) <= {float, Gain} and len(args) == 4:
        return Kind(_parts("xyzw"), _xyzw)
    item = _kind(args[0])
    schema: dict[str, Any] = {"type": "array", "items": item.schema}
    if args[-1] is not Ellipsis:
        schema |= {"minItems": len(args), "maxItems": len(args)}
    change = item.change
    return Kind(schema, change and (lambda values: [change(value) for value in values]))


def _parts(names: str) -> dict[str, Any]:
    number = {"type": "number"}
    return {
        "type": "object",
        "properties": dict.fromkeys(names, number),
        "required": list(names),
    }


def _xyz(vector: Any) -> dict[str, Any]:
    x, y, z = vector
    return {"x": x, "y": y, "z": z}


def _xyzw(quaternion: Any) -> dict[str, Any]:
    x, y, z, w = quaternion
    return {"x": x, "y": y, "z": z, "w": w}
