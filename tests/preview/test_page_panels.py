"""The panels of the preview's page, in a browser: what they show of messages, and what they request when a user uses them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from typing import TYPE_CHECKING, Any

import pytest
from browsing import chromium
from page_messages import TEXT, curves, directed, frame, notes, problems, scene, status, texts, verbs
from page_stage import Stage, stage
from sampling import sampled

if TYPE_CHECKING:
    from playwright.sync_api import Browser


NAMELESS = """() => [...document.querySelectorAll("button, input, select, [role=button], [role=separator]")]
    .filter((each) => each.checkVisibility())
    .filter((each) => !(each.ariaLabel || each.textContent.trim() || each.labels?.length))
    .map((each) => each.outerHTML)"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.fixture
def page(browser: Browser) -> Iterator[Stage]:
    with stage(browser) as opened:
        opened.tell(scene(), texts(), status())
        yield opened


def outcome(**other: Any) -> dict[str, Any]:
    return {
        "op": "outcome",
        "of": "saved",
        "ok": True,
        "did": "ant.ant line 6",
        "line": "kept 3 agents",
        "text": "",
        "file": "",
        "problems": [],
        **other,
    }


# --- the bar ---------------------------------------------------------------------------------------------------------


def test_the_bar_says_where_it_is_and_plays(page: Stage) -> None:
    assert page.find("scene").inner_text() == "walk.yaml"
    assert (page.find("frame").inner_text(), page.find("seconds").inner_text()) == ("frame 20", "0.83 s")
    page.find("play").click()
    page.tell(status(21, playing=True, hash=None))
    assert page.find("hash").is_hidden()
    page.find("play").click()
    page.drawn()
    assert [each["op"] for each in page.asks if each["op"] in ("play", "pause")] == ["play", "pause"]
    page.find("speed").select_option("0")
    assert page.requests_of("speed") == [{"op": "speed", "times": 0}]


def test_play_and_pause_follow_the_latest_request_while_a_step_takes_long(page: Stage) -> None:
    page.find("play").click()
    assert "pause" in page.find("play").inner_text()  # no message was sent yet
    page.find("play").click()
    page.find("play").click()
    page.drawn()
    assert [each["op"] for each in page.asks if each["op"] != "look"] == ["play", "pause", "play"]
    page.page.wait_for_timeout(450)
    page.tell(status(21, paused_by="a breakpoint"))
    assert "play" in page.find("play").inner_text()


def test_an_edited_run_says_so_and_can_be_simulated_again(page: Stage) -> None:
    assert page.find("edited").is_hidden()
    page.tell(status(edited=True))
    page.find("restart").click()
    assert page.requests_of("restart") == [{"op": "restart"}]


def test_the_outcome_of_a_save_is_announced(page: Stage) -> None:
    line = page.find("outcome")

    def announced_text() -> str:
        line_match = re.fullmatch(r"\d\d:\d\d:\d\d, frame 20: (.*)", line.inner_text())
        return line_match[1] if line_match else line.inner_text()

    page.page.clock.install(time=datetime(2024, 5, 1, 12, 0, 0))
    page.tell(outcome())
    assert announced_text() == "saved: ant.ant line 6 · kept 3 agents" and line.get_attribute("aria-live") == "polite"
    words, flashes = line.inner_text(), "line => line.getAnimations().map((each) => each.currentTime)"
    page.page.clock.run_for(5000)
    page.tell(outcome())
    assert line.inner_text() != words and announced_text() == "saved: ant.ant line 6 · kept 3 agents", (
        "the same words, at another time"
    )
    assert len(line.evaluate(flashes)) == 1, "it is seen that something was told"
    assert len((line.get_attribute("title") or "").splitlines()) == 2, "what was told before can still be read"
    page.tell(outcome(of="layer", did="layer `wander()` is off"))
    assert announced_text() == "layer `wander()` is off · kept 3 agents"
    page.tell(outcome(ok=False, line="", did="", problems=problems()["problems"]))
    assert announced_text() == "saved: no `pase` is known here — the last good program continues"
    page.tell({"op": "refused", "of": "seek", "message": "there is no frame 9", "help": "one of 1 to 5"})
    assert announced_text() == "there is no frame 9 — one of 1 to 5"


