"""Small programs with their scene as plain values, written out as text, edited at random; and what must continue, from these
values alone: the tests' own idea of a reload, which knows nothing of plans and registers."""

from __future__ import annotations

import random
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from meshes import grid

UNITS = {"number": "", "length": " mm", "mass": " g"}
WORDS = ["amble", "browse", "climb", "doze", "explore", "feed", "groom", "hide", "inspect", "jostle"]
NAMES = ["load", "mood", "vigour", "hunger", "reserve", "warmth", "thirst", "pluck"]
ANIMALS = ["ant", "beetle", "cricket", "roach"]
THINGS = ["apple", "bread", "cheese", "donut"]


@dataclass
class Attribute:
    kind: str
    value: float
    written: bool  # a state's body changes it

    def text(self, name: str) -> str:
        return f"  {name} = {self.value:g}{UNITS[self.kind]}"


@dataclass
class Species:
    count: int
    states: dict[str, bool]  # whether it strolls there, which takes a memory
    start: str
    attributes: dict[str, Attribute]


@dataclass
class Project:
    species: dict[str, Species]
    items: dict[str, int]
    cell: int = 20
    cells: int = 6  # of the ground, along a side
    height: float = 0.0
    remark: int = 0

    def program(self) -> str:
        parts = ["ant 1", f"# {self.remark}", "use steering"]
        parts += ["world {", "  surface ground", "  items food { load = 0 }", "}"]
        parts += [f"field trail on ground {{ cell {self.cell} mm; half_life 8 s }}"]
        return "\n".join([*parts, *(_species(name, each) for name, each in self.species.items()), ""])

    def scene(self) -> str:
        food = "\n".join(
            f"    {name}: {{at: [{10 * k}, 0, 5], load: {load}}}" for k, (name, load) in enumerate(self.items.items())
        )
        crowd = "\n".join(
            f"  - {{species: {name}, from: life.ant, count: {each.count}, place: {{on: ground}}}}"
            for name, each in self.species.items()
        )
        return (
            "antdsl: 1\nunits: mm\nfps: 24\nframes: 1..2000\nseed: 3\nworld:\n  ground: {mesh: ground.obj}\n"
            f"  food:\n{food}\ncrowd:\n{crowd}\n"
        )

    def ground(self) -> str:
        vertices, faces = grid(300.0, self.cells, lambda x, z: self.height * np.cos(x / 90) * np.cos(z / 70))
        lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
        return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces), ""])

    def texts(self) -> dict[str, str]:
        return {"life.ant": self.program(), "scene.yaml": self.scene(), "ground.obj": self.ground()}

    def save(self, folder: Path) -> None:
        for name, text in self.texts().items():
            if not (folder / name).exists() or (folder / name).read_text() != text:
                (folder / name).write_text(text)


def _species(name: str, species: Species) -> str:
    lines = [f"species {name} {{", "  size 4 mm", "  max_speed 30 mm/s"]
    lines += [attribute.text(word) for word, attribute in species.attributes.items()]
    lines += [f"  start {species.start}"]
    states = list(species.states)
    for k, (state, strolls) in enumerate(species.states.items()):
        lines += [
            f"  state {state} {{",
            f"    steer {'wander(swing: 60 deg)' if strolls else 'heading * 0.5'}",
            "    deposit trail 2 /s",
        ]
        for word, attribute in species.attributes.items():
            if attribute.written:
                lines += [f"    {word} += {k + 1}{UNITS[attribute.kind] or ' '}/s"]
        following, other = states[(k + 1) % len(states)], states[(k + 2) % len(states)]
        if following != state:
            lines += [f"    when chance 60 %/s -> {following}"]
        if other not in (state, following):
            lines += [f"    when speed > 1 mm/s held 0.6 s -> {other}"]
        lines += ["  }"]
    return "\n".join([*lines, "}"])


def first_project() -> Project:
    attributes = {"load": Attribute("number", 1, True), "mood": Attribute("length", 3, False)}
    ant = Species(30, {"amble": True, "browse": False, "climb": True}, "amble", attributes)
    roach = Species(8, {"doze": True, "feed": False}, "doze", {"hunger": Attribute("mass", 2, True)})
    return Project({"ant": ant, "roach": roach}, {"apple": 50, "bread": 20})


# --- edits -------------------------------------------------------------------------------------------------------------


def edited(project: Project, rng: random.Random) -> Project:
    """Another project that compiles, one to three edits away."""
    project = deepcopy(project)
    for _ in range(rng.choice((1, 1, 2, 3))):
        rng.choice(EDITS)(project, rng)
    return project


def _fresh(words: list[str], taken: dict[str, object], rng: random.Random) -> str | None:
    left = [word for word in words if word not in taken]
    return rng.choice(left) if left else None


def _any_species(project: Project, rng: random.Random) -> Species:
    return rng.choice(list(project.species.values()))


def _rename(of: dict, old: str, new: str) -> dict:
    return {new if name == old else name: value for name, value in of.items()}


