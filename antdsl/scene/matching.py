"""Checks of a scene against a program: each name refers to a thing of the right kind, each value has the right dimension and
range.

No mesh is read here; only the existence of files is checked. `CHECKS` lists the comparisons."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.program.model import Const, Dim, Kind, Program, WorldThing
from antdsl.program.tables.columns import ATTRIBUTES
from antdsl.program.tables.things import KINDS_OF_THINGS
from antdsl.program.tables.units import default_unit, dimension_words, format_number, with_unit
from antdsl.scene import field_settings
from antdsl.scene.crowd_model import Placement, UsdPlaces
from antdsl.scene.document import Key
from antdsl.scene.existence_checks import bodies, check_absent_species
from antdsl.scene.field_settings import check_spreading
from antdsl.scene.load import Scene
from antdsl.scene.model import FILE_HEADS, MODELS, FlowThing, MeshThing, PaintedThing, UsdThing
from antdsl.scene.paths import PathRefused
from antdsl.scene.quantities import Quantity


def match_scene(scene: Scene, program: Program) -> Report:
    """Return everything that does not match, with its location in the scene."""
    report = Report()
    for check in CHECKS:
        check(scene, program, report)
    return report


def const_in_base_units(const: Const, scene: Scene) -> float:
    """Return a constant of the program in base units, for this scene's length unit and frame rate."""
    return float(const.number * scene.model.unit_mm**const.u * float(1 / scene.model.fps) ** const.step)


def _report_unknown(
    report: Report, scene: Scene, path: tuple[Key, ...], what: str, known: Iterable[str], *, key: bool = True
) -> None:
    names = sorted(known)
    name = str(path[-1]) if key else scene.span(*path).text
    near = nearest_name(name, names)
    help = f"did you mean `{near}`?" if near else ("known: " + ", ".join(f"`{n}`" for n in names[:12]) if names else None)
    report.error("unknown-thing", f"{what} `{name}`", scene.span(*path, key=key), help)


def _check_file(scene: Scene, report: Report, text: str, *path: Key) -> None:
    """Check whether a file, or the files of a sequence, exist."""
    try:
        files = scene.roots.sequence(text).values() if scene.roots.is_sequence(text) else (text,)
        size = max(scene.roots.file_size(file) for file in files)
    except PathRefused as refused:
        report.error(refused.code, str(refused), scene.span(*path), refused.help)
        return
    if size > limits.MESH_BYTES:
        report.error("too-large", f"`{text}` has {size:,} bytes, more than {limits.MESH_BYTES:,}", scene.span(*path))


def _check_world(scene: Scene, program: Program, report: Report) -> None:
    scene_things = scene.model.world
    program_things = {name: thing for name, thing in program.world.items() if thing.kind in MODELS}
    misspelt = set()
    for name in scene_things:
        if name not in program_things:
            _report_unknown(report, scene, ("world", name), "no program has a thing of the world named", program_things)
            misspelt.add(nearest_name(name, program_things))
    for name, thing in program_things.items():
        row = KINDS_OF_THINGS[thing.kind]
        if name not in scene_things and name in misspelt:
            continue  # one mistake, one complaint
        if name not in scene_things:
            place = scene.span("world", key=True) if "world" in scene.document.entries else scene.span("antdsl", key=True)
            lacks = "place" if thing.kind == "items" else "geometry"
            message = f"the program's {thing.kind} `{name}` has no {lacks} in the scene"
            advice = f"add `{name}: {row.scene}` to `world`"
            report.error("missing-thing", message, place, advice, labels=(Label(thing.span, "declared here"),))
        elif not isinstance(scene_things[name], MODELS[thing.kind]):
            message = f"`{name}` is {row.scene_form} in the program, and something else here"
            place, advice = scene.span("world", name), f"write `{name}: {row.scene}`"
            report.error("wrong-kind", message, place, advice, labels=(Label(thing.span, "declared here"),))
        else:
            _check_thing(scene, program, report, name, thing)


