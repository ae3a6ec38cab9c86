"""JSON objects whose form a ``TypedDict`` says: their JSON schema, and whether a value from outside has that form."""

import sys
import types
from collections.abc import Callable
from functools import cache, reduce
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

SIMPLE_TYPES = ("string", "number", "integer", "boolean", "object")

_SCHEMA: dict[Any, dict[str, Any]] = {
    Any: {},
    str: {"type": "string"},
    float: {"type": "number"},
    int: {"type": "integer"},
    bool: {"type": "boolean"},
    type(None): {"type": "null"},
}


def schema_of(kind: Any) -> dict[str, Any]:
    """The JSON schema of a type: a ``TypedDict``, or what its fields may be.

    Foxglove and Lichtblick refuse a whole channel in whose ``properties`` anything is a union or an array of arrays. To
    them such a field is better unnamed, and they show it all the same; so it stands in ``patternProperties``, which
    means the same to a validator.
    """
    if kind in _SCHEMA:
        return _SCHEMA[kind]
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(inner)}
    if origin in {Union, types.UnionType}:
        return {"anyOf": [schema_of(one) for one in inner]}
    if origin is list:
        return {"type": "array", "items": schema_of(inner[0])}
    if origin is dict:
        return {"type": "object", "properties": {}, "additionalProperties": schema_of(inner[1])}
    assert is_typeddict(kind), kind
    fields = {name: schema_of(hint) for name, hint in get_type_hints(kind).items()}
    simple = {name: schema for name, schema in fields.items() if _is_simple(schema)}
    return {
        "title": kind.__name__,
        "type": "object",
        "properties": simple,
        "patternProperties": {f"^{name}$": schema for name, schema in fields.items() if name not in simple},
        "required": list(fields),
    }


def _is_simple(schema: dict[str, Any]) -> bool:
    if schema.get("type") == "array":
        schema = schema["items"]
    return schema.get("type") in SIMPLE_TYPES


Check = Callable[[Any], bool]

_NUMBER_TYPES = frozenset({float, int})
_CHECK: dict[Any, Check] = {
    Any: lambda _: True,
    str: lambda value: type(value) is str,
    float: lambda value: type(value) in _NUMBER_TYPES and abs(value) <= sys.float_info.max,
    int: lambda value: type(value) is int and -(2**63) <= value < 2**64,
    bool: lambda value: type(value) is bool,
    type(None): lambda value: value is None,
}


@cache
def form_check(kind: Any) -> Check:
    """A function that says whether a value has this form; fields beyond it do not matter. Numbers are finite, whole
    ones have 64 bits.
    """
    if kind in _CHECK:
        return _CHECK[kind]
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return lambda value: type(value) is str and value in inner
    if is_typeddict(kind):
        return _object_check({name: form_check(hint) for name, hint in get_type_hints(kind).items()})
    checks = [form_check(one) for one in inner]
    if origin in {Union, types.UnionType}:
        return reduce(_either, checks)
    if origin is list:
        return lambda value: type(value) is list and all(map(checks[0], value))
    assert origin is dict, kind
    return lambda value: type(value) is dict and all(map(checks[1], value.values()))


def _either(one: Check, other: Check) -> Check:
    return lambda value: one(value) or other(value)


def _object_check(fields: dict[str, Check]) -> Check:
    return lambda value: (
        type(value) is dict and all(name in value and check(value[name]) for name, check in fields.items())
    )
