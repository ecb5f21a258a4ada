"""The pictures of the view: by emission and absorption, as the network sees the smoke, from wherever the camera is."""

from __future__ import annotations

from collections.abc import Callable

import mitsuba as mi
import numpy as np
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.losses.pictures import resized
from tnst_mi.machine.turns import turn
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering import looks
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.coloured_renderer import ColouredRenderer
from tnst_mi.rendering.exposure import exposure_for
from tnst_mi.rendering.levels import by_cell
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer
from tnst_mi.run.panels import both_coloured, difference, on_canvas
from tnst_mi.studio.view.movement import Arrows, MovingSmoke, arrows_on, cut_movement, lattice_of
from tnst_mi.studio.view.opened import AFTER, BEFORE, Opened, ShownGrid
from tnst_mi.studio.view.overlay import MaskedSmoke, MaskOverlay, tinted
from tnst_mi.studio.view.sight import AS_SEEN, Sight
from tnst_mi.studio.view.wheel import coloured, coloured_by_depth

#: Views whose brightest pixel is white, if it is the brightest.
_MEASURED_FROM = ((0.0, 0.0), (90.0, 0.0), (45.0, 20.0))

#: γ at which smoke hides nothing, and an image is the smoke along each ray.
_TRANSPARENT = 1e-6

#: Axes of the grid (z, y, x) by name, and those that a picture across them shows from bottom to top, left to right.
_AXES = {"x": (2, (1, 0)), "y": (1, (0, 2)), "z": (0, (1, 2))}


