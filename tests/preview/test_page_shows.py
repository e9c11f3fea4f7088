"""What the preview's page shows is what is: the same frame looks the same whatever was shown before, what is old is dimmed, what
is mended is lit no more, and what draws nothing says why."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from browsing import chromium
from page_messages import TEXT, frame, problems, scene, status, texts
from page_stage import Stage, stage
from PIL import Image

from antdsl.preview.binary_packets import pack_arrays, unpack_arrays

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CAMERA = {"at": [50, 40, 120], "look_at": [50, 0, 50], "focal": 35}
ITEMS = [
    {"name": "nest", "kind": "items", "names": ["home"], "amounts": [{"name": "load", "unit": "mg", "first": [0]}]},
    {"name": "food", "kind": "items", "names": ["apple"], "amounts": [{"name": "load", "unit": "mg", "first": [400]}]},
]
SQUARE = np.array([[0, 0, 0], [0, 0, 100], [100, 0, 100], [100, 0, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
SIZES = """() => [...document.querySelectorAll("#text .tabs button, #bar .frame, #side h3, .note, .end")]
    .map((each) => parseFloat(getComputedStyle(each).fontSize))"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.fixture
def page(browser: Browser) -> Iterator[Stage]:
    with stage(browser) as opened:
        yield opened


def with_items(number: int, nest: float, food: float) -> bytes:
    _, arrays = unpack_arrays(frame([0, 1], number))
    for name, amount in (("nest", nest), ("food", food)):
        arrays |= {f"item/{name}/position": np.full(3, 20, np.float32), f"item/{name}/size": np.full(1, 8, np.float32)}
        arrays[f"item/{name}/amount/load"] = np.full(1, amount, np.float32)
    return pack_arrays("frame", arrays, frame=number, light=False)


def item(names: str, name: str) -> bytes:
    shape = {"position": SQUARE, "face": FACES, "colour": np.ones((4, 3), np.float32)}
    return pack_arrays(f"item:{names}:{name}", shape, items=names, index=0, shape="ring")


def crowd(count: int, number: int, spread: float = 60.0) -> bytes:
    _, arrays = unpack_arrays(frame([0] * count, number))
    arrays["ant/position"] = np.random.Generator(np.random.Philox(number)).uniform(0, spread, (count, 3)).astype(np.float32)
    return pack_arrays("frame", arrays, frame=number, light=False)


def explained(number: int) -> dict[str, Any]:
    nothing: dict[str, list[Any]] = {
        name: [] for name in ("notes", "machines", "handlers", "steers", "layers", "seen", "fields", "senses", "draws", "did")
    }
    explanation = {
        "scene": "walk.yaml", "species": "ant", "agent": 10, "frame": number, "hash": "", "checkpoint": 1, "mode": "budget",
        "strip": [{"machine": "main", "state": "walk", "first": 1, "last": number}], "alive": [1, number], **nothing,
        "push": [0, 0, 0], "velocity": [[0, 0, 0], None], "acceleration": None, "changes": [],
    }  # fmt: skip
    agent_fields = {"species": "ant", "agent": 10, "frame": number, "message": "", "place": [0, 0, 0], "neighbours": []}
    return {"op": "explained", **agent_fields, "explanation": explanation, "told": "walks"}


@pytest.mark.slow
def test_items_are_as_large_as_what_is_left_of_what_they_had_at_first(page: Stage) -> None:
    def large(names: str, name: str) -> float:
        page.drawn()
        return float(page.page.evaluate("(of) => window.antdsl.item(...of)", [names, name]))

    page.tell(scene(items=ITEMS), status(1), with_items(1, 0, 400), item("nest", "home"), item("food", "apple"))
    assert (large("nest", "home"), large("food", "apple")) == (8, 8)
    page.tell(with_items(90, 300, 100))
    eaten = large("food", "apple")
    assert large("nest", "home") == 8 and eaten == pytest.approx(8 * (0.25 + 0.75 * 0.25 ** (1 / 3)))
    page.tell(with_items(1, 0, 400))  # gone back
    assert (large("nest", "home"), large("food", "apple")) == (8, 8)
    page.page.reload()
    page.tell(scene(items=ITEMS), status(90), with_items(90, 300, 100), item("food", "apple"))
    assert large("food", "apple") == eaten, "also for who has not seen it whole"


