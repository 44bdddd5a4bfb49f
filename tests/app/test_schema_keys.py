"""What an editor shows of a study and of a case: each key says what it means, and in which unit."""

import re

import pytest
from json_schema import fits
from pydantic import Field

from memsgyro_jax.app.commands.schema import for_editors, schema_of
from memsgyro_jax.base.quantity import FileSection, Hertz, Pair, Volt


pytestmark = pytest.mark.smoke


@pytest.fixture(scope="module", params=["study", "case"])
def schema(request):
    return schema_of(request.param)


def keys(part, path=""):
    """Every key of a schema, however deep, with what the schema says of it."""
    if isinstance(part, dict):
        yield from ((f"{path}.{name}", entry) for name, entry in part.get("properties", {}).items())
    inner = part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ()
    for name, each in inner:
        yield from keys(each, f"{path}/{name}")


def units(entry):
    """Units of the quantities that a key holds itself; "" for any."""
    if isinstance(entry, list):
        return {unit for inner in entry for unit in units(inner)}
    if not isinstance(entry, dict):
        return set()
    own = re.fullmatch(r"a number and (?:a unit like (.+)|its unit)", str(entry.get("description")))
    return {own[1] or ""} if own else units(list(entry.values()))


def untold(schema):
    """Keys that do not say what they mean, or not in which unit."""
    found = []
    for path, entry in keys(schema):
        told, named = entry.get("description", ""), units(entry)
        missing = [unit for unit in named if not (told.endswith(f" [{unit}]") if unit else "unit" in told)]
        if len(told.split()) < 2 or missing or (told.endswith("]") and not named):
            found.append(path)
    return found


def test_every_key_says_what_it_means_and_in_which_unit(schema):
    assert len([*keys(schema)]) > 90
    assert untold(schema) == []


def test_quantities_are_seen_with_their_units():
    found = dict(keys(schema_of("study")))
    assert units(found["/$defs/SingleMass.mass"]) == {"kg"}
    assert units(found["/$defs/Carrier.gradient"]) == {"F/m"}
    assert units(found["/$defs/Surroundings.rate"]) == {"rad/s"}
    assert units(found["/$defs/Bell.std"]) == {""}
    assert units(found["/$defs/Surroundings.cross_rate"]) == set()  # those of its own keys
    assert found["/$defs/SingleMass.kind"]["description"].startswith('`kind = "single_mass"`: one proof mass')
    assert found["/$defs/Wave_rad_s.kind"]["description"].endswith(": a sine.")


class Silent(FileSection):
    """One that says too little."""

    told: Volt
    """A voltage."""
    width: Pair[Hertz]
    unknown: str = Field(default="", description="Text.")


def test_a_key_that_says_nothing_is_found():
    schema = for_editors(Silent.model_json_schema())
    assert untold(schema) == [".width", ".unknown"]
    del schema["properties"]["width"]
    schema["properties"]["told"]["description"] = "A voltage. [mV]"
    assert untold(schema) == [".told", ".unknown"]


def test_what_stands_for_a_key_left_out_may_be_written(schema):
    given = {path: entry for path, entry in keys(schema) if "default" in entry}
    assert len(given) > 10
    wrong = [path for path, entry in given.items() if not fits(entry["default"], entry, schema)]
    assert wrong == []
    assert not any(entry["default"] in (None, {}) for entry in given.values())


def test_parts_have_names_that_can_be_read(schema):
    assert all(re.fullmatch(r"\w{3,30}", name) for name in schema["$defs"])
    refs = {ref.rpartition("/")[2] for ref in re.findall(r"'\$ref': '([^']+)'", str(schema))}
    assert refs == {*schema["$defs"]}
