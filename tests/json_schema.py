"""Whether a value is what a JSON schema says: a second implementation of the part of it that our schemas use."""

import re


OK = {"string": str, "number": (int, float), "integer": int, "boolean": bool, "object": dict, "array": list}


def fits(value, schema, whole):
    """Whether a value is what a JSON schema says: a second implementation of what these schemas use."""
    if "$ref" in schema:
        part = whole
        for name in schema["$ref"].split("/")[1:]:
            part = part[name]
        return fits(value, part, whole)
    if "anyOf" in schema:
        return any(fits(value, one, whole) for one in schema["anyOf"])
    if "const" in schema or "enum" in schema:
        return value in schema.get("enum", [schema.get("const")])
    if schema.get("type") == "null" or value is None:
        return value is None and schema.get("type") in ("null", None)
    kind = schema.get("type")
    if kind and (not isinstance(value, OK[kind]) or (isinstance(value, bool) and kind != "boolean")):
        return False
    if "pattern" in schema and not re.search(schema["pattern"], value):
        return False
    if isinstance(value, dict):
        known, more = schema.get("properties", {}), schema.get("additionalProperties", True)
        inner = {name: known.get(name, more) for name in value}
        right = all(part is True or (part is not False and fits(value[n], part, whole)) for n, part in inner.items())
        return right and set(schema.get("required", ())) <= set(value)
    if isinstance(value, list):
        first, items = schema.get("prefixItems", []), schema.get("items", True)
        least, most = schema.get("minItems", 0), schema.get("maxItems", len(value))
        parts = [*first, *[items] * (len(value) - len(first))]
        return least <= len(value) <= most and all(
            part is True or fits(entry, part, whole) for entry, part in zip(value, parts, strict=False)
        )
    return True
