"""``gs schema``: JSON schemas of the files that people write, for editors and other programs."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from groundstation.app.completing import choice
from groundstation.app.output import print_text
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

if TYPE_CHECKING:
    from pydantic import BaseModel


def _mission() -> type[BaseModel]:
    from groundstation.mission.plan.schema import MissionSpec

    return MissionSpec


def _formation() -> type[BaseModel]:
    from groundstation.design.store import FormationFile

    return FormationFile


def _campaign() -> type[BaseModel]:
    from groundstation.app.campaign.vary import VarySpec

    return VarySpec


MODELS: dict[str, Callable[[], type[BaseModel]]] = {
    "mission": _mission,
    "formation": _formation,
    "campaign": _campaign,
}


def schema(
    what: Annotated[
        str,
        typer.Argument(
            help="mission, formation or campaign.", autocompletion=choice("mission", "formation", "campaign")
        ),
    ],
) -> None:
    """Prints the JSON schema of a file: gs schema mission > mission.schema.json.

    Editors check and complete a YAML file with the line
    # yaml-language-server: $schema=mission.schema.json
    which gs init and gs new formation write, with the schema beside it.
    """
    if what not in MODELS:
        raise UserError(f"gs schema {what}: {unknown(what, MODELS)}")
    print_text(schema_json(what))


def schema_json(what: str) -> str:
    """The JSON schema of a file, drawn from its model; ``configs/schemas`` holds the same."""
    from groundstation.app.reference.words import described

    values = described(what, MODELS[what]())
    return json.dumps({"$schema": "https://json-schema.org/draft/2020-12/schema", **values}, indent=2)
