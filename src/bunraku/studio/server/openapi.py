"""The studio's routes as an OpenAPI document, made of the routes themselves and of the classes that they read."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

__all__ = ["document_of", "schema_of"]

Routes = Iterable[tuple[str, tuple[str, ...], Callable[..., Any]]]
_PLAIN: dict[Any, dict[str, Any]] = {
    str: {"type": "string"}, bool: {"type": "boolean"}, int: {"type": "integer"}, float: {"type": "number"},
}  # fmt: skip
_ERROR = {
    "description": "What is wrong, one sentence.",
    "content": {"application/json": {"schema": {
        "type": "object", "properties": {"error": {"type": "string"}, "kind": {"type": "string"}},
    }}},
}  # fmt: skip


def schema_of(kind: Any) -> dict[str, Any]:
    """The JSON schema of a type: plain ones, lists, literals, dataclasses."""
    if kind in _PLAIN:
        return dict(_PLAIN[kind])
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(inner)}
    if origin in (Union, types.UnionType):
        return {"anyOf": [{"type": "null"} if one is type(None) else schema_of(one) for one in inner]}
    if origin in (list, tuple):
        same = (len(inner) == 2 and inner[1] is Ellipsis) or origin is list
        if same:
            return {"type": "array", "items": schema_of(inner[0])}
        bounds = {"minItems": len(inner), "maxItems": len(inner)}
        return {"type": "array", "prefixItems": [schema_of(one) for one in inner], **bounds}
    if origin in (dict, Mapping):
        return {"type": "object"}
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        own = {field.name: schema_of(hints[field.name]) for field in fields(kind)}
        needed = [field.name for field in fields(kind) if field.default is MISSING and field.default_factory is MISSING]
        said = inspect.getdoc(kind) or ""
        out: dict[str, Any] = {"type": "object", "title": kind.__name__, "description": said, "properties": own}
        return {**out, "required": needed} if needed else out
    return {}


def document_of(routes: Routes, version: str, reads: Mapping[tuple[str, str], type]) -> dict[str, Any]:
    """The document.

    Args:
        routes: Path, methods and handler of each; a handler's docstring says what it does.
        version: Of Bunraku.
        reads: The class of the JSON body of a path and method.
    """
    paths: dict[str, dict[str, Any]] = {}
    for path, methods, handler in routes:
        said = (inspect.getdoc(handler) or "").split("\n\n")[0].replace("\n", " ")
        for method in methods:
            entry: dict[str, Any] = {
                "operationId": f"{handler.__name__}_{method.lower()}", "summary": said,
                "responses": {"200": {"description": "What was asked for."},
                              "202": {"description": "The job that was begun; `/jobs/{name}` tells of it."},
                              "4XX": _ERROR, "5XX": _ERROR},
            }  # fmt: skip
            names = re.findall(r"{(\w+)", path)
            if names:
                entry["parameters"] = [
                    {"name": name, "in": "path", "required": True, "schema": {"type": "string"}} for name in names
                ]
            form = reads.get((path, method))
            if form is not None:
                entry["requestBody"] = {"content": {"application/json": {"schema": schema_of(form)}}}
            paths.setdefault(re.sub(r"{(\w+):\w+}", r"{\1}", path), {})[method.lower()] = entry
    return {
        "openapi": "3.1.0",
        "info": {"title": "Bunraku studio", "version": version},
        "servers": [{"url": "/api"}],
        "security": [{"token": []}],
        "components": {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
        "paths": paths,
    }
