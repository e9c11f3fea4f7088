"""The chain on one page: text → tree → program → plan, scene → setting, both → a world that steps.

Every stage gives `(result, Report)`; a result is None where its errors leave nothing to go on with."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from antdsl import __version__, limits
from antdsl.bounded import read_start, real_path
from antdsl.diagnostics import Fix, Report
from antdsl.loading import CheckedOnce, Loaded, Parsed, shown
from antdsl.source import Source

if TYPE_CHECKING:
    from antdsl.plan.ir import Plan
    from antdsl.program.expectations import Changed
    from antdsl.program.memo import Memo
    from antdsl.program.model import Program
    from antdsl.runtime import Options, World
    from antdsl.scene import Scene
    from antdsl.scene.quantities import Quantity
    from antdsl.scene.setting import Setting
    from antdsl.scene.values import FrameRange

SKIPPED_FOLDERS = frozenset(["node_modules", "__pycache__", "out", "build", "dist", "_data"])


@dataclass(frozen=True, slots=True)
class Choices:
    """What the person who runs a scene says besides it: roots granted, and values that go before the scene's own."""

    grants: Mapping[str, Path] = field(default_factory=dict)
    frames: FrameRange | None = None
    seed: int | None = None
    params: Mapping[str, str] = field(default_factory=dict)
    changes: tuple[Changed, ...] = ()  # what a spec sets besides: params and settings of fields


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A scene that is ready to be simulated. `inputs` has a hash for all that the result depends on, by name; `loaded` are the
    texts that the program was made of."""

    scene: Scene
    program: Program
    plan: Plan
    setting: Setting
    inputs: Mapping[str, str]
    loaded: Loaded

    @property
    def frames(self) -> FrameRange:
        return self.scene.model.frames


def compile_files(
    paths: Iterable[Path | str], *, strict: bool = False, parsed: Parsed | None = None, memo: Memo | None = None
) -> tuple[Program | None, Report]:
    """Parse and check programs together, with the library and all files that they use. `strict` adds what only `check --strict`
    tells; `parsed` and `memo` keep what was parsed and checked, for the next call."""
    paths = [Path(path) for path in paths]
    loaded = Loaded(real_path(paths[0]).parent if paths else Path.cwd(), parsed={} if parsed is None else parsed)
    for path in paths:
        loaded.add_file(path)
    return _checked(loaded, strict, memo)


def _checked(loaded: Loaded, strict: bool, memo: Memo | None = None) -> tuple[Program | None, Report]:
    from antdsl.program import check

    report = Report()
    if not loaded.files:
        report.extend(loaded.report)
        return None, report
    # files are the same objects as long as they are in `parsed`; names of modules are read from their texts
    key = (strict, *(id(file) for file in loaded.files), *((name, id(file)) for name, file in sorted(loaded.modules.items())))
    kept = loaded.parsed.checked if isinstance(loaded.parsed, CheckedOnce) else {}
    if key not in kept:
        kept[key] = check(loaded.files, loaded.library, loaded.modules, strict=strict, memo=memo)
    program, findings = kept[key]
    report.extend(loaded.report)
    report.extend(findings)
    return program, report


def open_scene(
    path: Path | str, choices: Choices | None = None, *, parsed: Parsed | None = None, thorough: bool = True
) -> tuple[Shot | None, Report]:
    """Everything from a scene's file to a shot: read, compile, match, lower, optimise, stage. `parsed` as in `compile_files`,
    `thorough` as in `passes.optimise`."""
    path = Path(path)
    from antdsl import passes, plan
    from antdsl.scene.adjusting import with_fields
    from antdsl.scene.matching import layer_order
    from antdsl.scene.staging.stage_scene import stage

    choices = choices or Choices()
    scene, program, loaded, report = _read_scene(path, choices, parsed=parsed)
    if scene is None or program is None or not report.ok:
        return None, report
    overrides = _overrides(scene, program, choices, Report())
    program = with_fields(program, scene, {**scene.model.set, **overrides})
    program = _with_fields(program, choices.changes)
    orders = {name: order for name in scene.model.layers if (order := layer_order(scene, program, name)[0]) is not None}
    lowered, findings = plan.lower(program, orders=orders)
    report.extend(findings)
    if not report.ok:
        return None, report
    setting, findings, meshes = stage(scene, program, overrides)
    report.extend(findings)
    if setting is None or not report.ok:
        return None, report
    setting = _with_params(setting, scene, program, choices.changes)
    inputs = {"antdsl": __version__, "scene": _digest(repr(_result_relevant(scene))), **loaded.hashes(), **meshes}
    inputs |= {f"--set {name}": text for name, text in choices.params.items()}
    inputs |= {f"set {change.name}": change.value.span.text for change in choices.changes}
    return Shot(scene, program, passes.optimise(lowered, thorough=thorough), setting, inputs, loaded), report


def _with_fields(program: Program, changes: Iterable[Changed]) -> Program:
    """The program with other settings of its fields; of the ways to fade there is one."""
    from antdsl.scene.adjusting import FADING

    fields = dict(program.fields)
    for change in changes:
        name, _, word = change.name.partition(".")
        if name in fields and change.name not in program.params:
            faded: dict[str, Any] = dict.fromkeys(FADING) if word in FADING else {}
            fields[name] = replace(fields[name], **{**faded, word: change.value})
    return replace(program, fields=fields)


def _with_params(setting: Setting, scene: Scene, program: Program, changes: Iterable[Changed]) -> Setting:
    from antdsl.program.types.folding import constant_behind
    from antdsl.scene.matching import const_base

    known = {change.name: constant_behind(change.value) for change in changes if change.name in program.params}
    changed = {name: const_base(value, scene) for name, value in known.items() if value is not None}
    return replace(setting, params={**setting.params, **changed}) if changed else setting


def _read_scene(
    path: Path,
    choices: Choices,
    strict: bool = False,
    parsed: Parsed | None = None,
    data: bytes | None = None,
    texts: Mapping[Path, bytes] | None = None,
) -> tuple[Scene | None, Program | None, Loaded, Report]:
    """The scene, the programs of its crowd checked together, and how they match."""
    from antdsl.scene import load
    from antdsl.scene.load import load_text
    from antdsl.scene.matching import match
    from antdsl.scene.paths import Roots

    if data is None:
        scene, report = load(path, choices.grants)
    else:
        scene, report = load_text(data, str(path), Roots(real_path(path).parent, dict(choices.grants)), texts)
    loaded = Loaded(real_path(path).parent, parsed={} if parsed is None else parsed)
    if scene is None:
        return None, None, loaded, report
    scene = scene.changed(frames=choices.frames, seed=choices.seed)
    for number, line in enumerate(scene.model.crowd):
        if line.source not in {other.source for other in scene.model.crowd[:number]}:
            loaded.add_named(line.source, scene.roots, scene.span("crowd", number, "from"))
    if not scene.model.crowd:
        report.error(
            "no-crowd", "the scene has no crowd, so there is nothing to simulate", scene.span("antdsl", key=True), _CROWD_HELP
        )
    program, findings = _checked(loaded, strict)
    report.extend(findings)
    if program is not None and findings.ok:
        report.extend(match(scene, program))
        _overrides(scene, program, choices, report)
    return scene, program, loaded, report


_CROWD_HELP = "add `crowd:` and below it `  - {species: NAME, from: FILE.ant, count: 100, place: {on: SURFACE}}`"


def _overrides(scene: Scene, program: Program, choices: Choices, report: Report) -> Mapping[str, Quantity]:
    from antdsl.scene.matching import check_param
    from antdsl.scene.quantities import BadQuantity, parse_quantity

    found = {}
    for name, text in choices.params.items():
        try:
            found[name] = parse_quantity(text)
        except BadQuantity as why:
            usual = "write a number and a unit: `--set NAME=50mm`"
            report.error("wrong-value", f"`--set {name}={text}`: `{text}` {why}", None, why.help or usual)
            continue
        check_param(scene, program, report, name, found[name])
    return found


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _result_relevant(scene: Scene) -> object:
    """The scene less what changes no result: output, a camera that no level of detail goes by, and the last frame, so that a
    cache can be continued past it."""
    without = {"output", "frames", "extends"} | ({"camera"} if scene.model.lod is None else set())
    kept = sorted(set(type(scene.model).model_fields) - without)
    values = [(name, getattr(scene.model, name)) for name in kept if name != "crowd"]
    return [*values, *((line.species, line.count, line.place) for line in scene.model.crowd), scene.model.frames.first]


def simulate(shot: Shot, options: Options | None = None) -> Iterator[World]:
    """Step through a shot: the world at each frame from first to last, the preroll done before the first. The same World
    each time."""
    from antdsl.runtime import bind, step

    world = bind(shot.plan, shot.setting, options)
    for _ in range(shot.scene.model.preroll):
        step(world)
    yield world
    for _ in range(shot.frames.first, shot.frames.last):
        step(world)
        yield world


def crowding(shot: Shot, world: World) -> Report:
    """Warnings for lines of the crowd whose place had no room for all when the world was bound, each at the line's place. Of one
    that lies beside all surfaces was told before."""
    from antdsl.scene.staging.item_placement import beside

    report, scene, setting = Report(), shot.scene, shot.setting
    for line in world.crowded:
        if beside(setting.crowds[line.group].place, setting.surfaces, setting.solids, scene.model.up):
            continue
        low, high = (f"{radius:.3g}" for radius in line.radius)
        wide = f"{low} mm" if low == high else f"{low} to {high} mm"
        cover = f"{line.cover:,.0f} mm²" if line.area is None else f"{line.cover:,.0f} of {line.area:,.0f} mm²"
        words = f"only {line.fit:,} of {line.count:,} `{line.species}` find room where they begin"
        words += f": with a radius of {wide} they cover {cover}"
        place = scene.model.crowd[line.group].place
        help = "write a smaller `count`, or a smaller `radius` in the program"
        if line.larger is not None:
            larger = f"`radius: {_rounded_up(line.larger / scene.model.unit_mm)} {scene.model.units}`"
            help = f"write {larger}, a smaller `count`, or a smaller `radius` in the program"
        elif line.sides:
            help = "cover its sides and its underside too with `by: area`, or write a smaller `count`"
        elif place.inside is not None or place.density is not None:
            help = "write a larger place, a smaller `count`, or a smaller `radius` in the program"
        report.warning("no-room", words, scene.span("crowd", line.group, "place"), help)
    return report


def _rounded_up(value: float) -> str:
    """To two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:g}"


