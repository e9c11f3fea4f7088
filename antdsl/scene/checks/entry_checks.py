"""Checks of single entries of a scene: names must be declared, files must exist, and values must have the right dimension."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import AttributeDecl, Constant, Dimension, Program, TypeKind, WorldThing
from antdsl.program.tables.units import choose_default_unit, describe_dimension, format_with_unit
from antdsl.program.tables.vocabulary import explain_range
from antdsl.scene.document import PathKey
from antdsl.scene.paths import PathRefused
from antdsl.scene.quantities import Quantity
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.load import Scene


class WorldEntryCheck(NamedTuple):
    """A scene's entry for a thing of the world, and the program's declaration of this thing."""

    scene: Scene
    program: Program
    report: Report
    name: str
    thing: WorldThing

    def find_span(self, *path: PathKey, key: bool = False) -> Span:
        """Return the location of a value of the entry or, if `key` is true, of its key."""
        return self.scene.find_span("world", self.name, *path, key=key)

    def check_file(self, text: str, *path: PathKey) -> None:
        """Report an error if the file `text`, which the entry names, does not exist."""
        check_file(self.scene, self.report, text, "world", self.name, *path)

    def report_unknown_name(self, noun: str, known_names: Iterable[str], *path: PathKey) -> None:
        """Report a value of the entry that is not in `known_names`. `noun`: words for the value, for the message."""
        report_unknown_name(self.report, self.scene, ("world", self.name, *path), noun, known_names, key=False)


def report_unknown_name(
    report: Report, scene: Scene, path: tuple[PathKey, ...], kind: str, known_names: Iterable[str], *, key: bool = True
) -> None:
    """Report a name that is not in `known_names`.

    `kind`: the start of the message. `path`: the location of the name. `key`: whether the name is the last key of the path
    rather than the value at the path."""
    names = sorted(known_names)
    name = str(path[-1]) if key else scene.find_span(*path).text.strip("\"'")
    near = find_nearest_name(name, names)
    help = f"did you mean `{near}`?" if near else ("known: " + ", ".join(f"`{n}`" for n in names[:12]) if names else None)
    report.error("unknown-thing", f"{kind} `{name}`", scene.find_span(*path, key=key), help)


def check_map_name(scene: Scene, report: Report, program: Program, name: str, *path: PathKey) -> bool:
    """Return whether the program has a map with this name. If not, report the name at its key."""
    maps = program.list_things_of_kind("map")
    if name in maps:
        return True
    report_unknown_name(report, scene, path, "no map is named", maps, key=False)
    return False


def check_file(scene: Scene, report: Report, text: str, *path: PathKey) -> None:
    """Report an error if a file does not exist. For a sequence, all of its files must exist."""
    try:
        files = scene.roots.find_sequence(text).values() if scene.roots.is_sequence(text) else (text,)
        size = max(scene.roots.measure_file_size(file) for file in files)
    except PathRefused as error:
        report.error(error.code, str(error), scene.find_span(*path), error.help)
        return
    if size > limits.MAX_MESH_BYTES:
        report.error("too-large", f"`{text}` has {size:,} bytes, more than {limits.MAX_MESH_BYTES:,}", scene.find_span(*path))


def check_attributes(entry: WorldEntryCheck, quantities: Mapping[str, Quantity], known_names: list[str], *path: PathKey) -> None:
    """Report attribute values of items that do not match the program's declarations."""
    declared = {a.name: a for a in entry.thing.attributes}
    for key, quantity in quantities.items():
        place = ("world", entry.name, *path, key)
        if key not in declared:
            report_unknown_name(entry.report, entry.scene, place, f"`{entry.name}` has no attribute", known_names)
        elif declared[key].type.kind is TypeKind.NUMBER:
            check_dimension(entry.scene, entry.report, quantity, declared[key].type.dimension, key, *place)


def check_dimension(scene: Scene, report: Report, value: Quantity, dim: Dimension, name: str, *path: PathKey) -> bool:
    """Return whether a value has the dimension `dim`. If not, report an error."""
    if value.dim == dim:
        return True
    words, unit = f"`{name}` is {describe_dimension(dim)}", choose_default_unit(dim)
    if value.has_no_unit:
        help = f"write `{format_with_unit(value.number, dim)}`"
        report.error("missing-unit", f"{words}, and `{value.text}` has no unit", scene.find_span(*path), help)
    else:
        help = f"write a value in `{unit}`" if unit else "write the number alone"
        report.error("wrong-unit", f"{words}, not {describe_dimension(value.dim)}", scene.find_span(*path), help)
    return False


def check_attribute_value(
    scene: Scene, report: Report, value: Quantity, attribute: AttributeDecl, *path: PathKey, deviation: float = 0.0
) -> bool:
    """Return whether an attribute may have a value. If not, report an error.

    `deviation`: subtracted from `value` before the test, in base units."""
    if not check_dimension(scene, report, value, attribute.type.dimension, attribute.name, *path):
        return False
    help = explain_range(attribute.name, value.to_base_units(scene.model.unit_mm, float(1 / scene.model.fps)) - deviation)
    if help is not None:
        words = f"`{attribute.name}` cannot be `{value.text}`"
        words += ", less three deviations" if deviation and explain_range(attribute.name, value.number) is None else ""
        report.error("out-of-range", words, scene.find_span(*path, key=path[-2:-1] == ("choice",)), help)
    return help is None


def convert_constant(const: Constant, scene: Scene) -> float:
    """Convert a constant of the program to base units, with this scene's length unit and frame rate."""
    return float(const.number * scene.model.unit_mm**const.unit_power * float(1 / scene.model.fps) ** const.step)