class SightPainter:
    """Paints what is opened.

    Args:
        opened: an input or a run.

    Attributes:
        masks: where the masks of recipes are in it.
    """

    def __init__(self, opened: Opened) -> None:
        self.opened, self.masks = opened, MaskOverlay(opened)
        self._moving: tuple[int, MovingSmoke] | None = None
        #: What has been measured, by γ and quadrature; a cache of methods would keep the frames for as long as itself.
        self._exposures: dict[tuple[float, str], float] = {}
        self._differences: dict[tuple[int, float, str, bool], float] = {}

    def index(self, frame: int) -> int:
        """The index of a frame, if it is one.

        Raises:
            InputError: it is none.
        """
        count = len(self.opened.results.frames)
        if not 0 <= frame < count:
            raise InputError(f"studio: frame {frame}: there are {count}, from 0")
        return frame

    def paint(self, sight: Sight, recipe: Recipe) -> np.ndarray:
        """A picture (rows, columns) or (rows, columns, 3), values for the display in [0, 1].

        Args:
            sight: what is asked for, not lit.
            recipe: whose γ and quadrature count where the smoke is seen as the network sees it.

        Raises:
            InputError: there is no v*, or a file cannot be read.
        """
        if sight.mode not in (BEFORE, AFTER):
            self._require_run(sight.mode)
        picture = self._cut(sight) if sight.cut else self._marched(sight, recipe)
        picture = np.clip(picture, 0.0, 1.0)
        # Differences and movements have colours of their own.
        if sight.mask is None or sight.mode not in (BEFORE, AFTER):
            return picture
        try:
            masked = self.masks.smoke(recipe, sight.mask, sight.frame, sight.mode)
        except InputError:  # the smoke is seen all the same; the page hears why from `Session.share`
            return picture
        return picture if masked is None else tinted(picture, self._share(sight, masked))

    def _share(self, sight: Sight, masked: MaskedSmoke) -> np.ndarray:
        """A mask as its mean over the smoke along each ray, (rows, columns) in [0, 1]; 0 where there is no smoke."""
        if sight.cut:
            return _fitted(_oriented(*sight.cut, self.opened.shape)(masked.mask), sight.rows, sight.columns)
        # While the camera moves, a quarter of the rays has to do.
        shrink = 2 if sight.coarse else 1
        grid, size = self._grid(sight.mode, sight), (sight.rows // shrink, sight.columns // shrink)
        smoke, inside = (
            self._image(grid, values, _TRANSPARENT, "paper", sight.camera, size)
            for values in (grid.tensor, masked.coarse if sight.coarse else masked.full)
        )
        share = np.clip(np.where(smoke > 0, inside / np.maximum(smoke, 1e-30), 0.0), 0.0, 1.0)
        return resized(share, sight.rows, sight.columns) if sight.coarse else share

    def arrows(self, sight: Sight) -> Arrows:
        """v* as arrows in the picture of a sight.

        Raises:
            InputError: there is no v*, or the sight is a cut.
        """
        self._require_run("movement")
        if sight.cut:
            raise InputError("view: arrows are of the whole smoke; take the cut away, or colours")
        lattice = lattice_of(sight)
        axes = sight.camera.axes
        smoke, (right, up) = self._mean_movement(lattice, axes[:2])
        return arrows_on(lattice, sight, smoke, right, up, self._moving_smoke(sight.frame).usual)

    def _require_run(self, mode: str) -> None:
        if not self.opened.has_after:
            raise InputError(f"view: {mode} is of a run, before and after; open one")

    def _marched(self, sight: Sight, recipe: Recipe) -> np.ndarray:
        gamma, quadrature = self.optics(sight, recipe)
        exposure = self.exposure(sight, recipe)

        def image(side: str, coloured: bool = sight.coloured) -> np.ndarray:
            grid, size = self._grid(side, sight), (sight.rows, sight.columns)
            return exposure * self._seen(grid, gamma, quadrature, sight.camera, size, coloured)

        if sight.mode == "difference":
            largest = exposure * self._largest_difference(sight.frame, gamma, quadrature, sight.coloured)
            return difference(image(BEFORE), image(AFTER), 1.0 / largest if largest > 0 else 1.0)
        if sight.mode in ("movement", "depth"):
            return self._movement(sight, np.clip(image(AFTER, False), 0, 1))
        return image(sight.mode)

    def optics(self, sight: Sight, recipe: Recipe) -> tuple[float, str]:
        """γ per full-resolution cell, and the quadrature."""
        shape, number = self.opened.shape, self.opened.results.numbers[sight.frame]
        if sight.look == AS_SEEN:
            of_frame = by_cell(recipe.at(number) if number is not None else recipe, shape)
            return of_frame.extinction, recipe.quadrature
        return looks.gamma(sight.look, shape), "paper"

    def exposure(self, sight: Sight, recipe: Recipe) -> float:
        """By how much images are multiplied.

        Of a run it is its own, as long as the smoke is seen as the network has seen it; otherwise it is measured.
        """
        optics, run = self.optics(sight, recipe), self.opened.recipe
        as_seen = run is not None and sight.look == AS_SEEN and optics == self.optics(sight, run)
        recorded = self.opened.exposure(sight.frame) if as_seen else None
        return self._measured_exposure(*optics) if recorded is None else recorded

    def _measured_exposure(self, gamma: float, quadrature: str) -> float:
        """The same for all pictures of a γ: 1 / the brightest pixel of three frames, before, from three sides.

        They are the first, the middle and the last: a long sequence is not read as a whole before it is shown.
        """
        if (key := (gamma, quadrature)) not in self._exposures:
            last = len(self.opened.results.frames) - 1
            grids = [self.opened.frame(BEFORE, index).full for index in sorted({0, (last + 1) // 2, last})]
            self._exposures[key] = exposure_for(
                max(
                    float(self._image(grid, grid.tensor, gamma, quadrature, view, None).max())
                    for grid in grids
                    for view in _MEASURED_FROM
                )
            )
        return self._exposures[key]

    def _largest_difference(self, frame: int, gamma: float, quadrature: str, coloured: bool) -> float:
        """The largest difference of a frame in the front view, unexposed; it has the full colour."""
        if (key := (frame, gamma, quadrature, coloured)) not in self._differences:
            before, after = both_coloured(
                *(
                    self._seen(grid, gamma, quadrature, (0.0, 0.0), None, coloured)
                    for grid in (self.opened.frame(side, frame).full for side in (BEFORE, AFTER))
                )
            )
            self._differences[key] = float(np.abs(after - before).max())
        return self._differences[key]

    def _grid(self, side: str, sight: Sight) -> ShownGrid:
        frame = self.opened.frame(side, sight.frame)
        return frame.coarse if sight.coarse else frame.full

    def _seen(
        self,
        grid: ShownGrid,
        gamma: float,
        quadrature: str,
        viewpoint: Viewpoint,
        size: tuple[int, int] | None,
        coloured: bool,
    ) -> np.ndarray:
        """The image of smoke (rows, columns), in its colours, if it is to have any, (rows, columns, 3)."""
        if grid.tint is None or not coloured:
            return self._image(grid, grid.tensor, gamma, quadrature, viewpoint, size)
        with turn():
            renderer = ColouredRenderer(grid.density.shape, gamma, quadrature, grid.h, size=size)
            return renderer.render_colour(grid.tensor, grid.tint, [viewpoint]).numpy()[0]

    @staticmethod
    def _image(
        grid: ShownGrid,
        values: mi.TensorXf | np.ndarray,
        gamma: float,
        quadrature: str,
        viewpoint: Viewpoint,
        size: tuple[int, int] | None,
    ) -> np.ndarray:
        with turn():
            renderer = EmissionAbsorptionRenderer(grid.density.shape, gamma, quadrature, grid.h, size=size)
            on_device = mi.TensorXf(values) if isinstance(values, np.ndarray) else values
            return renderer.render(on_device, [viewpoint]).numpy()[0]

    def _movement(self, sight: Sight, brightness: np.ndarray) -> np.ndarray:
        """v* as the mean over the smoke along each ray, in colours."""
        axes, usual = sight.camera.axes, self._moving_smoke(sight.frame).usual
        if sight.mode == "depth":
            _, (towards,) = self._mean_movement(sight, axes[2:])
            return coloured_by_depth(towards, brightness, usual)
        _, (right, up) = self._mean_movement(sight, axes[:2])
        return coloured(right, up, brightness, usual)

    def _mean_movement(self, sight: Sight, axes: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """The smoke along each ray (rows, columns), and the mean over it of v* along each of axes (N, 3), in cells."""
        moving, grid = self._moving_smoke(sight.frame), self._grid(AFTER, sight)
        momentum = moving.coarse if sight.coarse else moving.full
        size = sight.rows, sight.columns

        smoke = self._image(grid, grid.tensor, _TRANSPARENT, "paper", sight.camera, size)

        def mean(axis: np.ndarray) -> np.ndarray:
            # Renderers take no negative densities, so all smoke is moved along, and back again in the picture.
            values = momentum @ axis.astype(np.float32) + moving.farthest * grid.density
            along = self._image(grid, values, _TRANSPARENT, "paper", sight.camera, size)
            return np.where(smoke > 0, along / np.maximum(smoke, 1e-30) - moving.farthest, 0.0)

        return smoke, [mean(axis) for axis in axes]

    def _moving_smoke(self, frame: int) -> MovingSmoke:
        # Another tab's thread may want another frame in the meantime.
        latest = self._moving
        if latest is None or latest[0] != frame:
            latest = frame, MovingSmoke.of(self.opened.frame(AFTER, frame), self.opened.velocity(frame))
            self._moving = latest
        return latest[1]

    def _cut(self, sight: Sight) -> np.ndarray:
        assert sight.cut is not None
        oriented = _oriented(*sight.cut, self.opened.shape)

        def density(side: str) -> np.ndarray:
            return oriented(self.opened.frame(side, sight.frame).full.density)

        def smoke(side: str) -> np.ndarray:
            grid = self.opened.frame(side, sight.frame).full
            if grid.colour is None or not sight.coloured:
                return density(side)
            return density(side)[..., None] * oriented(grid.colour)

        if sight.mode == "difference":
            picture = difference(smoke(BEFORE), smoke(AFTER), 1.0)
        elif sight.mode in ("movement", "depth"):
            picture = cut_movement(self._moving_smoke(sight.frame), oriented, sight.cut[0], density(AFTER), sight.mode)
        else:
            picture = smoke(sight.mode)
        return _fitted(picture, sight.rows, sight.columns)


def _oriented(name: str, place: float, shape: Shape) -> Callable[[np.ndarray], np.ndarray]:
    """Cuts (D, H, W, …) across an axis, at a place from 0 to 1, into pictures (rows, columns, …), row 0 at the top."""
    # From the right, z runs to the left, and from above, to the bottom.
    axis, shown = _AXES[name]
    index = min(int(place * shape[axis]), shape[axis] - 1)

    def cut(values: np.ndarray) -> np.ndarray:
        plane = np.take(values, index, axis=axis)
        rest = [other for other in range(3) if other != axis]
        vertical, horizontal = (rest.index(one) for one in shown)
        picture = np.moveaxis(plane, (vertical, horizontal), (0, 1))
        if axis == 1:  # from above: z, which comes towards the viewer of the front view, runs downwards
            return picture
        picture = picture[::-1]
        return picture[:, ::-1] if axis == 2 else picture

    return cut


def _fitted(picture: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """A picture as large as fits, in the middle of a black one; cells stay visible."""
    factor = min(rows / picture.shape[0], columns / picture.shape[1])
    size = max(1, round(factor * picture.shape[1])), max(1, round(factor * picture.shape[0]))
    channels = picture[..., None] if picture.ndim == 2 else picture
    enlarged = [
        on_canvas(
            np.asarray(
                Image.fromarray(np.ascontiguousarray(channels[..., channel], np.float32)).resize(
                    size, Image.Resampling.NEAREST if factor > 1 else Image.Resampling.BOX
                )
            ),
            rows,
            columns,
        )
        for channel in range(channels.shape[2])
    ]
    return enlarged[0] if picture.ndim == 2 else np.stack(enlarged, axis=-1)
