"""What requests to the HTTP interface may have in them, in words, from its description in the form of OpenAPI."""

import json
from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]


def bodies(operation: Schema, schemas: Mapping[str, Schema]) -> list[list[tuple[str, str]]]:
    """The values of each kind of body that an operation takes, and of its path those with few choices: names and words.

    Args:
        operation: of the description.
        schemas: its components, by their names.
    """
    found = [
        [(one["name"], _choices(one["schema"]))] for one in operation.get("parameters", ()) if "enum" in one["schema"]
    ]
    for content in operation.get("requestBody", {}).get("content", {}).values():
        schema = content["schema"]
        found += [_values(_followed(each, schemas)) for each in schema.get("oneOf", [schema])]
    return [values for values in found if values]


def _followed(schema: Schema, schemas: Mapping[str, Schema]) -> Schema:
    return schemas[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


def _values(schema: Schema) -> list[tuple[str, str]]:
    required = schema.get("required", ())
    return [(name, _words(value, name in required)) for name, value in schema.get("properties", {}).items()]


def _words(schema: Schema, required: bool) -> str:
    if "const" in schema:
        return json.dumps(schema["const"])
    words = [schema.get("description") or _choices(schema) or schema.get("type", "")]
    default = schema.get("default")
    if not required and default not in (None, "", [], {}):
        words.append(f"{json.dumps(default)} if left out")
    elif not required:
        words.append("may be left out")
    return "; ".join(word for word in words if word)


def _choices(schema: Schema) -> str:
    return ", ".join(map(json.dumps, schema.get("enum", ())))