def _surface_names(program: Program, *others: str) -> list[str]:
    return [name for name, thing in program.world.items() if thing.kind in ("surface", *others)]


def _check_thing(scene: Scene, program: Program, report: Report, name: str, thing: WorldThing) -> None:
    value = scene.model.world[name]
    if thing.kind == "solid":
        _check_fixed_solid(scene, report, name)
    for head in FILE_HEADS if not isinstance(value, PaintedThing) else ():
        if (file := getattr(value, head, None)) is not None:
            _check_file(scene, report, file, "world", name, head)
    if isinstance(value, UsdThing):
        _check_item_keys(scene, report, name, thing, value)
    if isinstance(value, MeshThing | UsdThing):
        if thing.kind == "solid" and value.voxel is None:
            report.error(
                "missing-key", f"`{name}` is solid, but no `voxel` is given", scene.span("world", name),
                "add the edge of its voxels, a fourth of a body or less: `voxel: 1 mm`",
            )  # fmt: skip
        if thing.kind != "solid" and value.voxel is not None:
            report.error(
                "wrong-value", f"`{name}` is {thing.kind} in the program, and only solids have voxels",
                scene.span("world", name, "voxel"), f"leave it out, or declare `solid {name}`",
            )  # fmt: skip
        if value.scale == 0 or abs(value.scale) < 1e-6:
            place = scene.span("world", name, "scale")
            report.error("wrong-value", "a scale of 0 leaves no mesh", place, "write `scale: 1`")
        elif value.scale < 0:
            place, help = scene.span("world", name, "scale"), "its faces are turned so that outside stays outside"
            report.warning("mirrored", f"the mesh of `{name}` is mirrored", place, help)
    elif isinstance(value, (FlowThing, PaintedThing)):
        from antdsl.scene.staging.stage_flows import match_flow  # late: a scene without flows is checked without NumPy

        drawn = match_flow(scene, program, report, name, value)
        if drawn is not None:
            _check_file(scene, report, drawn[1], "world", name, drawn[0])
    elif isinstance(value, dict):
        declared = [a.name for a in thing.attributes]
        for item, placed in value.items():
            if placed.on is not None and placed.on not in _surface_names(program):
                _report_unknown(
                    report, scene, ("world", name, item, "on"), "no surface is named", _surface_names(program), key=False
                )
            known = [*declared, "at", "on", "radius", "keys", "look"]
            _check_attributes(scene, report, name, thing, placed.model_extra or {}, known, "world", name, item)


def _check_attributes(
    scene: Scene, report: Report, name: str, thing: WorldThing, quantities: Mapping[str, Quantity], known: list[str], *path: Key
) -> None:
    """Check values of items' attributes against the program's declarations."""
    declared = {a.name: a for a in thing.attributes}
    for key, quantity in quantities.items():
        if key not in declared:
            _report_unknown(report, scene, (*path, key), f"`{name}` has no attribute", known)
        elif declared[key].type.kind is Kind.NUMBER:
            _check_dimension(scene, report, quantity, declared[key].type.dim, key, *path, key)