def test_a_field_has_one_scale_with_numbers(page: Stage) -> None:
    page.tell(scene(fields=[{"name": "trail", "unit": "", "colour": [1, 0.5, 0], "on": True, "full": 100}]), texts(), status())
    numbers = page.find("scale-trail").locator("p span")
    assert numbers.all_inner_texts() == ["0.001", "0.1", "1", "100"]
    mesh = pack_arrays("fieldmesh:trail", {"position": SQUARE, "face": FACES})

    def take_picture(value: int) -> bytes:
        page.tell(pack_arrays("field:trail", {"value": np.full(4, value, np.uint8)}, frame=20))
        page.page.wait_for_timeout(100)
        return page.page.locator("#view > canvas").screenshot()

    page.tell(mesh, frame([0, 1]))
    faint, strong = take_picture(100), take_picture(180)
    assert faint != strong and take_picture(100) == faint, "the same values are the same picture, whatever was shown before"
    page.find("side-tab-view").click()
    page.find("full-trail").fill("1")
    page.find("full-trail").press("Enter")
    assert numbers.all_inner_texts() == ["0.00001", "0.001", "0.01", "1"]
    assert take_picture(100) != faint
    page.find("view-fields-trail").uncheck()
    assert page.find("scale-trail").count() == 0


def test_an_explanation_of_another_frame_is_dimmed(page: Stage) -> None:
    page.tell(scene(), texts(), status(20), frame([0, 1], 20))
    page.page.locator("#view > canvas").press("n")
    page.tell(explained(20))
    caption, body = page.find("why-about"), page.find("why")
    assert caption.inner_text() == "the step to frame 20" and body.evaluate("e => getComputedStyle(e).opacity") == "1"
    page.tell(status(30, playing=True, hash=None), frame([0, 1], 30))
    assert "the step to frame 20, and now it is frame 30: pause it" in caption.inner_text()
    assert body.evaluate("e => getComputedStyle(e).opacity") == "0.45"
    page.tell(status(31), explained(31))
    assert caption.inner_text() == "the step to frame 31" and body.evaluate("e => getComputedStyle(e).opacity") == "1"


def test_errors_at_the_start_are_scrolled_to_and_shown_in_the_empty_view(page: Stage) -> None:
    text = "\n" * 200 + TEXT
    page.tell(texts(text), problems(text), status(0, agents=0))
    assert "pase" in page.page.locator("#editor .pointed").inner_text()
    assert page.page.locator("#editor .pointed").is_visible()
    box, editor = page.page.locator("#editor .pointed").bounding_box(), page.find("editor").bounding_box()
    assert box is not None and editor is not None and editor["y"] <= box["y"] <= editor["y"] + editor["height"]
    said = page.find("nothing").inner_text()
    assert "there is an error" in said and "ant.ant:206 no `pase` is known here — did you mean `pace`?" in said
    page.tell(scene(), texts(), {"op": "problems", "problems": []}, status(1))
    assert page.find("nothing").is_hidden()
    assert page.page.locator("#editor .pointed").count() == 0, "what is mended is lit no more"


@pytest.mark.slow
def test_the_first_camera_is_the_same_however_the_page_came_to_its_size(page: Stage) -> None:
    def camera() -> list[float]:
        page.drawn()
        return [round(part, 3) for part in page.page.evaluate("() => window.antdsl.camera()")]

    def opened(sizes: list[tuple[int, int]], scene_message: dict[str, Any], *, late: bool) -> list[float]:
        page.page.set_viewport_size({"width": sizes[0][0], "height": sizes[0][1]})
        page.page.reload()
        page.page.wait_for_function("document.getElementById('stale').hidden")
        page.tell(scene_message)
        if late:
            page.page.wait_for_timeout(200)  # a picture is drawn before the agents are there
        page.tell(crowd(50, 1))
        for width, height in sizes[1:]:
            page.page.set_viewport_size({"width": width, "height": height})
            page.page.wait_for_timeout(100)
        return camera()

    far = {"low": [-40_000] * 3, "high": [40_000] * 3, "camera": {"at": [30, 9000, 9000], "look_at": [30, 0, 30], "focal": 35}}
    for scene_message in (scene(camera=CAMERA), scene(), scene(**far)):
        expected_camera = opened([(1280, 720)], scene_message, late=False)
        assert opened([(1280, 720)], scene_message, late=True) == expected_camera
        assert opened([(700, 900), (1000, 500), (1280, 720)], scene_message, late=False) == expected_camera
    page.page.locator("#view > canvas").press("ArrowLeft")
    turned = camera()
    page.page.set_viewport_size({"width": 1100, "height": 720})
    page.page.wait_for_timeout(100)
    assert camera() == turned, "who has moved it keeps it"