def check_scene_text(
    path: Path, texts: Mapping[Path, bytes], *, parsed: Parsed | None = None
) -> tuple[Scene | None, Program | None, Report]:
    """A scene as an editor holds it, with its programs: all of `check_path` but what the meshes themselves would tell. `texts`
    are the scenes that go before what is on disk: this one, and those that it extends."""
    scene, program, _, report = _read_scene(path, Choices(), parsed=parsed, data=texts[path], texts=texts)
    return scene, program, report


def check_path(
    path: Path, choices: Choices | None = None, *, strict: bool = False, parsed: Parsed | None = None, specs: bool = True
) -> tuple[Program | None, Report]:
    """All that can be known about one file without running it: a program by itself, or a scene with its programs and meshes.
    With one `parsed` for many files, what is wrong with a program is at the same place whoever names it. `specs`: also whether
    the scenes are there that its specs run on."""
    choices = choices or Choices()
    if path.suffix == ".ant":
        program, report = compile_files([path], strict=strict, parsed=parsed)
        report.extend(spec_scenes(program, choices.grants) if specs else ())
        return program, report
    scene, program, _, report = _read_scene(path, choices, strict, parsed)
    report.extend(spec_scenes(program, choices.grants) if specs else ())
    if scene is not None and program is not None and report.ok and scene.model.world:
        from antdsl.scene.staging.stage_scene import stage

        report.extend(stage(scene, program, _overrides(scene, program, choices, Report()))[1])
    return program, report