def rename_state(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    old, new = rng.choice(list(species.states)), _fresh(WORDS, species.states, rng)
    if new:
        species.states = _rename(species.states, old, new)
        species.start = new if species.start == old else species.start


def remove_state(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    removed_state = rng.choice(list(species.states))
    if len(species.states) > 1:
        del species.states[removed_state]
        species.start = species.start if species.start != removed_state else next(iter(species.states))


def add_state(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    new = _fresh(WORDS, species.states, rng)
    if new and len(species.states) < 5:
        entries = [*species.states.items()]
        entries.insert(rng.randrange(len(entries) + 1), (new, rng.random() < 0.5))
        species.states = dict(entries)


def reorder_states(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    entries = list(species.states.items())
    rng.shuffle(entries)
    species.states = dict(entries)


def other_start(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    species.start = rng.choice(list(species.states))


def toggle_memory(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    state = rng.choice(list(species.states))
    species.states[state] = not species.states[state]


def add_attribute(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    new = _fresh(NAMES, species.attributes, rng)
    if new:
        species.attributes[new] = Attribute(rng.choice(list(UNITS)), rng.randrange(9), rng.random() < 0.5)


def remove_attribute(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    if species.attributes:
        del species.attributes[rng.choice(list(species.attributes))]


def rename_attribute(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    new = _fresh(NAMES, species.attributes, rng)
    if species.attributes and new:
        species.attributes = _rename(species.attributes, rng.choice(list(species.attributes)), new)


def other_attribute(project: Project, rng: random.Random) -> None:
    species = _any_species(project, rng)
    if species.attributes:
        attribute = rng.choice(list(species.attributes.values()))
        what = rng.choice(("kind", "value", "written"))
        if what == "kind":
            attribute.kind = rng.choice([kind for kind in UNITS if kind != attribute.kind])
        elif what == "value":
            attribute.value = rng.randrange(9)
        else:
            attribute.written = not attribute.written


def rename_species(project: Project, rng: random.Random) -> None:
    new = _fresh(ANIMALS, project.species, rng)
    if new:
        project.species = _rename(project.species, rng.choice(list(project.species)), new)


def add_or_remove_species(project: Project, rng: random.Random) -> None:
    new = _fresh(ANIMALS, project.species, rng)
    if len(project.species) > 1 and (rng.random() < 0.5 or not new):
        del project.species[rng.choice(list(project.species))]
    elif new:
        project.species[new] = deepcopy(_any_species(project, rng))


def other_count(project: Project, rng: random.Random) -> None:
    _any_species(project, rng).count = rng.choice((0, 5, 12, 30, 45))


def other_items(project: Project, rng: random.Random) -> None:
    new = _fresh(THINGS, project.items, rng)
    what = rng.random()
    if what < 0.4 and new:
        entries = [*project.items.items()]
        entries.insert(rng.randrange(len(entries) + 1), (new, rng.randrange(10, 90)))
        project.items = dict(entries)
    elif what < 0.7 and len(project.items) > 1:
        del project.items[rng.choice(list(project.items))]
    else:
        project.items[rng.choice(list(project.items))] = rng.randrange(10, 90)


def other_cell(project: Project, rng: random.Random) -> None:
    project.cell = rng.choice((15, 20, 25))


def other_ground(project: Project, rng: random.Random) -> None:
    if rng.random() < 0.5:
        project.height = rng.choice((0.0, 8.0, 15.0))
    else:
        project.cells = rng.choice((5, 6, 8))


def remark(project: Project, rng: random.Random) -> None:
    project.remark += 1


EDITS = (
    rename_state, remove_state, add_state, reorder_states, other_start, toggle_memory, add_attribute, remove_attribute,
    rename_attribute, *4 * (other_attribute,), rename_species, add_or_remove_species, other_count, other_items,
    other_cell, other_ground, remark,
)  # fmt: skip


def broken(project: Project, rng: random.Random) -> dict[str, str | None]:
    """Texts by file that cannot be run, None for a file that is not there: saved half, mistyped, of another type."""
    texts = project.texts()
    program, scene = texts["life.ant"], texts["scene.yaml"]
    species = next(iter(project.species.values()))
    return rng.choice(
        [
            {"life.ant": program[: rng.randrange(8, program.rindex("}"))]},
            {"life.ant": ""},
            {"life.ant": None},
            {"life.ant": program.replace("{", "(", 1)},
            {"life.ant": program.replace(f"start {species.start}", "start nowhere", 1)},
            {"life.ant": program.replace("max_speed 30 mm/s", "max_speed 30 s", 1)},
            {"life.ant": program.replace("deposit trail", "deposit trial", 1)},
            {"life.ant": program + "state lost { }\n"},
            {"scene.yaml": scene.replace("crowd:", "crowd")},
            {"scene.yaml": scene.replace("ground.obj", "gruond.obj")},
            {"scene.yaml": scene[: scene.index("crowd:") - 10]},
            {"ground.obj": "v 0 0 zero\n"},
            {"ground.obj": None},
        ]
    )


# --- what must continue -------------------------------------------------------------------------------------------------


@dataclass
class Herd:
    """Agents of one species by id, as plain values; memories by state."""

    ids: list[int]
    position: np.ndarray
    state: list[str]
    values: dict[str, np.ndarray]
    memories: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    next_id: int = 0


def survivors(old: Species, new: Species, ids: list[int]) -> list[int]:
    """The ids that stay when the scene's count is another: who came last goes."""
    fewer = max(0, old.count - new.count)
    return sorted(ids)[: max(0, len(ids) - fewer)]


def state_or_start(new: Species, state: str) -> str:
    return state if state in new.states else new.start


def value_after_edit(old: Species, new: Species, name: str, values: np.ndarray) -> np.ndarray:
    """What an attribute is after the edit, of those that stay."""
    new_attribute, old_attribute = new.attributes[name], old.attributes.get(name)
    fresh = np.full(len(values), new_attribute.value, np.float32)
    if old_attribute is None or old_attribute.kind != new_attribute.kind:
        return fresh
    follows_the_text = not old_attribute.written and not new_attribute.written and old_attribute.value != new_attribute.value
    return fresh if follows_the_text else values
