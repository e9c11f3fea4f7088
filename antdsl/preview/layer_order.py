"""Layers that the user has switched off in the preview. Until files are saved, program texts without these layers replace the
files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from antdsl import syntax
from antdsl.syntax import nodes

DisabledLayers = Mapping[tuple[str, str], Path]


def remove_disabled_layers(disabled_layers: DisabledLayers) -> tuple[dict[Path, str], list[tuple[str, str]]]:
    """Return the files' texts without the disabled layers, and the layers (species, text) that no longer exist.

    An unreadable file is omitted here; compiling it reports the error."""
    texts: dict[Path, str] = {}
    missing_layers: list[tuple[str, str]] = []
    for path in dict.fromkeys(disabled_layers.values()):
        source, _ = syntax.read_program_file(path)
        if source is None:
            continue
        layer_keys = {key for key, place in disabled_layers.items() if place == path}
        file, _ = syntax.parse(source)
        spans = []
        for species in (item for item in file.items if isinstance(item, nodes.Species)):
            for layers in (member for member in species.members if isinstance(member, nodes.Layers)):
                for layer in layers.layers:
                    key = (species.name.text, layer.span.text)
                    if key in layer_keys:
                        spans.append((layer.span.start, layer.span.end))
                        layer_keys.discard(key)
        missing_layers += sorted(layer_keys)
        text = source.text
        for start, end in sorted(spans, reverse=True):
            # blanks preserve the positions of the text that follows
            text = text[:start] + re.sub("[^\n]", " ", text[start:end]) + text[end:]
        if spans:
            texts[Path(os.path.realpath(path))] = text
    return texts, missing_layers
