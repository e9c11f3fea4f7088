"""State machines as pictures: what is in a chart, that a layout can be read, and that every format says the same each time."""

from __future__ import annotations

import io
import random
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from itertools import combinations
from pathlib import Path

import pytest
from children import child_environment

from antdsl import graphs, pipeline
from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.graphs.drawing import Drawing, TextLine, draw_charts
from antdsl.graphs.layout import NAME_FONT_SIZE, WORD_FONT_SIZE, lay_out_charts
from antdsl.graphs.model import Chart, PlacedBox, PlacedChart
from antdsl.graphs.png import MAX_PIXELS, render_png
from antdsl.graphs.text_width import measure_text_width

ROOT = Path(__file__).resolve().parents[2]
FORAGER = ROOT / "examples" / "foraging" / "forager.ant"
COLONY = ROOT / "tests" / "programs" / "colony.ant"

ODD = """ant 1
use steering
species bug {
  fear = 0
  start idle
  from any when fear > 3 and (fear < 9  # a comment
    or fear > 11) -> flee
  from any except rest, flee when fear > 2 held 1 s -> previous { fear = 0 }
  state idle "<b>`x`</b> & 50 % #1; *a* été" amber for at least 2 s {
    steer wander()
    when chance 20 %/s -> choose { rest: 2; roam: 1 }
    interrupt when fear > 5 -> flee
    when after 3 s -> rest
    when fear > 1 -> rest
    when fear < -1 -> idle
  }
  state rest "" { when after 1 s -> previous; when fear > 1 -> idle }
  state roam { when after 1 s -> idle }
  state flee red { when fear < 1 -> idle; interrupt when fear < -9 -> roam }
  machine mood {
    start calm
    state calm { when fear > 1 -> upset }
    state upset { when fear < 1 -> calm }
  }
  layers { state }
}
"""


def charts_of(path: Path) -> tuple[Chart, ...]:
    program, report = pipeline.check_path(path)
    assert program is not None and report.ok, report.errors
    return graphs.build_charts(program)