def test_keys_move_through_time_but_not_while_one_writes(page: Stage) -> None:
    page.page.locator("body").press("Space")
    page.page.locator("body").press("ArrowRight")
    page.page.locator("body").press("Shift+ArrowLeft")
    page.page.locator("body").press("Home")
    page.drawn()
    assert [each["op"] for each in page.asks if each["op"] != "look"] == ["play", "pause", "seek", "seek", "seek"]
    assert [each["frame"] for each in page.requests_of("seek")] == [21, 10, 1]
    page.tell(status(100))
    page.page.locator("body").press(".")
    assert page.requests_of("step") == [{"op": "step", "count": 1}]
    request_count = len(page.asks)
    page.find("side-tab-breaks").click()
    page.find("break-condition").press_sequentially(" a.b ")
    page.drawn()
    assert len(page.asks) == request_count


# --- the text --------------------------------------------------------------------------------------------------------


def test_a_mistake_is_underlined_where_it_stands(page: Stage) -> None:
    assert page.find("editor").get_attribute("data-file") == "ant.ant"  # the program before the scene
    page.tell(problems())
    assert page.page.locator("#editor .wrong.error").all_inner_texts() == ["pase"]
    assert page.find("complaint").inner_text().split("\n") == ["no `pase` is known here", "did you mean `pace`?"]
    assert page.find("errors").inner_text() == "1 error"
    page.find("file-tab-walk.yaml").click()
    page.find("problems").locator("button").click()
    assert page.find("editor").get_attribute("data-file") == "ant.ant"
    assert "pase" in page.page.locator("#editor .pointed").inner_text()
    page.tell(texts(TEXT.replace("pase", "pace")), {"op": "problems", "problems": []})
    assert page.page.locator("#editor .wrong").count() == 0 and page.find("problems").is_hidden()
    assert "pace > 3" in page.page.locator("#editor .cm-content").inner_text()


def test_programs_have_the_colours_of_the_language(page: Stage) -> None:
    def colour(word: str) -> str:
        span = page.page.locator("#editor .cm-line span", has_text=word).first
        return str(span.evaluate("element => getComputedStyle(element).color"))

    assert len({colour("# "), colour("species"), colour('"How fast"'), colour("mm/s"), colour("-> ".strip())}) == 5


def test_texts_are_for_reading(page: Stage) -> None:
    content = page.page.locator("#editor .cm-content")
    content.click()
    content.press_sequentially("xyz")
    assert "xyz" not in content.inner_text()


# --- what can be turned ----------------------------------------------------------------------------------------------


def test_a_slider_asks_while_it_is_dragged_and_tells_the_line_for_good(page: Stage) -> None:
    page.find("side-tab-sliders").click()
    slider = page.find("param-ant.pace")
    slider.evaluate("""async slider => {
        for (let value = 10; value <= 30; value++) {
            slider.value = value;
            slider.dispatchEvent(new Event("input"));
            await new Promise((done) => setTimeout(done, 15));
        }
    }""")
    page.page.wait_for_timeout(150)
    requests = page.requests_of("set")
    assert requests[-1] == {"op": "set", "name": "ant.pace", "value": "30 mm/s"}
    assert 2 <= len(requests) <= 6  # ten a second at most, and the last one
    changed = [{**scene()["params"][0], "value": "30 mm/s", "number": 30}, scene()["params"][1]]
    page.tell(outcome(of="set", line="", text="set: {ant.pace: 30 mm/s}", file="walk.yaml"), scene(params=changed))
    assert page.find("line").inner_text() == "set: {ant.pace: 30 mm/s}"
    page.find("copy").click()
    assert page.page.evaluate("navigator.clipboard.readText()") == "set: {ant.pace: 30 mm/s}"
    page.page.get_by_label("ant.pace back to 10 mm/s").click()
    assert page.requests_of("set")[-1]["value"] == "10 mm/s"
    page.tell(scene())
    assert page.find("lines").is_hidden() and slider.input_value() == "10"