def _check_item_keys(scene: Scene, report: Report, name: str, thing: WorldThing, value: UsdThing) -> None:
    """Check the settings of a part of a USD file that only apply to items against the program's declarations."""
    unseen = ("look",) if thing.kind == "curve" else ()
    keys = [key for key in ("each", "kind", "turn", *unseen) if key in value.model_fields_set]
    if thing.kind != "items":
        for key in keys:
            words = f"`{key}` is for {'what is seen' if key in unseen else 'items'}, but `{name}` is a {thing.kind}"
            report.error("wrong-kind", words, scene.span("world", name, key, key=True), "delete it")
        return
    declared = {a.name: a.type for a in thing.attributes}
    if "each" in keys:
        _check_attributes(scene, report, name, thing, value.each.model_extra or {}, [*declared, "radius"], "world", name, "each")
    axes = value.turn if isinstance(value.turn, tuple) else ()
    for number, attribute in enumerate(axes or ([] if value.turn is None else [str(value.turn)])):
        place: tuple[Key, ...] = ("world", name, "turn", number) if axes else ("world", name, "turn")
        expected_dimension, words = (
            (Dim(), "is a component of a direction, without a unit") if axes else (Dim(angle=1), "is an angle")
        )
        if attribute not in declared:
            _report_unknown(report, scene, place, f"`{name}` has no attribute", declared, key=False)
        elif declared[attribute].dim != expected_dimension:
            has = dimension_words(declared[attribute].dim)
            message = f"what `turn` gives `{attribute}` {words}, but `{attribute}` of `{name}` is {has}"
            help = f"declare `{attribute} = 0`" if axes else f"declare `{attribute} = 0 deg`"
            report.error("wrong-unit", message, scene.span(*place), help)


def _check_fixed_solid(scene: Scene, report: Report, name: str) -> None:
    value = scene.model.world[name]
    if isinstance(value, MeshThing | UsdThing) and (
        value.keys or (isinstance(value, MeshThing) and scene.roots.is_sequence(value.mesh))
    ):
        path: tuple[Key, ...] = ("world", name, "keys" if value.keys else "mesh")
        report.error("wrong-value", f"the solid `{name}` cannot move", scene.span(*path), "give it one place for all frames")


def _check_dimension(scene: Scene, report: Report, value: Quantity, dim: Dim, name: str, *path: Key) -> bool:
    if value.dim == dim:
        return True
    expected_words = dimension_words(dim)
    if value.is_bare:
        message, help = f"`{name}` is {expected_words}, and `{value.text}` has no unit", f"write `{with_unit(value.number, dim)}`"
        report.error("missing-unit", message, scene.span(*path), help)
    elif not default_unit(dim):
        message = f"`{name}` is {expected_words}, not {dimension_words(value.dim)}"
        report.error("wrong-unit", message, scene.span(*path), "write the number alone")
    else:
        message = f"`{name}` is {expected_words}, not {dimension_words(value.dim)}"
        report.error("wrong-unit", message, scene.span(*path), f"write a value in `{default_unit(dim)}`")
    return False


def _check_crowd(scene: Scene, program: Program, report: Report) -> None:
    total = 0
    for number, line in enumerate(scene.model.crowd):
        total += line.count
        if line.species not in program.species:
            _report_unknown(report, scene, ("crowd", number, "species"), "no program has a species", program.species, key=False)
        _check_placement(scene, program, report, line.place, "crowd", number, "place")
        if line.walk is not None and not any(line.walk.direction):
            where = scene.span("crowd", number, "walk", "direction")
            report.error("wrong-value", "`[0, 0, 0]` leads nowhere", where, "write a direction, such as `[1, 0, 0]`")
    if total > limits.AGENTS:
        report.error(
            "too-large", f"{total:,} agents are more than {limits.AGENTS:,}", scene.span("crowd"), "write a smaller `count`"
        )


def item_names(scene: Scene) -> dict[str, tuple[str, str]]:
    """Return the names that `around` accepts, each as (items, item): an item, or items, of which the first counts."""
    names: dict[str, tuple[str, str]] = {}
    for name, value in scene.model.world.items():
        if isinstance(value, dict) and value:
            names[name] = (name, next(iter(value)))
    for name, value in scene.model.world.items():
        if isinstance(value, dict):
            for item in value:
                names.setdefault(item, (name, item))
    return names


def _check_around(scene: Scene, report: Report, around: object, radius: object, *path: Key) -> None:
    if isinstance(around, str) and around not in item_names(scene) and not scene.model.has_usd_items:
        _report_unknown(report, scene, (*path, "around"), "no item is named", item_names(scene), key=False)
    if around is not None and radius is None:
        at = scene.span(*path, "around", key=True)
        report.error("missing-key", "`around` has no effect without `radius`", at, "add `radius: 50 mm`")


