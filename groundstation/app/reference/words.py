"""Words, units and examples of every key: read from the YAML files beside this, held against the models.

``gs schema`` gives the words to editors; the reference pages are drawn from the same.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaValue

_FOLDER = Path(__file__).parent
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_UNITS = {
    "_m_s2": "m/s²",
    "_m_s": "m/s",
    "_1_s": "1/s",
    "_1_m": "1/m",
    "_bytes_per_s": "bytes/s",
    "_hz": "Hz",
    "_deg": "°",
    "_m": "m",
    "_s": "s",
    "_v": "V",
}
"""End of a key's name: its unit; the first that fits."""
FILES = ("mission", "formation", "campaign")
"""Files that people write and whose keys have words."""


@dataclass(frozen=True)
class Words:
    """What is said of one key.

    Attributes:
        text: what it means, Markdown.
        example: a value that it may have.
        unit: empty where it has none.
        default: words for a default that the model does not hold; None where it does.
    """

    text: str
    example: object
    unit: str
    default: str | None

    @property
    def plain(self) -> str:
        """The text without links and marks."""
        return _LINK.sub(r"\1", self.text).replace("`", "")


def unit_of(key: str) -> str:
    """Unit that a key's name ends in, empty where it names none."""
    return next((unit for ending, unit in _UNITS.items() if key.endswith(ending)), "")


@cache
def words_of(file: str) -> dict[str, dict[str, Words]]:
    """Words for the keys of a file: model, key, words.

    Args:
        file: one of ``FILES``.
    """
    values = yaml.safe_load((_FOLDER / f"{file}.yaml").read_text(encoding="utf-8"))
    return {
        model: {
            key: Words(entry["is"], entry["as"], entry.get("unit", unit_of(key)), entry.get("default"))
            for key, entry in keys.items()
        }
        for model, keys in values.items()
    }


def described(file: str, model: type[BaseModel]) -> JsonSchemaValue:
    """JSON schema of a file with the words and an example at every key.

    Args:
        file: one of ``FILES``.
        model: of the whole file.
    """
    schema = model.model_json_schema()
    words = words_of(file)
    for name, part in {model.__name__: schema, **schema.get("$defs", {})}.items():
        for key, said in words.get(name, {}).items():
            values = inside(part)["properties"][key]
            values["description"] = said.plain + (f" Unit: {said.unit}." if said.unit else "")
            values["examples"] = [said.example]
    return schema


def inside(part: JsonSchemaValue) -> JsonSchemaValue:
    """The object that holds a model's keys: that of a step stands below the step's own key."""
    properties = part["properties"]
    if len(properties) == 1:
        only: JsonSchemaValue = next(iter(properties.values()))
        if "properties" in only:
            return only
    return part