def test_a_param_without_a_range_says_which_one_is_offered(page: Stage) -> None:
    page.find("side-tab-sliders").click()
    slider = page.find("param-ant.size")
    assert (slider.get_attribute("min"), slider.get_attribute("max")) == ("0", "6")
    assert "no range" in page.page.locator('[data-param="ant.size"]').inner_text()


def test_an_input_keeps_its_element_when_the_scene_is_sent_again(page: Stage) -> None:
    page.find("side-tab-sliders").click()
    slider = page.find("param-ant.pace")
    slider.evaluate("element => { element.mine = true; element.focus(); }")
    page.tell(scene())
    assert slider.evaluate("element => element.mine && document.activeElement === element")


def test_layers_and_fields_go_off_and_on(page: Stage) -> None:
    page.find("side-tab-sliders").click()
    page.find("layers").locator("input").uncheck()
    page.find("fields").locator("input").uncheck()
    assert page.requests_of("layer") == [{"op": "layer", "species": "ant", "layer": "wander()", "on": False}]
    assert page.requests_of("field") == [{"op": "field", "name": "trail", "on": False}]


def test_a_changed_look_is_requested_once(page: Stage) -> None:
    page.find("side-tab-view").click()
    page.find("colour").select_option("load")
    page.find("view-fields-trail").check()
    page.tell(scene())  # nothing else: no other look
    last = page.requests_of("look")[-1]
    assert (last["columns"], last["fields"]) == ([{"species": "ant", "name": "load"}], ["trail"])
    assert len(page.requests_of("look")) <= 3


# --- time ------------------------------------------------------------------------------------------------------------


def test_dragging_shows_what_is_remembered_and_letting_go_simulates(page: Stage) -> None:
    box = page.find("scrub").bounding_box()
    assert box is not None
    page.page.mouse.move(box["x"] + 8 + (box["width"] - 16) * 19 / 99, box["y"] + box["height"] / 2)
    page.page.mouse.down()
    page.page.mouse.move(box["x"] + box["width"] - 8, box["y"] + 4, steps=10)
    page.page.wait_for_timeout(100)
    dragged = page.requests_of("seek")
    assert dragged and not any(each["exact"] for each in dragged)
    page.page.mouse.up()
    assert page.requests_of("seek")[-1] == {"op": "seek", "frame": 100, "exact": True}
    assert sum(each["exact"] for each in page.requests_of("seek")) == 1


def test_the_slider_goes_by_keys(page: Stage) -> None:
    page.find("scrub").focus()
    page.find("scrub").press("ArrowLeft")
    page.find("scrub").press("Shift+ArrowRight")
    assert [(each["frame"], each["exact"]) for each in page.requests_of("seek")] == [(19, True), (29, True)]


def test_curves_are_stored_dropped_and_drawn(page: Stage) -> None:
    page.tell(curves(list(range(1, 101)), [3.0] * 100))
    legend = page.find("legend")
    assert legend.inner_text().split() == ["walk", "3", "all", "is", "well", "holds"]
    blank = page.find("curves").evaluate("canvas => canvas.toDataURL()")
    old = {"first": 10, "line": "set: {ant.pace: 30 mm/s}", "frames": [11, 12], "values": {"ant.main.walk": [3.0, 3.0]}}
    page.tell(curves([10, 11, 20], [2.0, 1.0, 1.0], reset=True, branches=[old]), status(20, head=20))
    assert legend.inner_text().split()[:2] == ["walk", "1"]
    assert "before: set: {ant.pace: 30 mm/s}, at frame 10" in page.find("branches").inner_text()
    assert page.find("curves").evaluate("canvas => canvas.toDataURL()") != blank
    page.find("curve-chooser").click()
    page.find("curve-ant.main.walk").uncheck()
    page.drawn()
    assert legend.inner_text().split()[0] == "all"


