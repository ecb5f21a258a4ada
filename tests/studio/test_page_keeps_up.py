"""The page in a headless browser: it follows what other tabs and runs do, and loses nothing that was typed.

TNST_MI_SHOTS may name a folder for pictures of it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from studio_page import (
    PATIENCE,
    SIZES,
    Page,
    address,
    browser,
    expect,
    opened,
    sequence,
    smoke,
)
from studios import Studio, running

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.masks import mask_tables

__all__ = ["browser", "opened", "smoke"]


def test_what_is_refused_keeps_work_from_beginning(
    smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]
) -> None:
    shown = opened(address(smoke))
    page = shown.page
    cards, field, radius = page.locator(".job"), page.locator("#cluster"), page.get_by_label("radius", exact=True)
    # It is refused before the button is released, or after.
    for wait in (200, 0):
        radius.fill("-5")
        page.locator("#try").click(delay=wait)
        page.locator("#error", has_text="radius").wait_for()
        page.locator("#try:not([disabled])").wait_for()
        assert cards.count() == 0 and radius.input_value() == "3"
    # Nothing is rendered elsewhere than the field says, however often one asks.
    field.press_sequentially("local:many")
    for _ in range(2):
        page.locator("#render").click()
        page.locator("#cluster-error", has_text="expected local:N").wait_for()
        page.locator("#render:not([disabled])").wait_for()
        page.locator("#cluster-error button").click()
    field.blur()
    smoke.post("/set", key="strength", value=0.5)
    page.locator(".knob.set", has_text="strength").wait_for()
    assert [field.input_value(), field.get_attribute("class"), cards.count()] == ["local:many", "wrong", 0]
    # Tries are done on this machine, and one is told of the cluster as long as that is not closed.
    field.press("End")
    field.press_sequentially("?")
    page.locator("#try").click()
    cards.nth(0).wait_for()
    page.locator("#cluster-error").wait_for()
    assert page.locator("#error", has_text="radius").is_visible()
    field.fill("local:2")
    page.locator("#render").click()
    cards.nth(1).wait_for()
    assert page.locator("#cluster-error").is_hidden() and field.get_attribute("class") == ""
    assert json.loads((tmp_path / "out" / "renders" / "0001.json").read_text())["cluster"] == "local:2"
    shown.troubles.clear()  # the browser's own words of the refusals
    page.context.close()


def test_what_is_being_changed_is_in_what_is_tried(
    smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]
) -> None:
    page = opened(address(smoke)).page
    page.locator("#view[data-settled=yes]").wait_for()
    changes = {
        # Dragged so fast that the latest waits for the first.
        "drag": "const { id } = parts()[0]; for (const radius of [4, 5]) editSoon(id, { radius });",
        "shape": "$('add-box').click();",
        "painting": "$('brush-done').click(); $('brush-done').click();",
    }
    for number, (what, script) in enumerate(changes.items(), 1):
        if what == "painting":
            page.locator("#add-painting").click()
            page.locator("#view").click(position={"x": 300, "y": 300})
        page.evaluate(f"() => {{ {script} $('try').click(); }}")
        page.locator(".job").nth(number - 1).wait_for()
        tried = Recipe.from_toml(tmp_path / "out" / "tries" / f"{number:04d}.toml")
        assert mask_tables(tried) == mask_tables(smoke.session.recipe()), what
        assert len(mask_tables(tried)[0]) == number and mask_tables(tried)[0][0]["radius"] == 5
    page.context.close()


def test_what_is_set_by_keys_outlasts_news(smoke: Studio, opened: Callable[[str], Page]) -> None:
    page = opened(address(smoke)).page
    slider = page.locator("#knob-lam")
    slider.focus()
    step = float(slider.get_attribute("step"))
    for value in range(12):  # news comes between them
        slider.press("ArrowRight")
        smoke.session.set("strength", 0.5 + value / 100)
        page.wait_for_timeout(35)
    page.evaluate("allIsSet()")
    assert smoke.session.recipe().lam == pytest.approx(12 * step)
    # Half a number is not taken for a whole one where another tab edits the same part.
    edge = page.get_by_label("edge", exact=True)
    edge.fill("")
    edge.press_sequentially("0.")
    smoke.post("/mask", action="change", part=0, values={"strength": 0.5, "centre": [5, 8, 4]})
    expect(page.get_by_label("strength", exact=True).and_(page.locator(".part input"))).to_have_value("0.5")
    edge.press_sequentially("7")
    edge.press("Tab")
    page.evaluate("allIsSet()")
    (part,) = mask_tables(smoke.session.recipe())[0]
    assert (part["edge"], part["strength"], part["centre"]) == (0.7, 0.5, (5, 8, 4))
    # What is fixed is so for all buttons of it.
    smoke.session.start = "tries/0001", 0
    smoke.post("/set", key="strength", value=0.7)
    page.locator("#knob-motif_size[disabled]").wait_for()
    motif_size = page.locator(".knob", has=page.locator("#knob-motif_size"))
    assert [motif_size.locator(f"button:text-is('{of}')").is_disabled() for of in ("auto", "↺")] == [True, True]
    page.context.close()


def test_cards_do_not_slip_under_a_second_click_and_new_ones_are_seen(
    smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]
) -> None:
    for number in range(1, 8):
        smoke.post("/work", action="try")
        smoke.session.workshop.work(f"tries/{number:04d}").process.wait(30)
    shown = opened(address(smoke))
    page = shown.page
    page.locator(".job.failed").nth(6).wait_for()
    page.locator("#work").evaluate("(list) => { list.scrollTop = list.scrollHeight; }")
    page.locator("#try").click()
    new = page.locator(".job[data-id='tries/0008']")
    new.wait_for()
    expect(new).to_be_in_viewport(ratio=0.9)
    # A button that has come to lie under the pointer is not pressed at once, but a little later.
    asked = []
    page.on("dialog", lambda dialog: asked.append(dialog.message) or dialog.dismiss())
    box = new.locator("[data-action=delete]").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def pressed(moved: int) -> None:
        page.mouse.move(x, y + moved, steps=2)
        if moved:
            page.evaluate(
                """(by) => {
                    const above = Object.assign(document.createElement("div"), { className: "above" });
                    above.style.height = `${by}px`;
                    $("work").before(above);
                }""",
                moved,
            )
        page.mouse.down()
        page.mouse.up()

    pressed(30)
    assert asked == []
    page.wait_for_timeout(450)
    page.mouse.down()
    page.mouse.up()
    assert asked == ["Delete try 8? This cannot be undone."]
    page.evaluate("document.querySelector('.above').remove()")
    pressed(0)
    assert len(asked) == 2
    # Keys have no place.
    page.keyboard.press("Tab")
    page.evaluate("cameAt = performance.now() + 1e6")
    new.locator("[data-action=delete]").press("Enter")
    assert len(asked) == 3
    # A help that opens at the edge is read.
    views = page.locator(".knob", has=page.locator("#knob-views"))
    views.locator(".key").click()
    expect(views.locator("p")).to_be_in_viewport(ratio=0.9)
    shown.photographed("13_help")
    page.context.close()


def test_news_is_of_what_is_there(smoke: Studio, tmp_path: Path, opened: Callable[[str], Page]) -> None:
    smoke.session.notice = "this cannot be shown"
    shown = opened(address(smoke))
    page = shown.page
    page.locator("#notice", has_text="this cannot be shown").wait_for()
    page.locator("#motifs [data-key=style][data-goal=cells]").click()
    page.locator("#goals", has_text="cells").wait_for()
    assert page.locator("#notice").is_visible()
    smoke.post("/open", path="smoke")
    page.locator("#notice").wait_for(state="hidden")
    assert page.locator("#remark").is_hidden()
    sequence(tmp_path / "root" / "more")
    page.locator("#files").hover()
    # What was meant for other smoke stays, and can be taken back.
    page.locator("#files button[data-path=more]").click()
    page.locator("#all").click()
    page.locator("#remark", has_text="The goals and regions that were set stay.").wait_for()
    shown.photographed("11_stays")
    page.locator("#remark .clear").click()
    page.locator("#goals .goal").first.wait_for(state="detached")
    page.locator("#remark").wait_for(state="hidden")
    assert mask_tables(smoke.session.recipe()) == [[]] and smoke.session.recipe().views == 1
    # The network is told, and what has no such name.
    expect(page.locator("#network")).to_have_text("of the network bvlc")
    page.locator("#find").fill("zzz")
    page.locator("#motifs", has_text="nothing is called 'zzz'; a picture can be searched for too").wait_for()
    shown.photographed("12_not_found")
    page.context.close()


def test_tabs_that_nobody_sees_leave_room(smoke: Studio, browser: Any) -> None:
    """A browser has six connections to a host: with news for six tabs, nothing else would be answered."""
    context = browser.new_context(viewport={"width": SIZES[0][0], "height": SIZES[0][1]})
    look = """(as) => {
        Object.defineProperty(document, "visibilityState", { get: () => as, configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
    }"""
    tabs = []
    for _ in range(7):
        tabs.append(context.new_page())
        tabs[-1].set_default_timeout(PATIENCE)
        tabs[-1].goto(address(smoke))
        tabs[-1].locator("#goals .goal").wait_for()
        tabs[-1].evaluate(look, "hidden")
    tabs[-1].locator("#motifs button").first.wait_for()
    smoke.post("/goal", key="style", goal="cells")
    assert tabs[0].locator("#goals", has_text="cells").count() == 0
    tabs[0].evaluate(look, "visible")
    tabs[0].locator("#goals", has_text="cells").wait_for()
    smoke.post("/goal", key="style", goal="cells")
    tabs[0].locator("#goals", has_text="cells").wait_for(state="detached")
    context.close()


def test_a_frame_is_tried_again_and_again(
    tmp_path: Path, weights: Path, opened: Callable[[str], Page], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence(tmp_path / "root" / "smoke")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=2, views=1, gamma=0.2)
        studio.post("/goal", key="style", goal="net")
        shown = opened(address(studio))
        page = shown.page
        page.locator("#frame").fill("1")
        page.locator("#try").dblclick()
        job = page.locator(".job.done")
        job.wait_for()
        assert job.locator("b").inner_text() == "try 1: smoke, frame 8"
        assert job.locator("[data-action=finish]").inner_text() == "render this frame"
        assert "loss in the fixed views" in job.locator("p").first.inner_text()
        # It is opened among the frames of its input, and nothing plays on.
        page.locator("#play").click()
        job.locator("[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        assert page.locator("#play").inner_text() == "▶"
        assert [page.locator("#frame").get_attribute("max"), page.locator("#frame").input_value()] == ["2", "1"]
        page.locator("#status", has_text="try 1: smoke, frame 8").wait_for()
        assert page.locator(".job.shown").count() == 1
        page.locator("#frame").fill("0")
        page.locator("#status", has_text="was not in the try").wait_for()
        page.locator("#frame").fill("1")
        page.locator("#status", has_text="was not in the try").wait_for(state="hidden")
        # Two sliders, moved at once, are both in what is tried at once, which is that frame again.
        monkeypatch.setattr(sys, "executable", "/bin/false")
        assert page.locator("#only").is_visible()
        page.evaluate(
            """() => {
                for (const [key, value] of [["strength", 0.5], ["views", 2]]) {
                    $(`knob-${key}`).value = value;
                    $(`knob-${key}`).dispatchEvent(new Event("input"));
                }
                $("try").click();
            }"""
        )
        page.locator(".job.failed").wait_for()
        recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0002.toml")
        assert (recipe.frames, recipe.strength, recipe.views) == ("8", 0.5, 2)
        assert len(studio.session.state()["work"]) == 2
        shown.settled()
        # Without its input, what has come out is not called what was there before.
        (tmp_path / "root" / "smoke").rename(tmp_path / "root" / "moved")
        job.locator("[data-action=open]").click()
        page.locator("#mode-after.on").wait_for()
        assert "cannot be read again" in page.locator("#mode-before[disabled]").get_attribute("title")
        page.locator("#view").hover()
        page.mouse.wheel(0, -100)
        shown.settled()
        shown.photographed("10_without_input")
        page.locator("#notes", has_text="cannot be read again").locator("button").click()
        assert page.locator("#notes").is_hidden()
        # What the recipe is restricted to is told beside the buttons, and can be taken back.
        assert page.locator("#restricted").is_hidden()
        studio.session.settings.base = Recipe(frames="8")
        studio.post("/set", key="strength", value=0.4)
        expect(page.locator("#restricted-text")).to_have_text("frames 8 only")
        page.locator("#all-frames").click()
        page.locator("#restricted").wait_for(state="hidden")
        # Once it is deleted, nothing is shown, and the page begins anew.
        assert studio.post("/work", action="delete", ids=["tries/0001"]).status == 200
        page.locator("#hint").wait_for()
        page.locator("#messages", has_text="smoke").wait_for()
        page.context.close()


def test_what_is_typed_painted_and_said_outlasts_other_tabs(tmp_path: Path, opened: Callable[[str], Page]) -> None:
    sequence(tmp_path / "root" / "smoke")
    sequence(tmp_path / "root" / "other")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.post("/mask", action="add", values={"shape": "sphere", "centre": [5, 7, 4], "radius": 3})
        studio.post("/mask", action="add", values={"shape": "box", "low": [1, 1, 1], "high": [9, 9, 9]})
        shown = opened(address(studio))
        page = shown.page
        edge = page.get_by_label("edge", exact=True)
        edge.fill("0.2")
        # Another tab removes the part before it.
        studio.post("/mask", action="remove", part=0)
        page.locator(".part[data-form=sphere]").wait_for(state="detached")
        assert edge.input_value() == "0.2"
        page.keyboard.press("Enter")
        shown.settled()
        (part,) = mask_tables(studio.session.recipe())[0]
        assert (part["shape"], part["edge"]) == ("box", 0.2)
        # A refusal stays until it is closed, or something else is asked for.
        edge.fill("-5")
        page.keyboard.press("Enter")
        page.locator("#error", has_text="edge").wait_for()
        page.locator("#view").hover()
        page.mouse.wheel(0, -100)
        shown.settled()
        page.locator("#error button").click()
        assert page.locator("#error").is_hidden()
        shown.troubles.clear()  # the browser's own word on the refusal
        # Strokes wait for their smoke.
        page.locator("#add-painting").click()
        page.locator("#view").click(position={"x": 300, "y": 300})
        studio.post("/open", path="other")
        page.locator("#kept", has_text="painted over smoke is kept").wait_for()
        studio.post("/open", path="smoke")
        page.locator("#kept", has_text="paint goes on with it").wait_for()
        page.locator("#add-painting").click()
        assert page.evaluate("painting.strokes.length") == 1
        page.context.close()
