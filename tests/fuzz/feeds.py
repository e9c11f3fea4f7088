"""Feed functions of texts, scenes, meshes, images, bodies and USD: each puts one input where a person would have it, reads it by
the chain of `antdsl check` or `antdsl body`, and returns the report as text."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from zlib import crc32

from cases.hostile.meshes import OBJ
from cases.hostile.rows import PROJECT, SCENE
from fuzz.oracle import Feed, Violation

from antdsl import passes, plan, syntax
from antdsl.bodies.files.reading import read_definition
from antdsl.diagnostics import Diagnostic, Report
from antdsl.limits import MIB
from antdsl.pipeline import check_path, open_scene
from antdsl.runtime import BindError, Options, bind, state_hash, step
from antdsl.scene.geometry.mesh_files import MeshError, read_mesh
from antdsl.source import Source

BOUND_AGENTS = 2000  # in a scene that is also bound and stepped
BOUND_CELLS = 200_000  # of its fields and solids


def report_text(report: Report | Iterable[Diagnostic], located: bool = True) -> str:
    """A report as text. Violation where a message has control characters, an empty code, or an error has no place."""
    lines = []
    for each in report.diagnostics if isinstance(report, Report) else report:
        for words in (each.message, each.help or ""):
            if not words.replace("\n", " ").isprintable():
                raise Violation("message", f"{each.code}: not printable: {words[:200]!r}")
        if len(each.message) > 2000 or not each.message or not each.code:
            raise Violation("message", f"{each.code}: {len(each.message)} characters: {each.message[:200]}")
        if located and each.severity == "error" and each.span is None:
            raise Violation("place", f"{each.code}: no place: {each.message[:200]}")
        lines.append(f"{each.severity} {each.code} {each.span} {each.message} / {each.help}")
    return "\n".join(lines)


def feed_text(folder: Path) -> Feed:
    """A program: check, lower and optimise it, and lay it out twice."""
    path = folder / "a.ant"

    def feed(data: bytes) -> str:
        path.write_bytes(data)
        program, report = check_path(path, strict=True)
        text = report_text(report)
        also = crc32(data) % 4  # what takes longest is done for a part of the inputs, chosen by their bytes
        if program is not None and report.ok and also < 2:
            lowered, findings = plan.lower(program)
            text += "\nplan " + report_text(findings)
            if findings.ok:
                text += f" {len(passes.optimise_plan(lowered).nodes)} nodes" if hasattr(lowered, "nodes") else ""
        source, _ = syntax.read_program_file(path)
        if source is not None:
            text += _layout(path, source, report, check=also == 0)
        return text

    return feed


def _layout(path: Path, source: Source, report: Report, check: bool) -> str:
    """Lay a program out twice; with `check`, also hold the errors of the result against those of the source."""
    layout, findings = syntax.format(source)
    if layout is None:
        return "\nno layout " + report_text(findings)
    again, _ = syntax.format(Source(source.path, layout))
    if again != layout:
        raise Violation("layout", f"a second layout differs:\n{layout[:1000]}\n---\n{(again or '')[:1000]}")
    if not check:
        return f"\nlayout of {len(layout)} characters"
    path.write_text(layout, encoding="utf-8", errors="surrogatepass", newline="\n")
    _, next_report = check_path(path, strict=True)
    codes, codes_after = (sorted(d.code for d in each.diagnostics if d.severity == "error") for each in (report, next_report))
    if codes != codes_after:
        raise Violation("layout", f"other errors after the layout: {codes} and {codes_after}")
    return f"\nlayout of {len(layout)} characters"


def feed_scene(folder: Path) -> Feed:
    """A scene among the files of a project: open it, and where it is small, bind it and make two steps."""
    for name, data in scene_files().items():
        (folder / name).write_bytes(data)
    path = folder / "scene.yaml"

    def feed(data: bytes) -> str:
        path.write_bytes(data)
        _, report = check_path(path)
        text = report_text(report)
        shot, opened = open_scene(path)
        if report.ok != opened.ok and shot is None and report.ok:
            text += "\nopened " + report_text(opened)
        if shot is None or sum(line.count or 0 for line in shot.scene.model.crowd) > BOUND_AGENTS:
            return text
        try:
            world = bind(shot.plan, shot.setting, Options(backend="numpy"))
        except BindError as why:
            return text + "\nbind " + report_text(why.report)
        for _ in range(2):
            step(world)
        return f"{text}\nstate {len(world)} {state_hash(world)}"

    return feed


def scene_files() -> dict[str, bytes]:
    """The files that the seeds of scenes name."""
    return {**{name: data for name, data in PROJECT.items() if isinstance(data, bytes)}, "ground.obj": OBJ}


def feed_mesh(ending: str) -> Callable[[Path], Feed]:
    """A mesh file: its triangles, or the documented error."""

    def start(folder: Path) -> Feed:
        def feed(data: bytes) -> str:
            try:
                mesh = read_mesh(data, f"a.{ending}")
            except MeshError as why:
                if not str(why).isprintable() or len(str(why)) > 400:
                    raise Violation("message", repr(str(why))[:300]) from None
                if why.__cause__ is not None:
                    raise why.__cause__ from None  # a reader that does not know what is wrong
                return f"refused {why}"
            if not len(mesh.faces) or mesh.faces.max() >= len(mesh.vertices) or mesh.faces.min() < 0:
                raise Violation("mesh", "a face names a vertex that is not there")
            return f"read {len(mesh.vertices)} {len(mesh.faces)} {mesh.dropped_faces} {mesh.vertices.sum()}"

        return feed

    return start


def feed_ground(name: Callable[[bytes], str], value: str) -> Callable[[Path], Feed]:
    """A file that a scene names as its ground: check the scene. `name` chooses the file's name by its content; `value` is the
    ground in the scene, with `FILE` for the name."""

    def start(folder: Path) -> Feed:
        for each, data in scene_files().items():
            (folder / each).write_bytes(data)
        path = folder / "scene.yaml"

        def feed(data: bytes) -> str:
            file = name(data)
            (folder / file).write_bytes(data)
            path.write_bytes(SCENE.replace(b"{mesh: ground.ply}", value.replace("FILE", file).encode()))
            _, report = check_path(path)
            (folder / file).unlink()
            return report_text(report)

        return feed

    return start


def usd_name(data: bytes) -> str:
    """USD has 3 forms: the beginning of a file tells which it is."""
    return "set.usdc" if data.startswith(b"PXR-USDC") else "set.usdz" if data.startswith(b"PK") else "set.usda"


def gltf_name(data: bytes) -> str:
    return "set.glb" if data.startswith(b"glTF") else "set.gltf"


def image_name(data: bytes) -> str:
    kinds = ((b"\x89PNG", "png"), (b"PK", "npz"), (b"II", "tif"), (b"MM", "tif"))
    return "map." + next((ending for start, ending in kinds if data.startswith(start)), "png")


def feed_gltf(folder: Path) -> Feed:
    """A glTF or GLB body alone."""

    def feed(data: bytes) -> str:
        path = folder / gltf_name(data)
        path.write_bytes(data)
        return _body_text(path)

    return feed


def feed_clip(folder: Path) -> Feed:
    """A clip of Houdini that a definition names."""
    (folder / "rig.json").write_text('{"rig_version": 1, "transforms": {"root": ["hand"], "hand": []}}')
    (folder / "body.json").write_text(
        '{"antdsl_body": 1, "length": 1, "rig": {"file": "rig.json"}, "clips": [{"file": "part.clip"}]}'
    )

    def feed(data: bytes) -> str:
        (folder / "part.clip").write_bytes(data)
        return _body_text(folder / "body.json")

    return feed


def feed_body(folder: Path) -> Feed:
    """A definition file, or a part of one: a clip, layer, group or rig by its keys."""
    import gltf_bodies

    tree, data = gltf_bodies.arm()
    (folder / "arm.glb").write_bytes(gltf_bodies.binary(tree, data))
    (folder / "sword.obj").write_bytes(b"v 0 0 0\nv 10 0 0\nv 0 4 0\nf 1 2 3\n")
    (folder / "rig.json").write_text('{"rig_version": 1, "transforms": {"root": ["hand"], "hand": []}}')
    parts = {
        b'"antdsl_body"': '{"antdsl_body": 1, "length": 1, "rig": {"file": "part.json"}}',
        b'"antdsl_clip"': '{"antdsl_body": 1, "length": 1, "rig": {"file": "rig.json"}, "clips": [{"file": "part.json"}]}',
        b'"static"': '{"antdsl_body": 1, "length": 1, "rig": {"file": "rig.json"}, "layers": [{"file": "part.json"}]}',
        b'"members"': '{"antdsl_body": 1, "length": 1, "rig": {"file": "rig.json"}, "groups": [{"file": "part.json"}]}',
    }

    def feed(data: bytes) -> str:
        (folder / "part.json").write_bytes(data)
        if b'"antdsl_body"' in data:
            return _body_text(folder / "part.json")
        document = next((text for key, text in parts.items() if key in data), parts[b'"antdsl_body"'])
        (folder / "body.json").write_text(document)
        return _body_text(folder / "body.json")

    return feed


def _body_text(path: Path) -> str:
    body, report = read_definition(path)
    text = report_text(report, located=False)
    if body is None and report.ok:
        raise Violation("report", "no body, and no error that says why")
    if body is None:
        return text
    points = sum(len(shape.points) for shape in body.shapes.values()) if body.shapes else 0
    size = sum(clip.rotation.nbytes for clip in body.clips.values())
    if size > 256 * MIB:
        raise Violation("memory", f"clips of {size} bytes from {path.stat().st_size} bytes")
    return f"{text}\nbody {len(body.rig.names)} joints {points} points {list(body.clips)} {list(body.layers)} {size}"