def test_trails_that_draw_nothing_say_why(page: Stage) -> None:
    page.tell(scene(), texts(), status(), crowd(400, 20))
    note = page.find("trails-note")
    assert note.is_hidden()
    page.page.locator("#view > canvas").press("t")
    assert note.inner_text() == "no trails: 400 are too many at once — select those whose trails you want to see"
    page.page.locator("#view > canvas").press("n")
    assert note.inner_text() == "no trails yet: they grow as it plays"
    page.tell(crowd(400, 21), crowd(400, 22))
    assert note.is_hidden()
    page.page.locator("#view > canvas").press("t")
    assert note.is_hidden()


def planned(number: int, ids: list[int], count: int = 20) -> bytes:
    """Paths from the middle of the ground to its right end, frame by frame."""
    path = np.full((len(ids), count, 3), (30, 0, 50), np.float32)
    path[:, :, 0] += np.linspace(0, 40, count)[None, :]
    return pack_arrays("paths", {"ant/id": np.array(ids, np.int32), "ant/path": path}, frame=number, count=count)


def test_planned_paths_are_requested_drawn_and_shortened_over_time(page: Stage) -> None:
    def drawn() -> np.ndarray:
        page.page.wait_for_timeout(300)
        picture = page.page.locator("#view > canvas").screenshot()
        return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)

    def differing(one: np.ndarray, other: np.ndarray) -> int:
        return int((np.abs(one - other).max(axis=2) > 30).sum())

    page.tell(scene(camera=CAMERA), texts(), status(), crowd(3, 20, 1.0))
    canvas, note = page.page.locator("#view > canvas"), page.find("paths-note")
    assert "planned" not in page.requests_of("look")[-1] and note.is_hidden()
    canvas.press("n")
    plain_picture = drawn()
    canvas.press("a")
    assert page.requests_of("look")[-1]["planned"] == [{"species": "ant", "agent": 10}]
    assert note.inner_text() == "planned paths: being simulated"
    page.tell(planned(20, [10]))
    assert note.is_hidden()
    full_difference = differing(plain_picture, drawn())
    assert full_difference > 60, "a dashed line over the ground"
    page.tell(planned(2, [10]))
    assert differing(plain_picture, drawn()) < 0.5 * full_difference, "what lies behind is left out"
    page.tell(planned(20, [11]))
    assert note.is_visible(), "not of who is not selected"
    canvas.press("Escape")
    assert page.requests_of("look")[-1]["planned"] == []
    page.tell(crowd(400, 20))
    assert note.inner_text() == "no planned paths: 400 are too many at once — select those whose paths you want to see"
    canvas.press("a")
    assert "planned" not in page.requests_of("look")[-1] and note.is_hidden()


def test_marks_and_the_end_of_the_scene_are_those_of_the_run(page: Stage) -> None:
    def chart() -> str:
        page.page.mouse.move(5, 5)
        page.drawn()
        return str(page.find("curves").evaluate("canvas => canvas.toDataURL()"))

    stops = {"op": "stops", "stops": [{"frame": 70, "line": "ant 11 entered rest"}]}
    page.tell(scene(last=200), texts(), status(50, head=100))
    plain = chart()
    page.tell(stops)
    marked = chart()
    assert marked != plain
    page.page.reload()
    page.page.wait_for_function("document.getElementById('stale').hidden")
    page.tell(scene(last=200), texts(), status(50, head=100), stops)
    assert chart() == marked, "another page has the same"
    page.tell({"op": "stops", "stops": []})
    assert chart() == plain
    page.tell(scene(last=80))
    assert chart() != plain and "the scene ends at 80" in page.page.locator("#time .ends").inner_text()


def test_sizes_go_by_the_letters_of_the_browser(page: Stage) -> None:
    page.tell(scene(), texts(), status(), frame([0, 1]), problems())
    page.find("side-tab-machine").click()
    initial_sizes = page.page.evaluate(SIZES)
    row = page.find("side-tab-why").bounding_box()
    code = page.page.locator("#editor .cm-content").evaluate("e => parseFloat(getComputedStyle(e).fontSize)")
    session = page.page.context.new_cdp_session(page.page)
    session.send("Page.setFontSizes", {"fontSizes": {"standard": 24, "fixed": 20}})
    page.drawn()
    assert page.page.evaluate(SIZES) == pytest.approx([1.5 * size for size in initial_sizes], rel=0.02)
    larger = page.find("side-tab-why").bounding_box()
    assert row is not None and larger is not None and larger["height"] > 1.4 * row["height"]
    now = page.page.locator("#editor .cm-content").evaluate("e => parseFloat(getComputedStyle(e).fontSize)")
    assert now == pytest.approx(1.5 * code, rel=0.02)
    wide = page.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    assert wide == [1280, 720], "and nothing is pushed out of the window"