def _check_placement(scene: Scene, program: Program, report: Report, place: Placement, *path: Key) -> None:
    grounds = _surface_names(program, "solid")
    if place.on is not None and place.on not in grounds:
        _report_unknown(report, scene, (*path, "on"), "no surface is named", grounds, key=False)
    if place.points is not None:
        if isinstance(place.points, UsdPlaces):
            _check_file(scene, report, place.points.usd, *path, "points", "usd")
        else:
            _check_file(scene, report, place.points, *path, "points")
        if place.around is not None:
            words = "agents are placed at points or around a place, not both"
            report.error("wrong-value", words, scene.span(*path, "around", key=True), "keep one of them")
    if place.density is not None:
        maps = [name for name, thing in program.world.items() if thing.kind == "map"]
        if place.density not in maps:
            _report_unknown(report, scene, (*path, "density"), "no map is named", maps, key=False)
    used_keys = [name for name in ("points", "around", "radius", "density") if getattr(place, name) is not None]
    for method in ("density", "inside"):
        other = [name for name in used_keys if name != method]
        if getattr(place, method) is not None and other:
            words = f"agents are placed by `{method}` or by `{other[0]}`, not both"
            report.error("wrong-value", words, scene.span(*path, method, key=True), "keep one of them")
    if place.by == "area" and place.inside is not None:
        words = "agents that begin `inside` stand where lines from there end, and are not spread by area"
        report.error("wrong-value", words, scene.span(*path, "by", key=True), "leave `by` out")
    for key in ("apart", "seed"):
        if getattr(place, key) is not None and place.points is not None:
            words = f"agents at `points` stand where these are, and nothing is left for `{key}` to say"
            report.error("wrong-value", words, scene.span(*path, key, key=True), f"leave `{key}` out")
    if place.apart == "even" and (place.inside is not None or (place.density is not None and place.by != "area")):
        what, addition = ("inside", "") if place.inside is not None else ("by `density` from above", ", or add `by: area`")
        advice = f"write a length, such as `apart: 10 mm`{addition}"
        report.error("wrong-value", f"how much room there is {what} is not known", scene.span(*path, "apart", key=True), advice)
    _check_around(scene, report, place.around, place.radius, *path)


def _check_params(scene: Scene, program: Program, report: Report) -> None:
    for name, value in scene.model.set.items():
        check_param(scene, program, report, name, value, "set", name)


def check_param(scene: Scene, program: Program, report: Report, name: str, value: Quantity, *path: Key) -> None:
    """Check the value of a param, or of a field's setting, against its declaration: name, dimension, range."""
    dim = field_settings.setting_dimension(program, name)
    if dim is not None:
        advice = field_settings.refusal_help(name, value)
        if _check_dimension(scene, report, value, dim, name, *(path or ("antdsl",))) and advice:
            place = scene.span(*path) if path else None
            report.error("out-of-range", f"`{name}` cannot be {value.text}", place, advice)
        return
    if name not in program.params:
        known = [*program.params, *field_settings.settable_names(program)]
        if path:
            _report_unknown(report, scene, path, "no program has a param", known)
        else:
            near = nearest_name(name, known)
            report.error("unknown-thing", f"no program has a param `{name}`", None, f"did you mean `{near}`?" if near else None)
        return
    param = program.params[name]
    if not _check_dimension(scene, report, value, param.type.dim, name, *(path or ("antdsl",))):
        return
    number = value.to_base_units(scene.model.unit_mm, float(1 / scene.model.fps))
    low, high = (None if bound is None else const_in_base_units(bound, scene) for bound in (param.low, param.high))
    slack = 1e-9 * max(abs(number), 1e-30)
    if (low is not None and number < low - slack) or (high is not None and number > high + slack):
        ends = [_bound_text(bound, name) for bound in (param.low, param.high)]
        message = f"`{name}` = {value.text} is outside {ends[0]} .. {ends[1]}"
        place = scene.span(*path) if path else None
        report.error(
            "out-of-range", message, place, "write a value inside the range", labels=(Label(param.span, "declared here"),)
        )


