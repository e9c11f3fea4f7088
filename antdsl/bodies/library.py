"""Loads the definitions of the bodies in antdsl's library, each on first use."""

from __future__ import annotations

from functools import cache

from antdsl import resources
from antdsl.bodies.agents.definition import BodyError, Definition
from antdsl.bodies.files.reading import read_definition
from antdsl.scene.library_bodies import BODY_WORDS


@cache
def load_library_body(body_name: str) -> Definition:
    """Return the body called `body_name`. Raises KeyError if the name is not in BODY_WORDS, and BodyError if the body's file is
    damaged."""
    if body_name not in BODY_WORDS:
        raise KeyError(body_name)
    definition, report = read_definition(resources.body_file(f"{body_name}.json"))
    if definition is None or not report.ok:
        raise BodyError(f"`{body_name}` in the installation is damaged: {report.errors[0].message}", "install antdsl again")
    return definition
