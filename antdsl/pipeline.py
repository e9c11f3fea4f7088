"""The stages from text to simulation: text → tree → program → plan; scene → setting; plan and setting → world.

Every stage returns `(result, Report)`. The result is None if errors prevent it."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from antdsl import __version__
from antdsl.diagnostics import Report
from antdsl.loading import LoadedSources, ParsedFileCache, SharedParsedFiles
from antdsl.numerics.processor.float_environment import use_standard_floats
from antdsl.safe_read import resolve_path

if TYPE_CHECKING:
    from antdsl.bodies.agents.definition import Definition
    from antdsl.diagnostics import Diagnostic
    from antdsl.plan.ir import Plan
    from antdsl.plan.lowering.spec_plans import MeasuresPlan, SpecPlan
    from antdsl.plan.lowering.writer import BodyProportions
    from antdsl.program.expectations import SpecChange
    from antdsl.program.memo import CheckResultCache
    from antdsl.program.model import Program
    from antdsl.runtime import Options, World
    from antdsl.scene import Scene
    from antdsl.scene.geometry.import_notes import MeshImport
    from antdsl.scene.setting import WorldSetting
    from antdsl.scene.values import FrameRange


@dataclass(frozen=True, slots=True)
class RunChoices:
    """The choices of the user that override or extend a scene.

    `grants`: the folder of each granted root, by name.
    `frames`, `seed`, `until`, `params`: values that override those of the scene. `params` may also have values of scene keys
    (`crowd.walker.count`).
    `changes`: further params and field settings, which a spec sets.
    `notes`: further notes, each a line such as `{hold: guards, frames: 10..20}`."""

    grants: Mapping[str, Path] = field(default_factory=dict)
    frames: FrameRange | None = None
    seed: int | None = None
    params: Mapping[str, str] = field(default_factory=dict)
    changes: tuple[SpecChange, ...] = ()  # what a spec also sets: params and settings of fields
    notes: tuple[str, ...] = ()  # lines such as `{hold: guards, frames: 10..20}`
    until: str | None = None  # a condition in the words of specs


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A scene that is ready to be simulated.

    `inputs`: a hash, by name, of everything that the result depends on.
    `loaded`: the texts of the program.
    `bodies`: by species, the definition of a body that comes from a file.
    `proportions`: by species, the proportions of each species that sets its height.
    `measures`, `until`: the plans of the program's measures, and of the condition that ends the run; None if there is none."""

    scene: Scene
    program: Program
    plan: Plan
    setting: WorldSetting
    inputs: Mapping[str, str]
    loaded: LoadedSources
    bodies: Mapping[str, Definition] = field(default_factory=dict)
    proportions: Mapping[str, BodyProportions] = field(default_factory=dict)
    measures: MeasuresPlan | None = None
    until: SpecPlan | None = None

    @property
    def measure_names(self) -> tuple[str, ...]:
        """Return the names of the program's measures, in text order."""
        return () if self.measures is None else tuple(self.measures.nodes)

    @property
    def frames(self) -> FrameRange:
        """Return the range of frames of the scene."""
        return self.scene.model.frames


def compile_files(
    paths: Iterable[Path | str],
    *,
    strict: bool = False,
    parsed: ParsedFileCache | None = None,
    memo: CheckResultCache | None = None,
) -> tuple[Program | None, Report]:
    """Parse and check programs together, with the library and all files that they use. Return (program, report). The program is
    None if no file can be read or if it has errors.

    `strict`: whether to add the findings of `check --strict`. `parsed` and `memo`: caches of parsed and checked parts, for reuse
    by the next call."""
    files = [Path(path) for path in paths]
    loaded = LoadedSources(resolve_path(files[0]).parent if files else Path.cwd(), parse_cache={} if parsed is None else parsed)
    for file in files:
        loaded.add_file(file)
    return _check_loaded_sources(loaded, strict, memo)