@pytest.fixture(scope="module")
def odd_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("odd") / "odd.ant"
    path.write_text(ODD, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def odd(odd_file: Path) -> tuple[Chart, ...]:
    return charts_of(odd_file)


def said(chart: Chart) -> list[tuple[str, str, tuple[str, ...], bool]]:
    names = {box.key: box.name or box.kind for box in chart.boxes}
    return [(names[a.source], names[a.target], a.lines, a.interrupt) for a in chart.arrows]


# --- what is in a chart ----------------------------------------------------------------------------------------------


def test_a_chart_has_the_states_and_changes_of_the_text() -> None:
    (chart,) = charts_of(FORAGER)
    assert chart.title == "forager"
    assert [box.name for box in chart.boxes if box.kind == "state"] == [
        "search", "turn_home", "approach", "carry", "set_out", "follow_trail",
    ]  # fmt: skip
    assert said(chart)[0] == ("start", "search", (), False)
    assert ("approach", "carry", ("1: touching(meal) take 1 load from meal",), False) in said(chart)
    assert ("approach", "search", ("2: no meal held 0.5 s",), False) in said(chart)
    assert ("follow_trail", "turn_home", ("3: after patience",), False) in said(chart)
    assert ("carry", "set_out", ("touching(nest)",), False) in said(chart)
    assert len(chart.arrows) == 1 + len(re.findall(r"^    when .*->", FORAGER.read_text(encoding="utf-8"), re.M))
    arrow = next(a for a in chart.arrows if a.lines == ("1: touching(meal) take 1 load from meal",))
    lines = FORAGER.read_text(encoding="utf-8").splitlines()
    (line,) = (number for number, text in enumerate(lines, 1) if "when touching(meal)" in text)
    assert arrow.details == f"forager.ant:{line}: when touching(meal) take 1 load from meal -> carry {{ source = meal }}"


def test_any_previous_choose_interrupts_and_machines_are_drawn_once_each(odd: tuple[Chart, ...]) -> None:
    assert [chart.title for chart in odd] == ["bug.main", "bug.mood"]
    assert set(said(odd[0])) == {
        ("start", "idle", (), False),
        ("idle", "flee", ("1: interrupt when fear > 5",), True),
        ("idle", "choice", ("2: chance 20 %/s",), False),
        ("choice", "rest", ("2",), False),
        ("choice", "roam", ("1",), False),
        ("idle", "rest", ("3: after 3 s", "4: fear > 1"), False),
        ("idle", "idle", ("5: fear < -1",), False),
        ("rest", "previous", ("1: after 1 s",), False),
        ("rest", "idle", ("2: fear > 1",), False),
        ("roam", "idle", ("after 1 s",), False),
        ("flee", "roam", ("1: interrupt when fear < -9",), True),
        ("flee", "idle", ("2: fear < 1",), False),
        ("any state", "flee", ("1: fear > 3 and (fear < 9 or fear > 11)",), False),
        ("any but rest, flee", "previous", ("2: fear > 2 held 1 s",), False),
    }
    idle = next(box for box in odd[0].boxes if box.name == "idle")
    assert idle.label == "<b>`x`</b> & 50 % #1; *a* été · for at least 2 s"
    assert tuple(round(part * 255) for part in idle.colour) == (242, 163, 31)


# --- that it can be read ---------------------------------------------------------------------------------------------


def machine(states: int, seed: int) -> str:
    """A program with so many states and changes here and there, drawn at random."""
    author = random.Random(seed)
    names = [f"state_{author.choice(['a', 'long_name_of_a', 'x'])}{k}" for k in range(states)]
    lines = ["ant 1", "use steering", "species bug {", "  fear = 0", f"  start {names[0]}"]
    if author.random() < 0.7:
        lines.append(f"  from any when fear > 90 -> {author.choice(names)}")
    for k, name in enumerate(names):
        lines.append(f'  state {name} "Does {"this and that " * author.randint(0, 2)}" {{')
        for target in {names[(k + 1) % states], *author.sample(names, author.randint(0, min(2, states)))}:
            mark = author.choice(["", "", "", "interrupt "])
            condition = " and ".join(f"fear > {author.randint(0, 99)}" for _ in range(author.randint(1, 4)))
            lines.append(f"    {mark}when {condition} -> {target}")
        lines.append("  }")
    return "\n".join([*lines, "  layers { state }", "}", ""])


def touch(one: PlacedBox, other: PlacedBox) -> bool:
    return (
        abs(one.centre[0] - other.centre[0]) < (one.width + other.width) / 2
        and abs(one.centre[1] - other.centre[1]) < (one.height + other.height) / 2
    )


def assert_can_be_read(chart: PlacedChart) -> None:
    """Nothing lies on anything else, all of it is inside, words fit, and each arrow goes from its box to its box."""
    words = [arrow.words for arrow in chart.arrows if arrow.words is not None]
    boxes = [place for _, place in chart.boxes]
    assert not [pair for pair in combinations([*boxes, *words], 2) if touch(*pair)]
    for place in [*boxes, *words]:
        assert place.left >= 0 and place.top >= 0
        assert place.left + place.width <= chart.width and place.top + place.height <= chart.height
    for box, place in chart.boxes:
        if box.kind == "state":
            assert max(measure_text_width(box.name, NAME_FONT_SIZE), measure_text_width(box.label, WORD_FONT_SIZE)) < place.width
    where = {box.key: place for box, place in chart.boxes}
    for arrow in chart.arrows:
        assert bool(arrow.words) == bool(arrow.arrow.lines)
        for point, key in ((arrow.points[0], arrow.arrow.source), (arrow.points[-1], arrow.arrow.target)):
            place = where[key]
            assert touch(place, PlacedBox(point, 2, 2)), (arrow.arrow, point, place)
        if arrow.words is not None:
            assert max(measure_text_width(line, WORD_FONT_SIZE) for line in arrow.lines) < arrow.words.width
            near = PlacedBox(arrow.words.centre, arrow.words.width + 8, arrow.words.height + 8)
            assert any(
                touch(near, PlacedBox(((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), abs(a[0] - b[0]) + 1, abs(a[1] - b[1]) + 1))
                for a, b in zip(arrow.points, arrow.points[1:], strict=False)
            ), "words far from their arrow"


def crossed(chart: PlacedChart) -> int:
    """How many lines pass below words of others."""
    return sum(
        touch(arrow.words, PlacedBox(((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), abs(a[0] - b[0]), abs(a[1] - b[1])))
        for arrow in chart.arrows
        if arrow.words is not None
        for other in chart.arrows
        if other is not arrow
        for a, b in zip(other.points, other.points[1:], strict=False)
    )


@pytest.mark.parametrize("path", [FORAGER, ROOT / "examples" / "anthill" / "builder.ant"], ids=lambda p: p.stem)
def test_charts_of_few_states_have_no_overlaps(path: Path) -> None:
    (chart,), report = lay_out_charts(charts_of(path))
    assert report.ok
    assert_can_be_read(chart)
    assert crossed(chart) == 0


def test_charts_of_twenty_five_states_have_few_overlaps() -> None:
    (chart,), _ = lay_out_charts(charts_of(COLONY))
    assert sum(box.kind == "state" for box, _ in chart.boxes) == 25
    assert_can_be_read(chart)
    assert crossed(chart) <= 2
    assert chart.width < 2400 and chart.height < 1600


def test_unusual_machines_are_drawn_in_rows(odd: tuple[Chart, ...]) -> None:
    placed, _ = lay_out_charts(odd)
    for chart in placed:
        assert_can_be_read(chart)
    drawing = draw_charts(placed)
    frames = [shape for shape in drawing.shapes if getattr(shape, "corner_radius", 0) == 10]
    assert len(frames) == 2 and frames[0].left + frames[0].width < frames[1].left and frames[0].top == frames[1].top


@pytest.mark.parametrize("seed", range(8))
def test_random_machines_have_readable_charts(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "bug.ant"
    path.write_text(machine(2 + 3 * seed, seed), encoding="utf-8")
    (chart,), _ = lay_out_charts(charts_of(path))
    assert_can_be_read(chart)


# --- the formats -----------------------------------------------------------------------------------------------------


def written(charts: tuple[Chart, ...], format: str) -> bytes:
    text, report = graphs.write_charts(charts, format)
    assert text is not None and report.ok
    return text


def test_svg_is_xml_with_all_words_and_says_where_they_come_from(odd: tuple[Chart, ...]) -> None:
    root = ElementTree.fromstring(written(odd, "svg"))
    space = "{http://www.w3.org/2000/svg}"
    texts = [text.text for text in root.iter(f"{space}text")]
    assert {"idle", "rest", "roam", "flee", "calm", "upset", "any state", "any but rest, flee", "previous"} <= set(texts)
    assert "<b>`x`</b> & 50 % #1; *a* été · for at least 2 s" in texts
    assert "1: fear > 3 and (fear < 9 or" in texts and "fear > 11)" in texts
    titles = [title.text for title in root.iter(f"{space}title")]
    assert "odd.ant:11: when chance 20 %/s -> choose { rest: 2; roam: 1 }" in titles
    assert all(float(text.get("textLength", 0)) > 0 for text in root.iter(f"{space}text"))


def test_png_shows_the_states_colours(odd: tuple[Chart, ...]) -> None:
    from PIL import Image

    image = Image.open(io.BytesIO(written(odd, "png"))).convert("RGB")
    placed, _ = lay_out_charts(odd)
    drawing = draw_charts(placed)
    assert image.width == round(drawing.width * 2) and abs(image.height - drawing.height * 2) <= 1
    colours = {colour for _, colour in image.getcolors(1 << 24) or []}
    for chart in odd:
        for box in chart.boxes:
            if box.kind == "state":
                assert tuple(round(part * 255) for part in box.colour) in colours, box.name


def test_dot_preserves_all_text(odd: tuple[Chart, ...]) -> None:
    import pydot

    (graph,) = pydot.graph_from_dot_data(written(odd, "dot").decode())
    clusters = graph.get_subgraphs()
    assert [plain(cluster.get_label()) for cluster in clusters] == ["bug.main", "bug.mood"]
    for chart, cluster in zip(odd, clusters, strict=True):
        nodes = {node.get_name(): plain(node.get_label()) for node in cluster.get_nodes()}
        expected = ["\n".join(w for w in (b.name, b.label) if w) if b.name and b.kind != "start" else "" for b in chart.boxes]
        assert list(nodes.values()) == expected
        edges = [(plain(e.get_label() or '""'), float(e.get("penwidth")) > 2) for e in cluster.get_edges()]
        assert edges == [("\n".join(arrow.lines), arrow.interrupt) for arrow in chart.arrows]


def plain(quoted: str) -> str:
    return re.sub(r"\\(.)", lambda m: "\n" if m[1] == "n" else m[1], quoted[1:-1])


LINK = re.compile(r'    (\w+) (-->|==>)(?:\|"([^"]*)"\|)? (\w+)')
BOX = re.compile(r'    (\w+)(?:\["([^"]*)"\]|\(\("([^"]*)"\)\)|\(\["([^"]*)"\]\)|\{"([^"]*)"\})')


def test_mermaid_has_every_box_and_arrow_with_escaped_text(odd: tuple[Chart, ...]) -> None:
    lines = written(odd, "mermaid").decode("ascii").splitlines()
    assert lines[0] == "flowchart TB"
    boxes = [match for line in lines if (match := BOX.fullmatch(line))]
    links = [match for line in lines if (match := LINK.fullmatch(line))]
    rest = [line for line in lines[1:] if not BOX.fullmatch(line) and not LINK.fullmatch(line)]
    assert all(
        re.fullmatch(r'  (subgraph m\d\["[\w.]+"\]|  direction TB|end|(style m\db\d+|linkStyle \d+) [\w:#,. -]+)', r)
        for r in rest
    )
    assert len(boxes) == sum(len(chart.boxes) for chart in odd)
    arrows = [arrow for chart in odd for arrow in chart.arrows]
    assert [(read(f[3] or ""), f[2] == "==>") for f in links] == [("\n".join(a.lines), a.interrupt) for a in arrows]
    assert "idle\n<b>`x`</b> & 50 % #1; *a* été · for at least 2 s" in [read(f[2] or "") for f in boxes]
    for match in [*boxes, *links]:
        assert not re.search(r"[`*<>&#;]", re.sub(r"#\d+;|<br/>", "", match[0]).replace("-->", "").replace("==>", ""))


def read(text: str) -> str:
    return re.sub(r"#(\d+);", lambda m: chr(int(m[1])), text.replace("<br/>", "\n"))


@pytest.mark.parametrize("format", list(graphs.CHART_FORMATS))
def test_the_same_program_gives_the_same_bytes_in_another_process_and_folder(
    odd_file: Path, odd: tuple[Chart, ...], tmp_path: Path, format: str
) -> None:
    (tmp_path / "odd.ant").write_text(ODD, encoding="utf-8")
    command = [sys.executable, "-m", "antdsl", "graph", "odd.ant", "--format", format, "--out", "-"]
    environment = child_environment(PYTHONHASHSEED="7")
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, timeout=60)
    assert result.returncode == 0, result.stderr
    assert result.stdout == written(odd, format)


# --- the command -----------------------------------------------------------------------------------------------------


def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], folder: Path, *words: str) -> tuple[int, str]:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "argv", ["antdsl", "graph", *words])
    code = run_in_process()
    printed = "".join(capfd.readouterr())
    assert "Traceback" not in printed
    return code, printed