def spec_scenes(program: Program | None, grants: Mapping[str, Path] | None = None) -> Report:
    """Complaints about scenes that specs name and that are not there, one for each with all its places. The files are not
    read."""
    from antdsl.program.consequences import in_one
    from antdsl.scene.paths import PathRefused, Roots

    report = Report()
    named = (text for spec in (program.specs if program else ()) for text in (spec.scene, spec.against and spec.against.scene))
    for text in named:
        if text is None or not text.text.endswith((".yaml", ".yml")):
            continue
        roots = Roots(Path(text.span.source.path).resolve().parent, grants or {})
        try:
            roots.exists(text.text)
        except PathRefused as refused:
            near = _MEANT.fullmatch(refused.help or "")
            fix = Fix(text.span, f'"{near[1]}"') if near and "/" not in text.text else None
            advice = refused.help or "name a scene that lies beside this program or below its folder"
            report.error(refused.code, str(refused), text.span, advice, fix=fix)
    return in_one(report)


_MEANT = re.compile(r"did you mean `([^`]+)`\?")


def find_files(paths: Iterable[Path]) -> tuple[list[Path], Report]:
    """The programs and scenes that paths mean: files as they are, patterns such as `shots/**/*.ant` by what they match, folders
    searched without following links, hidden ones left out."""
    import os

    found: dict[Path, None] = {}
    report = Report()
    for path in _matched(paths, report):
        if not path.is_dir():
            if path.suffix in (".ant", ".yaml", ".yml"):
                found[path] = None
            else:
                report.error("no-such-file", f"`{shown(path)}` is neither a program (.ant), a scene (.yaml) nor a folder", None)
            continue
        for folder, inner, files in os.walk(path, followlinks=False):
            inner[:] = sorted(name for name in inner if not name.startswith(".") and name not in SKIPPED_FOLDERS)
            for name in sorted(files):
                file = Path(folder, name)
                if name.endswith(".ant") or (name.endswith((".yaml", ".yml")) and _is_scene(file)):
                    found[file] = None
    return list(found), report