def _check_loaded_sources(
    loaded: LoadedSources, strict: bool, memo: CheckResultCache | None = None
) -> tuple[Program | None, Report]:
    """Check loaded files as one program. Return (program, report). The program is None if no file was loaded or if it has errors.
    `strict`: as in `compile_files`."""
    from antdsl.program import check

    report = Report()
    if not loaded.files:
        report.extend(loaded.report)
        return None, report
    # files are the same objects as long as they are in `parsed`; names of modules are read from their texts
    key = (
        strict,
        *(id(file) for file in loaded.files),
        *((name, id(file)) for name, file in sorted(loaded.module_by_path.items())),
    )
    cache = loaded.parse_cache.check_results if isinstance(loaded.parse_cache, SharedParsedFiles) else {}
    if key not in cache:
        cache[key] = (
            *check(loaded.files, loaded.find_library, loaded.module_by_path, strict=strict, memo=memo),
            loaded.list_library_names(),
        )
    program, findings, libraries = cache[key]
    for name in libraries:  # a program's parts are reported with it, also if it was checked before
        loaded.find_library(name)
    report.extend(loaded.report)
    report.extend(findings)
    return program, report


@use_standard_floats()
def open_scene(
    path: Path | str,
    choices: RunChoices | None = None,
    *,
    parsed: ParsedFileCache | None = None,
    thorough: bool = True,
    raw: bool = False,
) -> tuple[Shot | None, Report]:
    """Read a scene and compile its programs. Return (shot, report). The shot is None if there are errors.

    `parsed`: as in `compile_files`. `thorough`: as in `passes.optimise`. `raw`: whether to return the plan as it is before any
    pass."""
    path = Path(path)
    from antdsl import passes, plan
    from antdsl.bodies.crowd_bodies import load_crowd_bodies
    from antdsl.measures.scene_measures import lower_scene_measures
    from antdsl.scene.checks.scene_checks import resolve_layer_order
    from antdsl.scene.field_settings import replace_field_settings
    from antdsl.scene.notes.note_programs import add_note_machines
    from antdsl.scene.overrides import apply_field_changes, apply_param_changes, read_overrides
    from antdsl.scene.scene_values import select_params
    from antdsl.scene.staging.stage_scene import build_setting

    choices = choices or RunChoices()
    scene, program, loaded, report = _read_scene(path, choices, parsed=parsed)
    if scene is None or program is None or not report.ok:
        return None, report
    param_overrides = read_overrides(scene, program, select_params(choices.params), Report())
    program = replace_field_settings(program, scene, {**scene.model.set, **param_overrides})
    program = add_note_machines(apply_field_changes(program, choices.changes), scene)
    orders = {name: order for name in scene.model.layers if (order := resolve_layer_order(scene, program, name)[0]) is not None}
    setting, findings, meshes = build_setting(scene, program, param_overrides)
    report.extend(findings)
    if setting is None or not report.ok:
        return None, report
    report.drop_warnings(_find_stale_attribute_warnings(report, scene, program, setting))
    bodies, body_findings = load_crowd_bodies(scene, program)
    lowered, findings = plan.lower(
        program, orders=orders, scene_attributes=setting.initial_attributes, proportions=bodies.proportions,
        period=None if setting.period is None else setting.period.widths,
    )  # fmt: skip
    report.extend(findings)
    report.extend(body_findings)
    if not report.ok:
        return None, report
    setting = apply_param_changes(setting, scene, program, choices.changes)
    setting = replace(
        setting, body_weights=bodies.weights, clips=bodies.clips, body_capsules=bodies.collision_sizes, legs=bodies.legs,
        undrawn_things=_find_undrawn_things(scene),
    )  # fmt: skip
    inputs = {"antdsl": __version__, "scene": scene.compute_digest(), **loaded.hash_texts(), **meshes, **bodies.hashes}
    inputs |= {f"--set {name}": text for name, text in choices.params.items()}
    inputs |= {f"--note {number}": text for number, text in enumerate(choices.notes)}
    sensed_cameras = setting.cameras if scene.model.notes else program.list_things_of_kind("camera")  # notes select by any
    inputs |= {f"camera {name}": scene.hash_camera(name) for name in sensed_cameras}
    inputs |= {f"set {change.name}": change.value.span.text for change in choices.changes}
    final_plan = lowered if raw else passes.optimise_plan(lowered, thorough=thorough)
    measures, until, findings = lower_scene_measures(scene, program, loaded, final_plan)
    report.extend(findings)
    if not report.ok:
        return None, report
    shot = Shot(
        scene, program, final_plan, setting, inputs, loaded, bodies.definitions, bodies.proportions, measures, until
    )  # fmt: skip
    return shot, report