def test_the_command_chooses_the_format_by_the_ending(
    odd_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    file = str(odd_file)
    assert command(monkeypatch, capfd, tmp_path, file) == (0, "odd.svg\n")
    assert (tmp_path / "odd.svg").read_bytes().startswith(b"<svg ")
    for name, begins in (("a.png", b"\x89PNG"), ("a.mmd", b"flowchart TB\n"), ("a.gv", b"digraph"), ("a.dot", b"digraph")):
        assert command(monkeypatch, capfd, tmp_path, file, "--out", name)[0] == 0
        assert (tmp_path / name).read_bytes().startswith(begins)
    code, printed = command(monkeypatch, capfd, tmp_path, file, "--out", "-", "--format", "dot", "--only", "bug.mood")
    assert code == 0 and "upset" in printed and "flee" not in printed
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.dot", "a.gv", "a.mmd", "a.png", "odd.svg"]
    scene = str(ROOT / "examples" / "minimal" / "scene.yaml")
    assert command(monkeypatch, capfd, tmp_path, scene, "--out", "scene.dot")[0] == 0
    assert b"stroll" in (tmp_path / "scene.dot").read_bytes()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["odd.ant", "--out", "a.jpg"], 2, "has no known ending (.svg, .png"),
        (["odd.ant", "--only", "bag"], 2, "did you mean `bug`?"),
        (["none.ant"], 3, "none.ant"),
        (["broken.ant"], 1, "unknown-state"),
        (["still.ant"], 1, "no species with states"),
        (["odd.ant", "--out", "none/a.svg"], 2, "there is no folder `none`"),
    ],
)
def test_mistakes_give_a_message(
    odd_file: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], code: int, message: str
) -> None:
    (odd_file.parent / "broken.ant").write_text(ODD.replace("-> roam", "-> roan"), encoding="utf-8")
    (odd_file.parent / "still.ant").write_text('ant 1\nbehaviour b() -> number {\n  "One."\n  1\n}\n', encoding="utf-8")
    exit_code, printed = command(monkeypatch, capfd, odd_file.parent, *words)
    assert exit_code == code and message in printed