def _matched(paths: Iterable[Path], report: Report) -> Iterator[Path]:
    """The paths, patterns replaced by what they match. What is there by that very name is no pattern."""
    from glob import glob, has_magic

    for path in paths:
        if path.exists() or not has_magic(str(path)):
            yield path
            continue
        found = [Path(name) for name in sorted(glob(str(path), recursive=True))]
        wanted = [each for each in found if each.is_dir() or each.suffix in (".ant", ".yaml", ".yml")]
        if not wanted:
            report.error("no-such-file", f"`{path}` matches no program (.ant), no scene (.yaml) and no folder", None)
        yield from wanted


def sources(files: Iterable[Path], parsed: Parsed) -> list[Source]:
    """The texts of checked files, as far as they can be read: programs as they were parsed, and scenes."""
    from antdsl.scene.document import decode
    from antdsl.scene.paths import PathRefused, read_named

    found = [file.source for file, _ in parsed.values() if not file.source.path.startswith("<")]
    for path in files:
        if path.suffix != ".ant":
            try:
                source, report = decode(read_named(path, limits.SCENE_BYTES), str(path))
            except PathRefused:
                continue
            found += [source] if report.ok else []
    return found


def _is_scene(path: Path) -> bool:
    """Whether a YAML file begins like a scene; a folder may hold others."""
    try:
        lines = read_start(path, 4096).removeprefix(b"\xef\xbb\xbf").splitlines()
    except OSError:
        return False
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith(b"#")), b"")
    return first.startswith(b"antdsl:")