def _find_undrawn_things(scene: Scene) -> frozenset[str]:
    """Return the names of those things of the world that pictures do not show."""
    return frozenset(name for name, thing in scene.model.world.items() if getattr(thing, "look", None) == "none")


def _read_scene(
    path: Path,
    choices: RunChoices,
    strict: bool = False,
    parsed: ParsedFileCache | None = None,
    data: bytes | None = None,
    texts: Mapping[Path, bytes] | None = None,
) -> tuple[Scene | None, Program | None, LoadedSources, Report]:
    """Return a scene, the program of all its files, their sources, and a report. Scene and program are None if errors prevent
    them.

    The report also covers how well the scene and the program match. `data`: the text of the scene in an editor; None to read the
    file. `texts`: texts that override files on disk."""
    from antdsl.measures.scene_measures import check_until
    from antdsl.scene.checks.scene_checks import match_scene
    from antdsl.scene.load import load_scene, load_scene_text
    from antdsl.scene.overrides import read_overrides
    from antdsl.scene.paths import Roots
    from antdsl.scene.scene_values import select_params

    if data is None:
        scene, report = load_scene(path, choices.grants, choices.notes, choices.params)
    else:
        roots = Roots(resolve_path(path).parent, dict(choices.grants))
        scene, report = load_scene_text(data, str(path), roots, texts, values=choices.params)
    loaded = LoadedSources(resolve_path(path).parent, parse_cache={} if parsed is None else parsed)
    if scene is None:
        return None, None, loaded, report
    if data is None:  # an editor's text is read without the meshes of its world
        _notify_format_reader(scene)
    scene = scene.replace_values(frames=choices.frames, seed=choices.seed, until=choices.until)
    for number, line in enumerate(scene.model.crowd):
        if line.source not in {other.source for other in scene.model.crowd[:number]}:
            loaded.add_scene_program(line.source, scene.roots, scene.find_span("crowd", number, "from"))
    if not scene.model.crowd:
        report.error(
            "no-crowd",
            "the scene has no crowd, so there is nothing to simulate",
            scene.find_span("antdsl", key=True),
            _MISSING_CROWD_HELP,
        )
    program, findings = _check_loaded_sources(loaded, strict)
    report.extend(findings)
    if program is not None and findings.ok:
        report.extend(match_scene(scene, program))
        read_overrides(scene, program, select_params(choices.params), report)
        report.extend(check_until(scene, loaded, is_option=choices.until is not None))
    return scene, program, loaded, report


def _notify_format_reader(scene: Scene) -> None:
    """Tell the reader of foreign formats that a new scene starts. If the scene has things from USD files, the reader loads the
    USD library while the programs are checked."""
    if "antdsl.reader.client" in sys.modules:
        from antdsl.reader import client

        client.begin_scene()
    if any(getattr(thing, "usd", None) for thing in (*scene.model.world.values(), *scene.model.named_cameras.values())):
        from antdsl.reader import client

        client.start_reader_early("usd")


_MISSING_CROWD_HELP = "add `crowd:` and below it `  - {species: NAME, from: FILE.ant, count: 100, place: {on: SURFACE}}`"


def simulate(shot: Shot, options: Options | None = None) -> Iterator[World]:
    """Simulate a shot. Yield the world at each frame from first to last, after the preroll. Each time, this is the same World
    object."""
    from antdsl.runtime import bind, step

    world = bind(shot.plan, shot.setting, options)
    for _ in range(shot.scene.model.preroll):
        step(world)
    yield world
    for _ in range(shot.frames.first, shot.frames.last):
        step(world)
        yield world