def _bound_text(bound: Const | None, name: str) -> str:
    if bound is None:
        return "…"
    return bound.span.text if 0 < len(bound.span.text) < 40 else format_number(bound.number)


def _check_fields(scene: Scene, program: Program, report: Report) -> None:
    for name, start in scene.model.fields.items():
        if name not in program.fields:
            _report_unknown(report, scene, ("fields", name), "no program has a field", program.fields)
        _check_around(scene, report, start.around, start.radius, "fields", name)


def layer_order(scene: Scene, program: Program, species: str) -> tuple[list[str] | None, list[int]]:
    """Return the texts of a species' layers in the scene's order; or None and the indices of the scene's lines that match no
    layer or several."""
    layers = list(program.species[species].layers.layers)
    order: list[str] = []
    wrong: list[int] = []
    for number, line in enumerate(scene.model.layers[species]):
        fitting = [layer.text for layer in layers if layer.text.startswith(line.strip()) and layer.text not in order]
        exact = [text for text in fitting if text == line.strip() or text.split("(")[0].strip() == line.strip()]
        fitting = exact if len(exact) == 1 else fitting
        if len(fitting) == 1:
            order.append(fitting[0])
        else:
            wrong.append(number)
    return (order if not wrong and len(order) == len(layers) else None), wrong


def _check_layers(scene: Scene, program: Program, report: Report) -> None:
    for name in scene.model.layers:
        if name not in program.species:
            _report_unknown(report, scene, ("layers", name), "no program has a species", program.species)
            continue
        texts = [layer.text for layer in program.species[name].layers.layers]
        order, wrong = layer_order(scene, program, name)
        for number in wrong:
            line = scene.model.layers[name][number]
            help = "write the beginning of one of: " + ", ".join(f"`{text}`" for text in texts)
            report.error(
                "unknown-thing", f"`{line}` begins no single layer of `{name}`", scene.span("layers", name, number), help
            )
        if order is None and not wrong:
            left = [text for text in texts if not any(text.startswith(line.strip()) for line in scene.model.layers[name])]
            advice = "add " + ", ".join(f"`{text}`" for text in left) if left else None
            report.error(
                "missing-thing", f"the order of the layers of `{name}` is incomplete", scene.span("layers", name), advice
            )


def _check_detail(scene: Scene, program: Program, report: Report) -> None:
    lod = scene.model.lod
    if lod is None:
        return
    if scene.model.camera is None or isinstance(scene.model.camera, str):
        advice = "write `camera: {at: [200, 150, 300], look_at: [0, 0, 0]}`, or leave `lod` out"
        words = "`lod` goes by the distance from the camera, and there is none while agents walk"
        report.error("missing-key", words, scene.span("lod"), advice)
    unit = scene.model.unit_mm
    if lod.far is not None and lod.far.length(unit) < lod.near.length(unit):
        report.error("wrong-value", "`far` is nearer than `near`", scene.span("lod", "far"), "write the greater distance")


def _check_output(scene: Scene, program: Program, report: Report) -> None:
    known = set(ATTRIBUTES)
    for species in program.species.values():
        known |= {attribute.name for attribute in species.attributes if attribute.type.kind is Kind.NUMBER}
        known |= {f"{machine.name}.state" for machine in species.machines}
    for number, name in enumerate(scene.model.output.attributes):
        if name not in known:
            _report_unknown(report, scene, ("output", "attributes", number), "no attribute is named", known, key=False)


CHECKS: tuple[Callable[[Scene, Program, Report], None], ...] = (
    _check_world,  # what `around` and `on` name is in here
    _check_crowd,
    bodies,
    check_absent_species,
    _check_params,
    _check_fields,
    check_spreading,
    _check_layers,
    _check_detail,
    _check_output,
)
