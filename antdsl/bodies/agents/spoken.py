"""Names of a definition as the language writes them: `Armature|Walk` of a file is `armature_walk` in `play armature_walk`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from antdsl.bodies.agents.definition import Definition, Variation

_OTHER = re.compile(r"[^a-z0-9_]+")


def spoken_name(text: str) -> str:
    """A name in small letters, digits and `_` that begins with a letter: what else there is becomes one `_`."""
    made = _OTHER.sub("_", text.lower()).strip("_")
    return made if made[:1].isalpha() else f"n{made}"


def spoken_names(names: Iterable[str]) -> dict[str, str]:
    """The spoken name of each; those that are spoken as they stand keep theirs, of others that sound alike the later get `_2`,
    `_3` and so on."""
    names = list(names)
    made = {name: name for name in names if spoken_name(name) == name}
    taken = set(made)
    for name in names:
        if name not in made:
            first = found = spoken_name(name)
            count = 2
            while found in taken:
                found, count = f"{first}_{count}", count + 1
            made[name] = found
            taken.add(found)
    return {name: made[name] for name in names}


def spoken(body: Definition) -> Definition:
    """The definition with its clips (the idle one too), their marks, its layers and its transform groups by spoken names.
    Channels keep theirs: clips and shapes name them."""
    clips, groups, layers = (spoken_names(each) for each in (body.clips, body.groups, body.layers))
    marked = {name: spoken_names(clip.marks) for name, clip in body.clips.items()}
    if all(name == own for each in (clips, groups, layers, *marked.values()) for name, own in each.items()):
        return body
    return replace(
        body,
        clips={
            clips[name]: replace(clip, name=clips[name], marks={marked[name][mark]: at for mark, at in clip.marks.items()})
            for name, clip in body.clips.items()
        },
        variation=Variation({groups.get(n, n): ends for n, ends in body.variation.scales.items()}, body.variation.materials),
        idle=clips.get(body.idle, body.idle),
        layers={layers[name]: replace(layer, name=layers[name]) for name, layer in body.layers.items()},
        groups={groups[name]: replace(group, name=groups[name]) for name, group in body.groups.items()},
    )