# --- states, breakpoints, cost ---------------------------------------------------------------------------------------


def test_states_count_and_select_their_agents(page: Stage) -> None:
    page.find("side-tab-machine").click()
    page.tell(frame([0, 1, 1]))
    page.page.wait_for_timeout(250)
    assert (page.find("count-walk").text_content(), page.find("count-rest").text_content()) == ("1", "2")
    page.tell(status(44, transitions={"ant.walk->rest": 6}), status(68, transitions={"ant.walk->rest": 10}), frame([0, 1, 1], 68))
    page.page.wait_for_timeout(250)
    assert "4/s" in (page.find("chart").text_content() or "")
    page.find("state-rest").focus()
    page.page.keyboard.press("Enter")
    assert page.requests_of("explain")[-1] == {"op": "explain", "species": "ant", "agent": 12, "frame": 68}
    assert page.requests_of("look")[-1]["follow"] == {"species": "ant", "agent": 12}
    assert not page.requests_of("play")  # the key pressed a state, nothing else


def test_breakpoints_are_set_listed_and_removed(page: Stage) -> None:
    page.find("side-tab-breaks").click()
    page.find("break-state").select_option("rest")
    page.find("break-state-form").locator("button").click()
    page.find("break-condition").fill("count(state == lost) > 1")
    page.tell(
        {"op": "breaks", "breaks": [{"made": {"kind": "state", "species": "ant", "machine": "main", "state": "rest"}, "why": ""}]}
    )
    page.find("break-condition").press("Enter")
    state = {"kind": "state", "species": "ant", "machine": "main", "state": "rest"}
    condition = {"kind": "condition", "text": "count(state == lost) > 1"}
    assert [(each["breaks"], each["tried"]) for each in page.requests_of("breaks")] == [([], state), ([state], condition)]
    wrong = page.find("break-condition-form-wrong")
    page.tell({"op": "refused", "of": "breaks", "message": "no state is `lost`", "help": "one of walk, rest"})
    assert wrong.inner_text() == "no state is `lost`: one of walk, rest"
    assert page.find("breaks").locator("li").count() == 1, "what is wrong is not added"
    assert page.find("break-condition").input_value() == condition["text"], "and can be mended where it was written"
    page.find("break-condition").press("End")
    page.find("break-condition").press_sequentially(" ")
    assert wrong.is_hidden()
    page.find("break-condition").press("Enter")
    unfit = "no state is `lost`; one of walk, rest"
    page.tell({"op": "breaks", "breaks": [{"made": state, "why": ""}, {"made": condition, "why": unfit}]})
    assert page.find("break-condition").input_value() == "", "it was added"
    assert page.find("break-misfit").all_inner_texts() == ["", f"does not fit this program: {unfit}"]
    page.find("breaks").locator("button").nth(1).click()
    assert page.requests_of("breaks")[-1]["breaks"] == [state]
    page.tell(status(30, paused_by="ant 11 entered rest at frame 30", paused_agents={"species": "ant", "agents": [11]}))
    assert page.find("fired").inner_text() == "stopped: ant 11 entered rest at frame 30"
    assert page.requests_of("explain")[-1] == {"op": "explain", "species": "ant", "agent": 11, "frame": 30}
    page.tell({"op": "breaks", "breaks": []})  # another page took it away
    assert page.find("breaks").locator("li").count() == 0


