"""Checks of a scene against a program. Each name must refer to a thing of the right kind, and each value must have the right
dimension and range.

No mesh is read here; only the existence of files is checked. `SCENE_CHECKS` lists the checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import Constant, Program, TypeKind
from antdsl.program.tables.columns import COLUMN_BY_ATTRIBUTE
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.units import format_number
from antdsl.scene import field_settings
from antdsl.scene.camera_models import CAMERA_VIEWS, DEFAULT_CAMERA_NAME, FollowCamera, PlacedCamera, UsdCamera
from antdsl.scene.checks.entry_checks import WorldEntryCheck, check_dimension, check_file, convert_constant, report_unknown_name
from antdsl.scene.checks.existence_checks import check_absent_species, check_body_files, check_dark_lamps
from antdsl.scene.checks.field_checks import check_field_start
from antdsl.scene.checks.shape_checks import collect_item_declarations
from antdsl.scene.checks.step_checks import check_avoidance_steps, check_step_lengths
from antdsl.scene.checks.wrap_checks import check_wrap
from antdsl.scene.crowds.crowd_checks import check_crowd, count_agents
from antdsl.scene.document import PathKey
from antdsl.scene.field_settings import check_field_dynamics
from antdsl.scene.load import Scene
from antdsl.scene.notes.note_checks import check_notes
from antdsl.scene.notes.selectors import AgentName, SelectorNames, find_selector_problems
from antdsl.scene.quantities import Quantity
from antdsl.scene.scene_kinds import SCENE_KINDS


def match_scene(scene: Scene, program: Program) -> Report:
    """Return a report with everything in the scene that does not match the program, with locations."""
    report = Report()
    for check in SCENE_CHECKS:
        check(scene, program, report)
    return report


def _check_world_entries(scene: Scene, program: Program, report: Report) -> None:
    """Report entries of `world` without a declared thing, declared things without an entry, and invalid entries."""
    program_things = {name: thing for name, thing in program.world.items() if thing.kind in SCENE_KINDS}
    placed_things = [name for name, thing in program_things.items() if KIND_BY_WORD[thing.kind].section == "world"]
    misspelt = set()
    for name in scene.model.world:
        if name not in placed_things:
            report_unknown_name(report, scene, ("world", name), "no program has a thing of the world named", placed_things)
            misspelt.add(find_nearest_name(name, placed_things))
    for name, thing in program_things.items():
        row, kind = KIND_BY_WORD[thing.kind], SCENE_KINDS[thing.kind]
        scene_things: Mapping[str, object] = scene.model.world if row.section == "world" else scene.model.named_cameras
        if name not in scene_things and name in misspelt:
            continue  # one message per mistake
        if name not in scene_things:
            place = scene.find_span(row.section if row.section in scene.document.entries else "antdsl", key=True)
            message = f"the program's {thing.kind} `{name}` has no {kind.missing_data} in the scene"
            advice = f"add `{name}: {row.scene}` to `{row.section}`"
            report.error("missing-thing", message, place, advice, labels=(Label(thing.span, "declared here"),))
        elif not isinstance(scene_things[name], kind.models):
            message = f"`{name}` is {row.scene_form} in the program, but something else here"
            place, advice = scene.find_span("world", name), f"write `{name}: {row.scene}`"
            report.error("wrong-kind", message, place, advice, labels=(Label(thing.span, "declared here"),))
        else:
            kind.check(WorldEntryCheck(scene, program, report, name, thing), scene_things[name])


def list_selector_names(scene: Scene, program: Program) -> SelectorNames:
    """Return the names that selectors of a scene may use."""
    machines = [machine for species in program.species.values() for machine in species.machines]
    states = {name for each in machines for state in each.states for name in (state.name, f"{each.name}.{state.name}")}
    cameras = scene.model.named_cameras
    return SelectorNames(
        {line.name: count for line, count in zip(scene.model.crowd, count_agents(scene), strict=True) if line.name is not None},
        frozenset(program.species),
        frozenset(collect_item_declarations(scene)),
        frozenset(states),
        frozenset(name for name, camera in cameras.items() if isinstance(camera, PlacedCamera | UsdCamera)),
        {name: _get_followed_agent(camera) for name, camera in cameras.items() if isinstance(camera, FollowCamera | str)},
    )


def _get_followed_agent(camera: FollowCamera | str) -> str:
    return str(camera.follow) if isinstance(camera, FollowCamera) else ""


def _check_params(scene: Scene, program: Program, report: Report) -> None:
    for name, value in scene.model.set.items():
        check_param(scene, program, report, name, value, "set", name)


def check_param(scene: Scene, program: Program, report: Report, name: str, value: Quantity, *path: PathKey) -> None:
    """Report a value of a param or a field setting with a name, dimension or range that does not match its declaration."""
    dim = field_settings.find_setting_dimension(program, name)
    if dim is not None:
        advice = field_settings.format_suggested_setting(name, value)
        if check_dimension(scene, report, value, dim, name, *(path or ("antdsl",))) and advice:
            place = scene.find_span(*path) if path else None
            report.error("out-of-range", f"`{name}` cannot be {value.text}", place, advice)
        return
    if name not in program.params:
        known = [*program.params, *field_settings.list_settable_names(program)]
        if path:
            report_unknown_name(report, scene, path, "no program has a param", known)
        else:
            near = find_nearest_name(name, known)
            report.error("unknown-thing", f"no program has a param `{name}`", None, f"did you mean `{near}`?" if near else None)
        return
    param = program.params[name]
    if not check_dimension(scene, report, value, param.type.dimension, name, *(path or ("antdsl",))):
        return
    number = value.to_base_units(scene.model.unit_mm, float(1 / scene.model.fps))
    low, high = (None if bound is None else convert_constant(bound, scene) for bound in (param.low, param.high))
    slack = 1e-9 * max(abs(number), 1e-30)
    if (low is not None and number < low - slack) or (high is not None and number > high + slack):
        ends = [_format_bound(bound, name) for bound in (param.low, param.high)]
        message = f"`{name}` = {value.text} is outside {ends[0]} .. {ends[1]}"
        place = scene.find_span(*path) if path else None
        report.error(
            "out-of-range", message, place, "write a value inside the range", labels=(Label(param.span, "declared here"),)
        )


def _format_bound(bound: Constant | None, name: str) -> str:
    if bound is None:
        return "…"
    return bound.span.text if 0 < len(bound.span.text) < 40 else format_number(bound.number)


def _check_fields(scene: Scene, program: Program, report: Report) -> None:
    for name, starts in scene.model.fields.items():
        declared = program.fields.get(name)
        if declared is None:
            report_unknown_name(report, scene, ("fields", name), "no program has a field", program.fields)
        for number, start in enumerate(starts):
            check_field_start(scene, report, start, declared, "fields", name, number)


def resolve_layer_order(scene: Scene, program: Program, species: str) -> tuple[list[str] | None, list[int]]:
    """Return the layers of a species in the order that the scene requests, and the indices of invalid lines.

    A line is invalid if it matches no layer, or several. If lines are invalid or layers are missing, the first result is None."""
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
            report_unknown_name(report, scene, ("layers", name), "no program has a species", program.species)
            continue
        texts = [layer.text for layer in program.species[name].layers.layers]
        order, wrong = resolve_layer_order(scene, program, name)
        for number in wrong:
            line = scene.model.layers[name][number]
            help = "write the start of one of: " + ", ".join(f"`{text}`" for text in texts)
            report.error(
                "unknown-thing",
                f"`{line}` does not match exactly one layer of `{name}`",
                scene.find_span("layers", name, number),
                help,
            )
        if order is None and not wrong:
            left = [text for text in texts if not any(text.startswith(line.strip()) for line in scene.model.layers[name])]
            advice = "add " + ", ".join(f"`{text}`" for text in left) if left else None
            report.error(
                "missing-thing", f"the order of the layers of `{name}` is incomplete", scene.find_span("layers", name), advice
            )


def _check_cameras(scene: Scene, program: Program, report: Report) -> None:
    """Report cameras with a name that means something else for `render --camera`, and cameras with missing files or agents."""
    for name, camera in scene.model.named_cameras.items():
        path = scene.model.find_camera_path(name)
        if isinstance(camera, UsdCamera):
            check_file(scene, report, camera.usd, *path, "usd")
        for key in ("follow", "focus"):
            agent = getattr(camera, key, None)
            for problem in (
                find_selector_problems(agent, list_selector_names(scene, program)) if isinstance(agent, AgentName) else ()
            ):
                report.error("unknown-thing", problem.message, scene.find_span(*path, key), problem.help)
        if name in CAMERA_VIEWS:
            words = f"`{name}` is a view that every cache has, so no camera of the scene can have this name"
            report.error("duplicate-name", words, scene.find_span(*path, key=True), "write another name")
    if scene.model.camera is not None and DEFAULT_CAMERA_NAME in scene.model.cameras:
        words = f"the camera under `camera` already has the name `{DEFAULT_CAMERA_NAME}`"
        place, label = (
            scene.find_span("cameras", DEFAULT_CAMERA_NAME, key=True),
            Label(scene.find_span("camera", key=True), "the other one"),
        )
        report.error("duplicate-name", words, place, "keep one of them", labels=(label,))


def _check_level_of_detail(scene: Scene, program: Program, report: Report) -> None:
    lod = scene.model.lod
    if lod is None:
        return
    if not isinstance(scene.model.named_cameras.get(DEFAULT_CAMERA_NAME), PlacedCamera | UsdCamera):
        advice = "write `camera: {at: [200, 150, 300], look_at: [0, 0, 0]}`, or leave `lod` out"
        words = "`lod` needs the distance from a camera, but the scene has no camera during the run"
        report.error("missing-key", words, scene.find_span("lod"), advice)
    unit = scene.model.unit_mm
    if lod.far is not None and lod.far.to_millimetres(unit) < lod.near.to_millimetres(unit):
        report.error("wrong-value", "`far` is less than `near`", scene.find_span("lod", "far"), "write the greater distance")


def _check_output_attributes(scene: Scene, program: Program, report: Report) -> None:
    """Report names under `output` that are not attributes of the program."""
    known = set(COLUMN_BY_ATTRIBUTE)
    for species in program.species.values():
        known |= {attribute.name for attribute in species.attributes if attribute.type.kind is TypeKind.NUMBER}
        known |= {f"{machine.name}.state" for machine in species.machines}
    for number, name in enumerate(scene.model.output.attributes):
        if name not in known:
            report_unknown_name(report, scene, ("output", "attributes", number), "no attribute is named", known, key=False)


def _check_notes(scene: Scene, program: Program, report: Report) -> None:
    check_notes(scene, program, report, list_selector_names(scene, program))


SCENE_CHECKS: tuple[Callable[[Scene, Program, Report], None], ...] = (
    _check_world_entries,  # the names that `around` and `on` refer to
    check_crowd,
    check_body_files,
    check_absent_species,
    check_dark_lamps,
    check_wrap,
    _check_params,
    _check_fields,
    check_field_dynamics,
    _check_layers,
    _check_cameras,
    _check_level_of_detail,
    _check_output_attributes,
    _check_notes,
    check_avoidance_steps,  # next to the last, for the same reason as the last
    check_step_lengths,  # last, because it warns about values that the others have checked
)
