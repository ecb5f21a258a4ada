"""Masks on the page: edited, painted, seen in the smoke, and part of what is tried."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from studios import Studio, running

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame, Placement
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.masks import MaskEdit, mask_tables
from tnst_mi.studio.choices.settings import StudioSettings
from tnst_mi.studio.page.server import LARGEST_UPLOAD
from tnst_mi.studio.view.opened import opened
from tnst_mi.studio.view.painting import SightPainter
from tnst_mi.studio.view.sight import Sight

SHAPE = (10, 12, 8)

#: In metres, Z up: a cell is half a metre, and the lowest one is centred at (1, 2, 3).
PLACEMENT = Placement(0.5, (1.0, 2.0, 3.0), "z")

BOX = {"shape": "box", "low": [1.0, 1.0, 1.0], "high": [5.0, 9.0, 8.0]}


def frames(count: int = 3, placement: Placement | None = None, velocity: float | None = None) -> list[Frame]:
    density = np.zeros(SHAPE, np.float32)
    density[1:9, 1:11, 1:7] = np.random.default_rng(0).random((8, 10, 6), np.float32) + 0.1
    wind = None if velocity is None else np.full((*SHAPE, 3), (velocity, 0, 0), np.float32)
    return [Frame(density, wind, name=f"f_{n:02d}", number=n, placement=placement) for n in range(7, 7 + count)]


@pytest.fixture
def studio(tmp_path: Path) -> Iterator[Studio]:
    save_frames(tmp_path / "root" / "smoke", frames(velocity=1.0))
    save_frames(tmp_path / "root" / "placed", frames(1, PLACEMENT), "vdb")
    with running(tmp_path / "root", tmp_path / "out") as started:
        assert started.post("/open", path="smoke").status == 200
        yield started


def painting(alpha: np.ndarray) -> bytes:
    """A picture in green that is as opaque as an array (rows, columns) of 8 bits says."""
    pixels = np.zeros((*alpha.shape, 4), np.uint8)
    pixels[..., 1], pixels[..., 3] = 200, alpha
    written = io.BytesIO()
    Image.fromarray(pixels).save(written, "PNG")
    return written.getvalue()


def paint(studio: Studio, body: bytes, **query: object) -> tuple[int, str]:
    asked = {"target": 0, "azimuth": 0, "elevation": 0, "frame": 0} | query
    reply = studio.request("POST", "/painting?" + "&".join(f"{name}={value}" for name, value in asked.items()), body)
    return reply.status, reply.values.get("error", "")


# ---------------------------------------------------------------- editing


def test_parts_are_added_changed_and_removed(studio: Studio) -> None:
    news = studio.session.news()
    next(news)
    assert studio.post("/mask", action="add", target=0, values=BOX).status == 200
    sphere = {"shape": "sphere", "centre": [3, 5, 4], "radius": 3}
    assert studio.post("/mask", action="add", target=0, values=sphere).status == 200
    assert studio.post("/mask", action="change", target=0, part=0, values={"edge": 1.5, "invert": True}).status == 200
    first, second = mask_tables(studio.session.recipe())[0]
    assert first == {**BOX, "low": (1, 1, 1), "high": (5, 9, 8), "edge": 1.5, "invert": True}
    assert second == {"shape": "sphere", "centre": (3, 5, 4), "radius": 3}
    assert '"edge": 1.5' in next(news)  # every tab hears of it
    assert studio.post("/mask", action="change", target=0, part=0, values={"edge": None}).status == 200
    assert "edge" not in mask_tables(studio.session.recipe())[0][0]
    for _ in range(2):
        assert studio.post("/mask", action="remove", target=0, part=0).status == 200
    assert studio.session.recipe().mask is None


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        ({"action": "add", "values": {"image": "/etc/passwd", "view": [0, 0]}}, "sets no 'image'"),
        ({"action": "add", "values": {"file": "/etc/passwd"}}, "sets no 'file'"),
        ({"action": "change", "values": {"grid": "heat"}}, "sets no 'grid'"),
        ({"action": "add", "values": {"shape": "box", "low": [0, 0, 0]}}, "needs high"),
        ({"action": "add", "values": {"shape": "cone"}}, "sphere"),
        ({"action": "change", "values": {"low": [9, 0, 0]}}, "expected the lower first"),
        ({"action": "change", "values": {"high": [float("nan"), 9, 9]}}, "three numbers"),
        ({"action": "change", "values": {"edge": -1}}, "0 or more"),
        ({"action": "change", "values": {"strength": 2}}, "from 0 to 1"),
        ({"action": "change", "values": {"radius": 1}}, "radius does not belong to"),
        ({"action": "change", "part": 1, "values": {"edge": 1}}, "there are 1"),
        ({"action": "change", "part": -1, "values": {"edge": 1}}, "there are 1"),
        ({"action": "remove", "target": 1}, "there are 1"),
        ({"action": "remove", "part": True}, "whole numbers"),
        ({"action": "remove", "part": None}, "whole numbers"),
        ({"action": "change", "values": [1]}, "table"),
        ({"action": "change", "frame": 3, "values": {"edge": 1}}, "there are 3"),
        ({"action": "change", "frame": "x", "values": {"edge": 1}}, "index of a frame"),
        ({"action": "paint"}, "expected one of add"),
    ],
)
def test_edits_that_cannot_be_are_refused_in_one_line(studio: Studio, edit: dict[str, object], message: str) -> None:
    studio.post("/mask", action="add", target=0, values=BOX)
    before = studio.session.recipe()
    refused = studio.post("/mask", **edit)
    assert refused.status == 400
    assert message in refused.error and "\n" not in refused.error
    assert studio.session.recipe() == before


def test_a_mask_has_a_bounded_number_of_parts(studio: Studio) -> None:
    replies = [studio.post("/mask", action="add", values=BOX) for _ in range(17)]
    assert [reply.status for reply in replies] == [200] * 16 + [400]
    assert "remove some" in replies[-1].error


def test_what_cannot_be_evaluated_can_be_removed(studio: Studio) -> None:
    studio.session.settings.base = Recipe(mask=({"grid": "heat"}, {"grid": "oxygen"}))
    for grid in ("heat", "oxygen"):
        assert f"'{grid}'" in studio.get("/share", target=0, frame=0).error
        # The smoke is seen all the same.
        plain = studio.get("/view", mode="before")
        assert plain.status == 200 and studio.get("/view", mask=0, mode="before").body == plain.body
        assert studio.post("/mask", action="remove", target=0, part=0).status == 200
    assert studio.get("/share", target=0, frame=0).values == {"share": None}


def test_each_target_has_its_own_mask() -> None:
    recipe = Recipe(target=({"style": "net", "mask": "heat"}, {"tag": "spiral", "weight": 0.5}))
    settings = StudioSettings(recipe.located(Path.cwd()))
    settings = settings.edited(MaskEdit("add", 1, values={"shape": "sphere", "centre": [0, 0, 0], "radius": 2}))
    settings = settings.edited(MaskEdit("change", 0, 0, {"strength": 0.25}))
    assert mask_tables(settings.recipe)[0] == [{"grid": "heat", "strength": 0.25}]
    assert settings.recipe.target[1]["weight"] == 0.5 and settings.recipe.target[1]["tag"] == ("spiral",)
    described = settings.described()["masks"]
    assert [target["title"] for target in described] == ["1: style net", "2: tag spiral"]
    assert [part["title"] for target in described for part in target["parts"]] == ["grid heat", "sphere"]
    settings = settings.edited(MaskEdit("remove", 0, 0))
    assert "mask" not in settings.recipe.target[0]


def test_keyframes_of_other_keys_stay(studio: Studio) -> None:
    keyed = {"shape": "sphere", "centre": {7: [0, 0, 0], 9: [6, 6, 6]}, "radius": 3}
    studio.session.settings.base = Recipe(mask=keyed)
    assert studio.post("/mask", action="change", target=0, part=0, values={"strength": 0.5}).status == 200
    (part,) = mask_tables(studio.session.recipe())[0]
    assert part["centre"] == {7: (0, 0, 0), 9: (6, 6, 6)} and part["strength"] == 0.5


def test_following_begins_in_the_shown_frame(studio: Studio) -> None:
    studio.post("/mask", action="add", values=BOX)
    assert studio.post("/mask", action="change", part=0, frame=1, values={"follow": True}).status == 200
    assert mask_tables(studio.session.recipe())[0][0]["follow"] == 8
    # A frame alone does not know how smoke has moved to it.
    studio.post("/goal", key="style", goal="net")
    refused = studio.post("/work", action="try", alone=2)
    assert refused.status == 400 and "from frame 8, which a try of frame 9 alone does not have" in refused.error
    # In the wind of one cell per frame the box has moved by one cell.
    masks = [studio.session.opened().painter.masks.mask(studio.session.recipe(), 0, index) for index in (1, 2)]
    np.testing.assert_allclose(masks[1][:, :, 1:], masks[0][:, :, :-1], atol=1e-5)


def test_ids_stay_with_their_parts(studio: Studio) -> None:
    sphere = {"shape": "sphere", "centre": [3, 5, 4], "radius": 3}
    for values in (sphere, BOX, sphere):
        studio.post("/mask", action="add", values=values)

    def ids() -> list[int]:
        return [part["id"] for part in studio.session.state()["masks"][0]["parts"]]

    first, box, last = ids()
    # One tab removes what another one does not know to be gone.
    assert studio.post("/mask", action="remove", id=first).status == 200
    assert studio.post("/mask", action="change", id=box, values={"edge": 0.2}).status == 200
    assert ids() == [box, last] and mask_tables(studio.session.recipe())[0][0]["edge"] == 0.2
    before = studio.session.recipe()
    for action in ("change", "remove"):
        refused = studio.post("/mask", action=action, id=first, values={"edge": 0.5})
        assert refused.status == 400 and "this region is gone" in refused.error
    for identity in ("x", 1.5, True):
        assert studio.post("/mask", action="remove", id=identity).status == 400
    assert studio.session.recipe() == before
    # Parts of another recipe have other ids, though there are as many.
    studio.session.settings = StudioSettings(before)
    assert not {first, box, last} & set(ids())


# ---------------------------------------------------------------- where it is


def test_the_place_of_a_frame_is_in_the_units_of_its_masks(studio: Studio) -> None:
    assert studio.get("/place", frame=0).values == {
        "to_scene": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
        "smoke": [[1, 1, 1], [6, 10, 8]],
    }
    studio.post("/open", path="placed")
    placed = studio.get("/place", frame=0).values
    # Our x is X, our y is Z, and our z runs along −Y.
    assert placed["to_scene"] == [[0.5, 0, 0, 1], [0, 0, -0.5, 2 + 0.5 * 9], [0, 0.5, 0, 3]]
    assert placed["smoke"] == [[1.5, 2.5, 3.5], [4, 6, 8]]
    for query in ({"frame": 1}, {"frame": "nan"}, {"frame": 0.5}, {"frame": -1}, {}):
        assert studio.get("/place", **query).status == 400


# ---------------------------------------------------------------- painting


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (90, 0), (0, 90), (30, -20), (-135, 40)])
def test_a_painted_blob_covers_the_cells_behind_it(studio: Studio, azimuth: float, elevation: float) -> None:
    rows, columns = 240, 160  # the view is 12 × 8 cells
    row, column = np.mgrid[:rows, :columns] + 0.5
    centre, radius = (100.0, 90.0), 45.0
    body = painting(np.where(np.hypot(row - centre[0], column - centre[1]) < radius, 255, 0).astype(np.uint8))
    assert paint(studio, body, azimuth=azimuth, elevation=elevation) == (200, "")
    (part,) = mask_tables(studio.session.recipe())[0]
    assert part["view"] == (azimuth, elevation)
    mask = studio.session.opened().painter.masks.mask(studio.session.recipe(), 0, 0)
    # Turn the smoke instead of the camera: around y by −azimuth, then around x by elevation.
    a, e = np.radians([-azimuth, elevation])
    around_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    around_x = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
    z, y, x = np.indices(SHAPE) - (np.reshape(SHAPE, (3, 1, 1, 1)) - 1) / 2
    seen_x, seen_y, _ = np.einsum("ij,jzyx->izyx", around_x @ around_y, np.stack([x, y, z]))
    distance = np.hypot(20 * seen_x + columns / 2 - centre[1], rows / 2 - 20 * seen_y - centre[0])
    # Within a pixel of the blob's border it is in part.
    clear = np.abs(distance - radius) > 1.5
    assert clear.mean() > 0.8 and 20 < (distance < radius).sum() < mask.size / 2
    np.testing.assert_array_equal(mask[clear], (distance < radius)[clear])


def test_a_painting_is_kept_as_white_and_as_opaque_as_it_was(studio: Studio, tmp_path: Path) -> None:
    alpha = np.random.default_rng(1).integers(0, 256, (24, 16), np.uint8)
    for body in (painting(alpha), painting(np.full((24, 16), 255, np.uint8))):
        assert paint(studio, body) == (200, "")
    files = sorted((tmp_path / "out" / "masks").iterdir())
    assert [file.name for file in files] == ["0001.png", "0002.png"]
    with Image.open(files[0]) as kept:
        assert kept.mode == "LA" and not kept.info
        np.testing.assert_array_equal(np.asarray(kept), np.stack([np.full_like(alpha, 255), alpha], -1))
    # What is opaque everywhere counts everywhere.
    studio.post("/mask", action="remove", part=0)
    assert (studio.session.opened().painter.masks.mask(studio.session.recipe(), 0, 0) == 1).all()


OPAQUE = painting(np.full((24, 16), 255, np.uint8))


@pytest.mark.parametrize(
    ("body", "query", "message"),
    [
        (b"", {}, "picture"),
        (OPAQUE[:-30], {}, "picture"),
        (painting(np.zeros((24, 16), np.uint8)), {}, "wholly transparent"),
        (painting(np.full((24, 24), 255, np.uint8)), {}, "expected the proportions of the view, 8×12"),
        (painting(np.full((3072, 2048), 255, np.uint8)), {}, "at most 2048"),
        (OPAQUE, {"target": 1}, "there are 1"),
        (OPAQUE, {"target": "x"}, "expected a number"),
        (OPAQUE, {"azimuth": "nan"}, "expected a number"),
        (OPAQUE, {"elevation": "1e999"}, "expected a number"),
        (OPAQUE, {"frame": 3}, "there are 3"),
    ],
)
def test_what_is_no_painting_is_refused_and_not_kept(
    studio: Studio, tmp_path: Path, body: bytes, query: dict[str, object], message: str
) -> None:
    status, error = paint(studio, body, **query)
    assert status == 400
    assert message in error and "\n" not in error and "/tmp/tnst" not in error
    assert not list((tmp_path / "out").glob("masks/*"))
    assert studio.session.recipe().mask is None


def test_a_picture_without_transparency_is_no_painting(studio: Studio) -> None:
    written = io.BytesIO()
    Image.new("L", (16, 24), 255).save(written, "PNG")
    assert "has no transparency" in paint(studio, written.getvalue())[1]


def test_paintings_need_the_token_and_are_bounded(studio: Studio) -> None:
    for path in ("/mask", "/painting?target=0", "/place?frame=0", "/regions.js"):
        assert studio.request("POST", path, b"{}", Cookie="").status == 403
        assert studio.request("GET", path, Cookie="").status == 403
    for path in ("/mask", "/painting"):
        assert studio.request("POST", path, b"{}", Origin="http://127.0.0.1:1").status == 403
    assert studio.request("POST", "/painting", b"x", Content_Length=str(LARGEST_UPLOAD + 1)).status == 413


# ---------------------------------------------------------------- seeing it


def test_the_smoke_is_coloured_by_the_mask_along_each_ray(studio: Studio) -> None:
    painter = SightPainter(opened(studio.session.places.within("smoke")))
    sphere = {"shape": "sphere", "centre": [3.5, 5.5, 4.5], "radius": 6, "edge": 4}
    recipe = Recipe(gamma=0.05, mask=sphere)
    sight = Sight(mode="before", height=12, rows=12, columns=8)
    plain = painter.paint(sight, recipe)
    picture = painter.paint(Sight(mode="before", height=12, rows=12, columns=8, mask=0), recipe)
    density, mask = frames()[0].density, painter.masks.mask(recipe, 0, 0)
    # Through the middle of columns of cells, whose ends are samples too.
    smoke = density.sum(0)[::-1]
    share = np.divide((density * mask).sum(0)[::-1], smoke, out=np.zeros_like(smoke), where=smoke > 0)
    assert share.max() > 0.6 and share[smoke > 0].min() < 0.2
    np.testing.assert_allclose(picture[..., 0], plain, atol=1e-6)
    green = np.divide(picture[..., 1], plain, out=np.ones_like(plain), where=plain > 0)
    np.testing.assert_allclose(green[smoke > 0], 1 - 0.64 * share[smoke > 0], atol=0.005)


def test_while_the_camera_moves_the_mask_is_where_it_is_when_it_is_still(studio: Studio) -> None:
    painter = SightPainter(opened(studio.session.places.within("smoke")))
    recipe = Recipe(gamma=0.05, mask={"shape": "sphere", "centre": [3.5, 5.5, 4.5], "radius": 6, "edge": 4})
    moving, still = (
        painter.paint(Sight(mode="before", height=14, rows=141, columns=97, mask=0, coarse=coarse), recipe)
        for coarse in (True, False)
    )
    assert moving.shape == still.shape == (141, 97, 3)
    # Twice as coarse, it differs most where the smoke begins.
    assert np.abs(moving - still).mean() < 0.01 * still.mean()


def test_a_cut_shows_the_mask_itself(studio: Studio) -> None:
    painter = SightPainter(opened(studio.session.places.within("smoke")))
    recipe = Recipe(mask=BOX)
    picture = painter.paint(Sight(mode="before", rows=12, columns=8, cut=("z", 0.5), mask=0), recipe)
    density = np.clip(painter.opened.frame("before", 0).full.density[5, ::-1], 0, 1)
    inside = np.zeros((12, 8), bool)
    inside[12 - 10 : 12 - 1, 1:6] = True
    np.testing.assert_allclose(picture[..., 1], density * np.where(inside, 0.36, 1.0), atol=1e-6)


def test_the_share_of_the_smoke_in_a_mask(studio: Studio) -> None:
    assert studio.get("/share", target=0, frame=0).values == {"share": None}
    studio.post("/mask", action="add", values=BOX)
    studio.post("/mask", action="change", part=0, values={"strength": 0.5})
    density = frames()[0].density.astype(np.float64)
    inside = density[1:9, 1:10, 1:6].sum() / density.sum()
    assert studio.get("/share", target=0, frame=0).values["share"] == pytest.approx(inside / 2, rel=1e-5)
    assert studio.get("/share", target=0, frame=3).status == 400


def test_without_a_mask_nothing_is_coloured(studio: Studio) -> None:
    painter = SightPainter(opened(studio.session.places.within("smoke")))
    for recipe, target in ((Recipe(), 0), (Recipe(mask=BOX), 5)):
        assert painter.paint(Sight(mode="before", mask=target), recipe).ndim == 2
    with pytest.raises(InputError, match="from 0 to 999"):
        Sight.of_query({"mask": "-1"}, 1)