def test_without_the_extra_pictures_name_it_and_texts_are_written(
    odd: tuple[Chart, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "resvg_py", None)
    assert_extra_is_named(odd, "png")
    assert written(odd, "svg")
    monkeypatch.setitem(sys.modules, "graphlay", None)
    for format in ("svg", "png"):
        assert_extra_is_named(odd, format)
    assert written(odd, "mermaid") and written(odd, "dot")


def assert_extra_is_named(charts: tuple[Chart, ...], format: str) -> None:
    text, report = graphs.write_charts(charts, format)
    assert text is None and [d.code for d in report.errors] == ["missing-extra"]
    assert 'pip install "antdsl[graph]"' in report.errors[0].help


def test_large_pictures_have_fewer_pixels() -> None:
    from PIL import Image

    image = Image.open(io.BytesIO(render_png(Drawing(40_000.0, 3_000.0, ()))))
    assert image.width * image.height <= MAX_PIXELS * 1.01 and image.width // image.height == 13


def test_pictures_of_plain_text_do_not_depend_on_the_fonts_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    import resvg_py

    calls: list[dict[str, object]] = []
    monkeypatch.setattr(resvg_py, "svg_to_bytes", lambda **options: calls.append(options) or b"")
    for text in ("plain", "été"):
        render_png(Drawing(10.0, 10.0, (TextLine(text, (5.0, 5.0), 11, (0.0, 0.0, 0.0), 9.0),)))
    assert [call["skip_system_fonts"] for call in calls] == [True, False]
    assert all('font-family="Aileron"' in str(call["svg_string"]) for call in calls)


def test_built_in_glyphs_of_pillow_exist() -> None:
    """A sign that a font does not have is drawn like one that no font has."""
    from antdsl.graphs.text_width import _NON_ASCII_GLYPHS, load_built_in_font

    letters = load_built_in_font(20)
    nothing = bytes(letters.getmask("\uffff"))
    for sign in [*_NON_ASCII_GLYPHS, *(chr(code) for code in range(33, 127))]:
        assert bytes(letters.getmask(sign)) != nothing, sign
