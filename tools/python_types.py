#!/usr/bin/env python3
"""Writes the types of the Python package from the OpenAPI document.

Usage: tools/python_types.py            writes python/src/ridged/_api.py
"""

import json
import keyword
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "src/api/openapi.json"
TARGET = ROOT / "python/src/ridged/_api.py"

# Bodies and answers that the package names; their parts follow.
NAMED = [
    "CalibrationBody", "CertaintyBody", "Comparison", "CurvesBody", "EstimateBody", "Fit", "FrameBody", "IncidentBody",
    "LeaseBody", "LeaseStateBody", "ObservationsBody", "OrderBody", "PlanRequest", "PreviewAnswer", "Problem",
    "QueueBody", "RecipeBody", "Repeatability", "Result", "RigBody", "SampleBody", "ScanBody", "SessionBody", "SpecificationBody",
]  # fmt: skip

HEAD = '''"""Bodies of the HTTP API, as TypedDicts. Made by `tools/python_types.py` from the OpenAPI document; do not edit."""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

'''


def references(schema: Any) -> set[str]:
    """Names of the schemas that a schema uses."""
    if isinstance(schema, dict):
        found = {schema["$ref"].rsplit("/", 1)[-1]} if "$ref" in schema else set()
        return found.union(*(references(part) for part in schema.values()))
    if isinstance(schema, list):
        return set().union(*(references(part) for part in schema))
    return set()


def closure(schemas: dict[str, Any], names: list[str]) -> list[str]:
    """The named schemas and all that they use, by name."""
    found: set[str] = set()
    open_names = list(names)
    while open_names:
        name = open_names.pop()
        if name not in found:
            found.add(name)
            open_names.extend(references(schemas[name]))
    return sorted(found)


def annotation(schema: dict[str, Any]) -> str:
    """The Python type of a schema."""
    if "$ref" in schema:
        return str(schema["$ref"].rsplit("/", 1)[-1])
    for word in ("oneOf", "anyOf", "allOf"):
        if word in schema:
            return union([annotation(part) for part in schema[word]])
    if "enum" in schema:
        return f"Literal[{', '.join('None' if value is None else json.dumps(value) for value in schema['enum'])}]"
    kinds = schema.get("type", "any")
    return union([of_kind(kind, schema) for kind in ([kinds] if isinstance(kinds, str) else kinds)])


def of_kind(kind: str, schema: dict[str, Any]) -> str:
    match kind:
        case "array":
            return f"list[{annotation(schema.get('items', {}))}]"
        case "object":
            values = schema.get("additionalProperties")
            return f"dict[str, {annotation(values) if isinstance(values, dict) else 'Any'}]"
        case _:
            simple = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}
            return simple.get(kind, "Any")


def union(parts: list[str]) -> str:
    return " | ".join(sorted(dict.fromkeys(parts), key=lambda part: part == "None"))


def sentence(text: str) -> str:
    return re.sub(r"\s+", " ", text.split("\n\n")[0]).strip().replace("\\", "\\\\").replace('"', "'")


def definition(name: str, schema: dict[str, Any]) -> str:
    """The class or alias of one schema."""
    words = sentence(schema.get("description", name + "."))
    fields = schema.get("properties")
    if fields is None:
        return f"{name} = {alias(schema)}\n\"\"\"{words}\"\"\"\n"
    required = set(schema.get("required", []))
    if any(keyword.iskeyword(field) for field in fields):
        kinds = ", ".join(f'"{field}": {annotation(part)}' for field, part in fields.items())
        return f'{name} = TypedDict("{name}", {{{kinds}}})\n"""{words}"""\n'
    lines = [f"class {name}(TypedDict):", f'    """{words}"""', ""]
    for field, part in fields.items():
        kind = annotation(part)
        lines.append(f"    {field}: {kind if field in required else f'NotRequired[{kind}]'}")
    return "\n".join(lines) + "\n"


def alias(schema: dict[str, Any]) -> str:
    """The type of a schema without fields; kinds of an object are open dictionaries."""
    if any("properties" in part for part in schema.get("oneOf", [])):
        return "dict[str, Any]"
    return annotation(schema)


def text() -> str:
    """The whole file."""
    schemas = json.loads(DOCUMENT.read_text())["components"]["schemas"]
    names = closure(schemas, NAMED)
    aliases = [name for name in names if "properties" not in schemas[name]]
    classes = [name for name in names if "properties" in schemas[name]]
    # An alias is evaluated where it is, so one that uses a class follows the classes.
    late = [name for name in aliases if references(schemas[name]) & set(classes)]
    early = [name for name in aliases if name not in late]
    parts = [definition(name, schemas[name]) for name in early]
    parts += ["\n" + definition(name, schemas[name]) for name in classes]
    parts += ["\n" + definition(name, schemas[name]) for name in late]
    return HEAD + "\n".join(parts)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        raise SystemExit(__doc__)
    TARGET.write_text(text())
