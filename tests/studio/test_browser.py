"""The page in a headless browser, from its URL to a finished run.

TNST_MI_SHOTS may name a folder for pictures of it.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from studio_page import (
    SIZES,
    Page,
    address,
    browser,
    expect,
    opened,
    playwright,
    root,
    studio_url,
)
from studios import running

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.network.shipped import shipped_weights
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe

__all__ = ["browser", "opened", "root"]


def test_look_choose_try_and_compare(root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown = opened(url)
        page = shown.page
        # The token has left the address bar, and a tab without it sees nothing.
        assert page.url.endswith("/") and "token" not in page.url
        page.locator("#motifs img").first.wait_for()
        front = shown.settled()
        width = front.shape[1] // 2
        assert front[:, :width].sum() > 3 * front[:, width + 5 :].sum() > 0
        shown.photographed("1_opened")
        # Half a turn: what was on the left is on the right.
        shown.dragged("#view", 450, 0)
        back = shown.settled()
        assert back[:, width + 5 :].sum() > 3 * back[:, :width].sum()
        page.locator("#home").click()
        assert np.abs(shown.settled() - front).max() < 0.02
        page.locator("#cut").select_option("z")
        assert np.abs(shown.settled() - front).max() > 0.2
        page.locator("#cut").select_option("none")
        # Everything is in reach at both sizes, and nothing is wider than the page.
        for wide, high in SIZES:
            page.set_viewport_size({"width": wide, "height": high})
            for selector in ("#try", "#find", "#upload", "#home", "#knobs"):
                box = page.locator(selector).bounding_box()
                assert box["x"] >= 0 and box["x"] + box["width"] <= wide and box["y"] + box["height"] <= high, selector
            assert page.evaluate("document.documentElement.scrollWidth") == wide
        page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
        # A motif, and a slider, which a second tab hears of.
        assert page.locator("#try").is_disabled()
        page.locator("#find").fill("sp")
        page.locator("#motifs [data-key=style][data-goal=spirals]").click()
        page.locator("#goals .goal", has_text="style spirals").wait_for()
        for key, value in (("iterations", 6), ("octaves", 2), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        other = opened(url)
        other.page.locator("#goals .goal", has_text="style spirals").wait_for()
        assert other.page.locator("#knob-iterations").input_value() == "6"
        other.page.locator("#knob-iterations").fill("5")
        page.locator(".knob output", has_text="5").wait_for()
        # A picture from outside.
        Image.fromarray(np.random.default_rng(1).integers(0, 255, (40, 60), np.uint8)).save(tmp_path / "my fire.jpg")
        page.locator("#find").fill("")
        page.locator("#picture").set_input_files(tmp_path / "my fire.jpg")
        page.locator("#motifs [data-key=style].on", has_text="my_fire").wait_for()
        page.locator("#goals .goal", has_text="style my_fire").locator("button").click()
        # A try, whose loss falls while one looks on.
        page.locator("#try").click()
        page.locator(".job.running").wait_for()
        page.locator(".job.done").wait_for()
        assert "loss" in page.locator(".job p").first.inner_text()
        assert other.page.locator(".job.done").count() == 1
        shown.photographed("2_tried")
        page.locator(".job button[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        wiped = shown.settled()
        # On the left is what was there before, with the exposure of the run.
        page.locator("#mode-before").click()
        before = shown.settled()
        page.locator("#mode-wipe").click()
        shown.settled()
        assert np.abs(wiped[:, : width - 10] - before[:, : width - 10]).max() < 0.05
        left, right = (side[:, : width - 10].ravel() for side in (front, wiped))
        assert np.corrcoef(left, right)[0, 1] > 0.99
        for mode in ("after", "difference", "movement"):
            page.locator(f"#mode-{mode}").click()
            assert np.abs(shown.settled() - wiped).max() > 0.1
            shown.photographed(f"3_{mode}")
        # v* as arrows and as depth, with their scale; cuts have no arrows.
        for way, text in (("arrows", "cells"), ("depth", "towards you")):
            page.locator("#moved-as").select_option(way)
            assert np.abs(shown.settled() - wiped).max() > 0.1
            assert text in page.locator("#scale-text").inner_text() and page.locator("#wheel").is_hidden()
            shown.photographed(f"3_{way}")
        page.locator("#mode-before").click()
        page.locator("#moved-as").wait_for(state="hidden")
        assert page.locator("#error").is_hidden()
        # Before the studio ends: pages would complain.
        for tab in (shown, other):
            tab.page.context.close()


def test_motifs_are_found_by_a_picture_and_shown(root: Path, tmp_path: Path, opened: Callable[[str], Page]) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", shipped_weights()) as url:
        shown = opened(url)
        page = shown.page
        first = "#motifs h3:first-child + button"
        page.locator("#compared").set_input_files(STYLES / "flames.png")
        page.locator(f"{first}[data-goal=fire]").wait_for()
        shown.photographed("6_alike")
        page.locator("#find").fill("4b/pool_proj")
        page.locator("#motifs h3", has_text="deviation").wait_for()
        page.locator("#motifs h3", has_text="tags").wait_for(state="detached")
        # What is no picture is told, and names find as before.
        (tmp_path / "not.png").write_text("no picture")
        page.locator("#compared").set_input_files(tmp_path / "not.png")
        page.locator("#error", has_text="not a picture").wait_for()
        page.locator("#sample").wait_for(state="hidden")
        shown.troubles.clear()  # the browser's own word on the refusal
        # A dropped one is compared with where one searches, and is no style.
        page.locator("#find").fill("")
        page.evaluate(
            """async () => {
                const data = new DataTransfer();
                const picture = await (await fetch("thumbnail?style=spirals")).blob();
                data.items.add(new File([picture], "dropped.png"));
                document.querySelector("#find").dispatchEvent(
                    new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
            }"""
        )
        page.locator(f"{first}[data-goal=spiral]").wait_for()
        assert not (tmp_path / "out" / "pictures").exists()
        page.locator("#sample-end").click()
        page.locator(f"{first}[data-goal=cells]").wait_for()
        # What one tag looks like.
        page.locator("#find").fill("honeycomb")
        page.locator("#examples", has_text="what it looks like").click()
        page.locator("#motifs [data-key=tag] img").wait_for()
        page.locator("#examples").wait_for(state="hidden")
        shown.photographed("7_looks_like")
        shown.page.context.close()


def test_a_render_outlives_the_page_and_the_studio(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        page = opened(url).page
        page.locator("#motifs [data-key=style][data-goal=net]").click()
        for key, value in (("iterations", 40), ("octaves", 2), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#render").click()
        page.locator(".job.running p", has_text="loss").wait_for()
        page.context.close()
    with studio_url(root, tmp_path / "out", weights) as url:
        shown = opened(url)
        shown.page.locator(".job.done").wait_for()
        shown.photographed("4_outlived")
        shown.page.locator(".job button[data-action=open]").click()
        shown.page.locator("#mode-wipe.on").wait_for()
        shown.page.locator("#look").select_option("thick")
        shown.page.locator("#lit").check()
        shown.page.locator("#status", has_text="pass 4").wait_for()
        assert shown.view().std() > 0.05
        shown.page.locator("#lit").uncheck()
        shown.page.locator("#status", has_text="pass").wait_for(state="hidden")
        shown.photographed("5_reopened")
        shown.page.context.close()


def test_regions_are_shaped_and_painted_in_the_view(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown, other = opened(url), opened(url)
        page, drawing = shown.page, shown.page.locator("#gizmos")
        plain = shown.settled()
        page.locator("#add-box").click()
        page.locator(".part.on[data-form=box]").wait_for()
        # What is in the box is red, and so less bright; the rest is as it was.
        coloured = shown.settled()
        assert (coloured < plain - 0.1).sum() > 500
        shown.photographed("6_box")

        def handle(name: str) -> tuple[float, float]:
            box, places = page.locator("#view").bounding_box(), dict(json.loads(drawing.get_attribute("data-handles")))
            return box["x"] + places[name][0], box["y"] + places[name][1]

        def number(label: str) -> float:
            return float(page.get_by_label(label, exact=True).input_value())

        def dragged(name: str, right: float, down: float) -> None:
            x, y = handle(name)
            page.mouse.move(x, y)
            page.mouse.down()
            page.mouse.move(x + right, y + down, steps=5)
            page.mouse.up()
            shown.settled()

        # Pixels of a cell, by which a face moves if it is dragged, here and in perspective.
        (left, _), (right, _) = handle("low x"), handle("high x")
        pixels = (right - left) / (number("high x") - number("low x"))
        before = number("high x"), number("low x")
        dragged("high x", 3 * pixels, 20)
        assert number("high x") == pytest.approx(before[0] + 3, abs=0.1) and number("low x") == before[1]
        dragged("centre", -pixels, 2 * pixels)
        assert number("low x") == pytest.approx(before[1] - 1, abs=0.1)
        page.locator("#perspective").check()
        shown.settled()
        x, y = handle("high y")
        dragged("high y", 0, 2 * pixels)
        assert handle("high y") == pytest.approx((x, y + 2 * pixels), abs=1.5)
        shown.photographed("7_perspective")
        # A sphere, whose numbers can be typed, and which another tab has too.
        page.locator("#add-sphere").click()
        page.locator(".part.on[data-form=sphere]").wait_for()
        page.get_by_label("radius", exact=True).fill("6.5")
        page.get_by_label("radius", exact=True).press("Enter")
        other.page.locator(".part[data-form=sphere] .head button").first.click()
        playwright.expect(other.page.get_by_label("radius", exact=True)).to_have_value("6.5")
        dragged("edge", 20, 0)
        page.locator(".part.on [data-key=invert]").check()
        shown.settled()
        shown.photographed("8_sphere")
        page.locator(".part.on [data-key=invert]").uncheck()
        # Paint: a disc, where the view has been panned and zoomed; a stroke that is undone, and one that is erased.
        page.locator("#home").click()
        page.locator("#add-painting").click()
        assert not page.locator("#perspective").is_checked()
        area = page.locator("#view").bounding_box()
        x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
        page.mouse.move(x, y)
        page.mouse.wheel(0, -300)
        page.mouse.down(button="right")
        page.mouse.move(x + 90, y + 40, steps=3)
        page.mouse.up(button="right")
        shown.settled()
        camera = page.evaluate("view")
        page.locator("#brush-size").fill("0.25")
        page.locator("#brush-soft").fill("0")
        spot = x + 40, y + 100
        page.mouse.click(*spot)
        page.mouse.click(x - 130, y - 120)
        page.locator("#brush-undo").click()
        page.mouse.click(x - 130, y - 120)
        page.locator("#brush-erase").click()
        page.mouse.click(x - 130, y - 120)
        shown.photographed("9_painting")
        page.locator("#brush-done").click()
        page.locator(".part.on[data-form=image]").wait_for()
        shown.settled()
        shown.photographed("9_painted")
        # The cells that the disc covers, from the pixel alone.
        cell = camera["height"] / area["height"]
        across = camera["right"] + (spot[0] - x) * cell
        upwards = camera["up"] - (spot[1] - y) * cell
        with Image.open(tmp_path / "out" / "masks" / "0001.png") as kept:
            alpha = np.asarray(kept)[..., 1] / 255
        rows, columns = 20, 16
        places = [np.arange(n) - (n - 1) / 2 for n in (rows, columns)]
        distance = np.hypot(places[0][::-1, None] - upwards, places[1] - across)
        pixel = alpha.shape[0] / rows
        sampled = alpha[np.ix_(*[((np.arange(n) + 0.5) * pixel).astype(int) for n in (rows, columns)])]
        clear = np.abs(distance - 2.5) > 0.1
        assert 5 < (distance < 2.5).sum() < 30
        np.testing.assert_array_equal(sampled[clear], (distance < 2.5)[clear])
        # They are part of what is tried, and of what is opened again.
        page.locator("#share", has_text="is in all of these").wait_for()
        page.locator("#motifs [data-key=style][data-goal=net]").click()
        for key, value in (("iterations", 3), ("octaves", 1), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        page.locator(".job.done").wait_for()
        recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0001.toml")
        assert [part.get("shape", "image") for part in recipe.mask] == ["box", "sphere", "image"]
        assert recipe.mask[2]["image"] == str(tmp_path / "out" / "masks" / "0001.png")
        while page.locator(".part").count():
            count = page.locator(".part").count()
            page.locator(".part .head button[title=remove]").first.click()
            page.locator(".part").nth(count - 1).wait_for(state="detached")
        page.locator(".job button[data-action=open]").click()
        page.locator(".part[data-form=image]").wait_for()
        # Results are seen as they are; a part that is chosen is shown with its handles, until they are compared again.
        shows = page.locator("#masks-shown")
        expect(shows).not_to_be_checked()
        clear = shown.settled()
        page.locator(".part[data-form=box] .head button").first.click()
        expect(shows).to_be_checked()
        assert (np.abs(shown.settled() - clear) > 0.1).sum() > 500
        assert {name for name, _ in json.loads(drawing.get_attribute("data-handles"))} >= {"low x", "high x", "centre"}
        page.locator("#mode-after").click()
        expect(shows).not_to_be_checked()
        page.locator("#mode-wipe").click()
        assert np.abs(shown.settled() - clear).max() < 0.02
        other.page.locator(".part").nth(2).wait_for()
        shown.settled()
        shown.photographed("9_reopened")
        assert page.locator("#error").is_hidden()
        for tab in (shown, other):
            tab.page.context.close()


def test_tries_are_gone_on_from_and_deleted(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown, other = opened(url), opened(url)
        page = shown.page
        page.locator("#motifs [data-key=style][data-goal=spirals]").click()
        for key, value in (("iterations", 6), ("octaves", 3), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        first, second = (page.locator(f".job[data-id='tries/000{number}']") for number in (1, 2))
        page.locator(".job.done").wait_for()
        # From the end of the first octave, with the settings that may differ.
        first.locator("[data-action=branch]").click()
        assert first.locator(".states button").count() == 2
        first.locator(".states img").last.wait_for()
        shown.photographed("6_states")
        first.locator(".states [data-octave='0']").click()
        for tab in (page, other.page):
            tab.locator("#start", has_text="goes on from try 1, end of octave 1").wait_for()
        assert page.locator("#knob-motif_size").is_disabled() and page.locator("#knob-eta").is_enabled()
        # An address that means no cluster is told at once; of one that does, all tabs hear.
        page.locator("#cluster").fill("local:many")
        page.locator("#cluster").blur()
        page.locator("#cluster-error", has_text="expected local:N").wait_for()
        shown.troubles.clear()  # the browser's own words of the refusal
        page.locator("#cluster").fill("local:2")
        page.locator("#cluster").blur()
        expect(other.page.locator("#cluster")).to_have_value("local:2")
        assert page.locator("#cluster-error").is_hidden()
        shown.photographed("7_going_on")
        for key, value in (("iterations", 60), ("views", 8)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        second.locator("p", has_text="from try 1, octave 2").wait_for()
        # All but the chosen, after a question; what runs is stopped first.
        first.locator("input[type=checkbox]").check()
        questions = []
        page.once("dialog", lambda dialog: questions.append(dialog.message) or dialog.dismiss())
        page.locator("#clear").click()
        page.once("dialog", lambda dialog: questions.append(dialog.message) or dialog.accept())
        assert second.count() == 1
        page.locator("#clear").click()
        second.wait_for(state="detached")
        question = "Delete the other try, all but the chosen? It is stopped first. This cannot be undone."
        assert questions == [question] * 2
        assert [other.page.locator(".job").count(), first.count()] == [1, 1]
        assert not (tmp_path / "out" / "tries" / "0002").exists()
        # Nothing goes on from what is gone.
        page.once("dialog", lambda dialog: dialog.accept())
        first.locator("[data-action=delete]").click()
        page.locator("#start").wait_for(state="hidden")
        shown.photographed("8_deleted")
        for tab in (shown, other):
            tab.page.context.close()


def test_smoke_takes_on_colours_on_the_page(tmp_path: Path, weights: Path, opened: Callable[[str], Page]) -> None:
    (tmp_path / "root").mkdir()
    density = np.zeros((14, 20, 16), np.float32)
    density[3:11, 4:16, 3:13] = np.random.default_rng(0).random((8, 12, 10), np.float32)
    save_frames(tmp_path / "root", [Frame(density, name="smoke")])
    pixels = np.full((40, 40, 3), (255, 90, 0), np.uint8)
    pixels[::4] = (0, 0, 90)
    Image.fromarray(pixels).save(tmp_path / "ember.png")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=8, views=2, colour_eta=0.2)
        shown = opened(address(studio))
        page = shown.page
        studio.post("/open", path="smoke.npz")
        page.locator("#picture").set_input_files(tmp_path / "ember.png")
        page.locator("#goals .goal", has_text="ember").wait_for()
        shown.settled()
        assert page.locator("#in-colour").is_hidden()
        page.locator("#knob-colour").select_option("style")
        page.locator(".knob.set", has=page.locator("#knob-colour")).wait_for()
        page.locator("#knob-colour_weight").fill("2")
        page.locator("#try").click()
        page.locator(".job.done").wait_for()
        recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0001.toml")
        assert (recipe.colour, recipe.colour_weight) == ("style", 2.0)
        page.locator(".job button[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        page.locator("#mode-after").click()
        shown.settled()

        def picture() -> np.ndarray:
            seen = Image.open(io.BytesIO(page.locator("#view").screenshot())).convert("RGB")
            return np.asarray(seen, int)[50:-40]

        coloured = picture()
        assert (coloured[..., 0] - coloured[..., 2]).max() > 60
        assert page.locator("#knob-colour").input_value() == "style"
        shown.photographed("13_in_colour")
        page.locator("#mode-wipe").click()
        shown.settled()
        shown.photographed("14_wiped_in_colour")
        page.locator("#mode-after").click()
        page.locator("#coloured").uncheck()
        shown.settled()
        assert np.ptp(picture(), axis=-1).max() < 10
        # What was chosen can be taken back.
        back = page.locator(".knob", has=page.locator("#knob-colour")).get_by_title("as it was")
        back.wait_for(state="hidden")
        page.locator("#knob-colour").select_option("off")
        back.click()
        expect(page.locator("#knob-colour")).to_have_value("style")
        page.context.close()