def test_costs_are_measured_on_request(page: Stage) -> None:
    page.find("side-tab-profile").click()
    assert page.find("profile").is_hidden() and not page.requests_of("profile")
    page.find("profile-on").check()
    line = {"file": "ant.ant", "line": 6, "text": "when pase > 3 -> rest", "ms": 1.5}
    page.tell(
        {"op": "profile", "frames": 24, "total": 4.0, "phases": [{"name": "decide", "ms": 3.0}], "layers": [], "lines": [line]}
    )
    assert "4.00 ms per frame" in page.find("profile-total").inner_text()
    assert page.page.locator("#editor .cost").all_inner_texts() == ["1.5"]
    page.find("profile").get_by_text("when pase").click()
    assert "pase" in page.page.locator("#editor .pointed").inner_text()
    page.find("profile-on").uncheck()
    assert [each["on"] for each in page.requests_of("profile")] == [True, False]
    assert page.page.locator("#editor .cost").count() == 0


# --- all of them -----------------------------------------------------------------------------------------------------


def test_names_are_text_whatever_they_are(browser: Browser) -> None:
    evil = '<img src=x onerror="document.title=1"><b>bold</b>'
    scene_message = scene(name=evil, specs=[evil])
    scene_message["species"][0]["machines"][0]["states"] = [evil, "rest"]
    scene_message["params"][0] |= {"name": evil, "help": evil}
    scene_message["charts"][0]["boxes"][0] |= {"name": evil, "label": evil}
    with stage(browser) as page:
        page.tell(
            scene_message,
            texts(evil),
            status(fault=evil, paused_by=evil),
            frame([0, 1]),
            curves([1], [1.0]),
            outcome(line=evil, text=evil),
            verbs(evil, evil),
            notes(evil, problem=evil),
            directed(evil, ("agents", evil), ("", evil)),
        )
        for tab in ("why", "direct", "sliders", "view", "machine", "profile", "breaks"):
            page.find(f"side-tab-{tab}").click()
        assert page.find("scene").inner_text() == evil
        assert evil in page.find("break-state").inner_text()
        assert page.page.locator("img, #side b, #bar b").count() == 0
        assert page.page.title() == f"{evil} · antdsl preview"


def test_tabs_go_by_keys(page: Stage) -> None:
    page.find("side-tab-why").focus()
    page.page.keyboard.press("ArrowRight")
    assert page.find("panel-direct").is_visible() and page.find("panel-why").is_hidden()
    page.page.keyboard.press("End")
    assert page.find("panel-breaks").is_visible()
    assert page.page.locator('#side [role="tab"][tabindex="0"]').count() == 1
    assert not page.requests_of("seek")


def test_everything_that_can_be_pressed_has_a_name(page: Stage) -> None:
    page.tell(frame([0, 1]), curves([1, 2], [1.0, 1.0]), problems(), verbs(), notes("{hold: guards}"))
    for tab in ("why", "direct", "sliders", "view", "machine", "profile", "breaks"):
        page.find(f"side-tab-{tab}").click()
        nameless = page.page.evaluate(NAMELESS)
        assert nameless == []


@pytest.mark.parametrize("size", sampled([(1280, 720), (1440, 900), (1024, 640)], [(1024, 640)]))
def test_nothing_is_wider_than_the_window(page: Stage, size: tuple[int, int]) -> None:
    page.page.set_viewport_size({"width": size[0], "height": size[1]})
    page.tell(outcome(line="kept 500 agents · " * 30), status(edited=True, paused_by="ant 11 entered rest " * 10), problems())
    wide = page.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
    assert wide == list(size)
    box = page.find("theme").bounding_box()
    assert box is not None and box["x"] + box["width"] <= size[0]


def test_the_theme_is_the_systems_or_ones_own(page: Stage) -> None:
    def ground() -> str:
        return str(page.page.evaluate("getComputedStyle(document.body).backgroundColor"))

    light = ground()
    page.page.emulate_media(color_scheme="dark")
    dark = ground()
    page.find("theme").click()  # the other one than the system's
    assert dark != light and ground() == light
    page.page.reload()
    assert ground() == light