def check_scene_text(
    path: Path, texts: Mapping[Path, bytes], *, parsed: ParsedFileCache | None = None
) -> tuple[Scene | None, Program | None, Report]:
    """Check a scene as in an editor, with its programs and bodies. Return the scene, the program and a report. Scene and program
    are None if errors prevent them.

    The findings are those of `check_path`, except those about the meshes of the world. `texts`: texts that override scene files
    on disk: this scene, and the scenes that it extends."""
    from antdsl.bodies.crowd_bodies import load_crowd_bodies

    scene, program, _, report = _read_scene(path, RunChoices(), parsed=parsed, data=texts[path], texts=texts)
    if scene is not None and program is not None and report.ok:
        report.extend(load_crowd_bodies(scene, program)[1])
    return scene, program, report


def check_path(
    path: Path,
    choices: RunChoices | None = None,
    *,
    strict: bool = False,
    parsed: ParsedFileCache | None = None,
    specs: bool = True,
) -> tuple[Program | None, Report]:
    """Check a file without simulating it. It is a program, or a scene with its programs and meshes. Return (program, report). The
    program is None if errors prevent it. `parsed`: a cache for checking many files. With it, findings about a program have the
    same location, whichever file names the program. `specs`: whether to check that the scenes of the program's specs exist."""
    from antdsl.scene.checks.existence_checks import check_spec_scenes

    choices = choices or RunChoices()
    if path.suffix == ".ant":
        program, report = compile_files([path], strict=strict, parsed=parsed)
        report.extend(check_spec_scenes(program, choices.grants) if specs else ())
        return program, report
    scene, program, _, report = _read_scene(path, choices, strict, parsed)
    report.extend(check_spec_scenes(program, choices.grants) if specs else ())
    setting = None
    if scene is not None and program is not None and report.ok and scene.model.world:
        from antdsl.bodies.crowd_bodies import load_crowd_bodies
        from antdsl.scene.notes.notes_model import GOAL_VERBS
        from antdsl.scene.overrides import read_overrides
        from antdsl.scene.scene_values import select_params
        from antdsl.scene.staging.stage_scene import build_setting

        setting, findings, _ = build_setting(
            scene, program, read_overrides(scene, program, select_params(choices.params), Report())
        )
        report.extend(findings)
        report.extend(load_crowd_bodies(scene, program)[1])
        if report.ok and any(note.verb in GOAL_VERBS for note in scene.model.notes):
            report.extend(_find_far_targets(path, choices, parsed))
    if scene is not None and program is not None:
        report.drop_warnings(_find_stale_attribute_warnings(report, scene, program, setting))
    return program, report


def _find_far_targets(path: Path, choices: RunChoices, parsed: ParsedFileCache | None) -> Report:
    """Return the warnings about targets of notes that are far away. To find these, the agents of the scene are placed."""
    from antdsl.runtime import Options, bind
    from antdsl.runtime.notes.target_findings import find_far_targets

    shot, _ = open_scene(path, choices, parsed=parsed)
    return Report() if shot is None else find_far_targets(shot.scene, bind(shot.plan, shot.setting, Options(backend="numpy")))


def read_mesh_imports(path: Path, choices: RunChoices) -> tuple[Mapping[str, MeshImport], str]:
    """Return the import report of each readable mesh of a scene by name, and the scene's unit. Other errors in the scene are
    ignored."""
    from antdsl.scene.staging.stage_scene import collect_import_reports

    scene, program, _, _ = _read_scene(path, choices)
    return ({}, "mm") if scene is None or program is None else (collect_import_reports(scene, program), scene.model.units)


def _find_stale_attribute_warnings(
    report: Report, scene: Scene, program: Program, setting: WorldSetting | None
) -> list[Diagnostic]:
    """Return those warnings about attributes that do not apply to a scene.

    The warning that an attribute is constant does not apply if the scene sets it for some agents at the start. The warning that
    an attribute is never read does not apply if the scene writes it to the cache."""
    initial_attributes = setting.initial_attributes if setting is not None else {}
    initial_spans = [a.span for name, of in initial_attributes.items() for a in program.species[name].attributes if a.name in of]
    output = scene.model.output.attributes
    written = [a.span for species in program.species.values() for a in species.attributes if a.name in output]
    spans = {"constant-attribute": initial_spans, "unread-attribute": written}
    return [d for d in report.diagnostics if d.span in spans.get(d.code, ())]
