"""`tnst-mi compare`: agreement where there is none to find fault with, and every deliberate fault found."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from command_line import Ran, Run, refused, run
from fields import smooth_noise

from tnst_mi.compare.gradients import random_directions
from tnst_mi.compare.quadrature_study import darkening, study_quadratures
from tnst_mi.compare.values import Comparison, launches, relative_rms
from tnst_mi.compare.verdict import value_checks
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames

__all__ = ["run"]

SHAPE = (6, 9, 7)
FLAGS = ("--quick", "--views", "0,0", "25,-12", "--gamma", "0.4")


@pytest.fixture
def smoke(tmp_path: Path) -> Path:
    """A frame whose smoke does not vanish at the walls, where faults would go unnoticed otherwise."""
    density = 0.9 * np.abs(smooth_noise(np.random.default_rng(1), *SHAPE)) + 0.1
    save_frames(tmp_path / "cloud.npz", Frame(density, name="cloud"))
    return tmp_path / "cloud.npz"


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the figures and the study of step sizes, which take longer than the rest for so small a frame."""
    monkeypatch.setattr("tnst_mi.compare.comparison.study_quadratures", lambda density, views: [])
    monkeypatch.setattr("tnst_mi.compare.report._draw", lambda folder, results: Pictures())


class Pictures(dict):
    """Any figure: an empty file."""

    def __missing__(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(read_bytes=lambda: b"")


def compared(run: Run, smoke: Path, spp: int) -> tuple[Ran, dict[str, Any]]:
    """Run the command and read the report."""
    out = smoke.parent / "out"
    ran = run("compare", smoke, "--out", out, *FLAGS, "--spp", spp)
    assert (out / "report.json").is_file(), ran.errors
    return ran, json.loads((out / "report.json").read_text("utf-8"))


# --------------------------------------------------------------------
# Agreement
# --------------------------------------------------------------------


def test_our_integrator_agrees_with_the_path_tracer(run: Run, smoke: Path) -> None:
    ran, report = compared(run, smoke, 1024)
    assert ran.code == 0, report["verdict"]
    assert ran.out.splitlines()[-1] == f"verdict   {report['verdict']}"
    about = {name: sum(check["quadrature"] == name for check in report["checks"]) for name in ("exact", "paper")}
    (images,) = report["paper_images"]
    assert report["passed"] and report["verdict"] == (
        f"agree: all {sum(about.values())} checks passed; “exact” against prbvolpath, the closed form and central "
        f"differences: {about['exact']} of {about['exact']} passed; “paper”, another discretisation, which drives a "
        "stylization by default, against its own sum in float64 and central differences: "
        f"{about['paper']} of {about['paper']} passed; “paper” is {images['departure']:.1%} at γ 0.4 (RMS) from the "
        "continuous integral"
    )
    assert 0.01 < images["departure"] < 0.5, "one cell is not a short step at γ 0.4"
    assert max(images["relative_errors"]) < 1e-5
    (gradient,) = report["paper_gradients"]
    assert gradient["pixels"] > 60 and gradient["error"] < 1e-5
    assert any("100% " in line for line in ran.errors), "progress"

    (directions,) = report["directions"]
    assert len(directions["derivatives_ours"]) == 16
    assert directions["central_error"] < 1e-3 and directions["paper_error"] < 1e-3
    assert abs(directions["slope"] - 1) <= min(0.02, 2 * directions["slope_interval"])
    assert directions["covered"] > 0.75
    assert [values["view"] for values in report["values"]] == [[0, 0], [25, -12]]
    assert all(values["testable"] == 63 and abs(values["mean_z"]) < 0.5 for values in report["values"])
    assert {"versions", "device", "seconds", "settings"} <= report.keys()

    out = smoke.parent / "out"
    page = (out / "report.html").read_text("utf-8")
    figures = sorted(path.stem for path in (out / "figures").glob("*.png"))
    expected = {"images_0.4", "gradient_0.4", "z", "convergence", "directions", "paper", "orders", "departure"}
    assert set(figures) == expected
    assert page.count("data:image/png;base64,iVBOR") == len(expected)
    assert not re.search(r'(src|href)="(?!data:)', page), "the page needs no other file"
    assert report["verdict"] in page

    image = OpenEXR.File(str(out / "images" / "view_25_-12_gamma_0.4_prbvolpath.exr"))
    pixels, header = image.channels()["Y"].pixels, image.header()
    assert pixels.shape == SHAPE[1:] and header["gamma"] == pytest.approx(0.4)
    # Every path is absorbed or escapes.
    np.testing.assert_allclose(0.4 * pixels * 1024, np.rint(0.4 * pixels * 1024), atol=0.01)
    assert len(list((out / "images").glob("*.exr"))) == 10


def test_what_is_refused(run: Run, smoke: Path, tmp_path: Path) -> None:
    def refuse(message: str, *arguments: object) -> None:
        refused(run, tmp_path, ["compare", *arguments], message)

    out = ("--out", tmp_path / "out")
    refuse("--spp 31: expected an integer", smoke, *out, "--spp", "31")
    refuse("--directions 2: expected an integer", smoke, *out, "--directions", "2")
    refuse("--gamma 0: expected a number above 0", smoke, *out, "--gamma", "1", "0")
    refuse("--seed x: expected an integer", smoke, *out, "--seed", "x")
    refuse("--views 1: expected AZIMUTH,ELEVATION", smoke, *out, "--views", "1")
    refuse("--gamma: expected one or more different values", smoke, *out, "--gamma", "1", "1.0")
    refuse("no such file", tmp_path / "nowhere.npz", *out)
    refuse("is not empty; .*--overwrite", smoke, "--out", tmp_path)
    np.savez(tmp_path / "opaque.npz", density=np.full((8, 10, 9), 0.7, np.float32))
    opaque = "at gamma 200 the smoke lets nearly all paths through or nearly none in all .*; give another --gamma"
    refuse(opaque, tmp_path / "opaque.npz", "--gamma", "200", *out)
    np.savez(tmp_path / "thin.npz", density=np.full((8, 10, 9), 0.001, np.float32))
    thin = "at gamma 0.05 the smoke lets nearly all .* nothing can be tested; .* or --density-scale auto"
    refuse(thin, tmp_path / "thin.npz", "--gamma", "0.05", *out)
    refuse("empty.npz: the density is 0 everywhere, expected smoke", empty_frame(tmp_path), *out)


def empty_frame(folder: Path) -> Path:
    save_frames(folder / "empty.npz", Frame(np.zeros(SHAPE), name="empty"))
    return folder / "empty.npz"


# --------------------------------------------------------------------
# Faults
# --------------------------------------------------------------------


def moved_samples(monkeypatch: pytest.MonkeyPatch, offset: float) -> None:
    """Every sample further along its ray by a part of a step."""
    from tnst_mi.rendering.march.lattice import Lattice

    stencil = Lattice.stencil
    monkeypatch.setattr(Lattice, "stencil", lambda self, k: stencil(self, mi.Float(k) + offset))


def scaled_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """γ missing from the image."""
    from tnst_mi.rendering.march.integrator import EmissionAbsorption

    radiance = EmissionAbsorption._radiance
    monkeypatch.setattr(EmissionAbsorption, "_radiance", lambda self, *rest: radiance(self, *rest) * self.gamma)


def moved_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """The image shifted by half a pixel: both renderers share the rays, so that only the closed form can tell."""
    from tnst_mi.rendering.cameras.orthographic import OrthographicRays

    through = OrthographicRays.through

    def shifted(self: OrthographicRays, position: mi.Point2f, active: Any = True) -> mi.Ray3f:
        return through(self, mi.Point2f(position.x + 0.5 / self.width, position.y), active)

    monkeypatch.setattr(OrthographicRays, "through", shifted)


def wrong_adjoint(monkeypatch: pytest.MonkeyPatch, change: Callable[[Any, Any, Any], tuple]) -> None:
    """The reverse pass with another image L or image gradient δL, which `change` gives."""
    from tnst_mi.rendering.march.integrator import EmissionAbsorption

    adjoint = EmissionAbsorption._scatter_adjoint

    def broken(self: Any, segments: object, behind: object, L: object, δL: object, parallel: object) -> None:
        adjoint(self, segments, behind, *change(self, L, δL), parallel)

    monkeypatch.setattr(EmissionAbsorption, "_scatter_adjoint", broken)


def moved_adjoint(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reverse pass a step off the forward one."""
    from tnst_mi.rendering.march.integrator import EmissionAbsorption

    adjoint = EmissionAbsorption._scatter_adjoint

    def broken(self: Any, segments: list[Any], *rest: object) -> None:
        (segment,) = segments
        stencil = segment.lattice.stencil
        segment.lattice.stencil = lambda k: stencil(k + 1)
        adjoint(self, segments, *rest)

    monkeypatch.setattr(EmissionAbsorption, "_scatter_adjoint", broken)


IMAGE_FAULTS = {
    "samples one step off": lambda patch: moved_samples(patch, 1.0),
    "samples half a step off": lambda patch: moved_samples(patch, 0.5),
    "gamma missing from the image": scaled_images,
    "camera half a pixel off": moved_camera,
}
GRADIENT_FAULTS = {
    "wrong sign": lambda patch: wrong_adjoint(patch, lambda self, L, δL: (L, -δL)),
    "gamma missing from the gradient": lambda patch: wrong_adjoint(patch, lambda self, L, δL: (L, δL * self.gamma)),
    "gradient without attenuation": lambda patch: wrong_adjoint(patch, lambda self, L, δL: (L * 0, δL)),
    "gradient one step off": moved_adjoint,
}


@pytest.mark.parametrize("fault", [*IMAGE_FAULTS, *GRADIENT_FAULTS])
def test_a_broken_integrator_is_found(
    run: Run, smoke: Path, monkeypatch: pytest.MonkeyPatch, brief: None, fault: str
) -> None:
    (IMAGE_FAULTS | GRADIENT_FAULTS)[fault](monkeypatch)
    ran, report = compared(run, smoke, 512)
    assert ran.code == 1
    failed = [check["name"] for check in report["checks"] if not check["passed"]]
    assert failed and failed[0] in report["verdict"] and report["verdict"].startswith("DISAGREE")
    assert ran.out.splitlines()[-1] == f"verdict   {report['verdict']}"
    if fault in GRADIENT_FAULTS:
        assert all(re.search("derivatives|correlation|central", name) for name in failed), "the images are right"
        assert any("against central differences" in name for name in failed)
        assert any("derivatives of paper" in name for name in failed)
        assert any("of derivatives of prbvolpath" in name for name in failed)
    else:
        assert any("paper against the inclusive sum" in name for name in failed)


def exclusive_sum(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample is not dimmed by itself: of the same first order, a neighbour of the authors' sum."""
    from tnst_mi.rendering.march.quadratures import InclusiveSum

    def exclusive(self: Any, march: Any) -> tuple:
        def emit(stencil: object, τ: Any, L: Any) -> tuple:
            added = march.lattice.step * march.extinction(march.σ_t, stencil)
            return τ + added, L + added * dr.exp(-τ)

        τ, L = march.visit_smoke((march.zeros(), march.zeros()), emit, "exclusive")
        return L * self.inv_gamma, τ

    monkeypatch.setattr(InclusiveSum, "radiance", exclusive)


def changed_for_paper(monkeypatch: pytest.MonkeyPatch, **changes: Callable[[float], float]) -> None:
    """Renderers of "paper" with another γ or step: images and gradients that fit each other."""
    from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

    create = EmissionAbsorptionRenderer.__init__

    def changed(self: Any, shape: object, gamma: float, quadrature: str, h: float, step: float | None = None) -> None:
        given = {"gamma": gamma, "step": step or h}
        if quadrature == "paper":
            given |= {name: change(given[name]) for name, change in changes.items()}
        create(self, shape, quadrature=quadrature, h=h, **given)

    monkeypatch.setattr(EmissionAbsorptionRenderer, "__init__", changed)


def moved_for_paper(monkeypatch: pytest.MonkeyPatch) -> None:
    """The samples of "paper" half a step further, in images and gradients."""
    from tnst_mi.rendering.march.integrator import EmissionAbsorption

    sample = EmissionAbsorption.sample

    def moved(self: Any, *arguments: Any, **named: Any) -> Any:
        with pytest.MonkeyPatch.context() as patch:
            if self.quadrature == "paper":
                moved_samples(patch, 0.5)
            return sample(self, *arguments, **named)

    monkeypatch.setattr(EmissionAbsorption, "sample", moved)


#: What the path tracer, the closed form and, but for the first, central differences cannot find.
PAPER_FAULTS = {
    "exclusive sum": exclusive_sum,
    "samples half a step off": moved_for_paper,
    "gamma 0.1% too large": lambda patch: changed_for_paper(patch, gamma=lambda gamma: 1.001 * gamma),
    "steps of half a cell": lambda patch: changed_for_paper(patch, step=lambda step: step / 2),
}


@pytest.mark.parametrize("fault", PAPER_FAULTS)
def test_a_fault_of_the_quadrature_that_drives_a_stylization_is_found(
    run: Run, smoke: Path, monkeypatch: pytest.MonkeyPatch, brief: None, fault: str
) -> None:
    PAPER_FAULTS[fault](monkeypatch)
    ran, report = compared(run, smoke, 512)
    assert ran.code == 1 and report["verdict"].startswith("DISAGREE")
    failed = [check for check in report["checks"] if not check["passed"]]
    assert {check["quadrature"] for check in failed} == {"paper"}
    assert re.search(r"central differences: (\d+) of \1 passed; “paper”", report["verdict"]), "“exact” is right"
    names = [check["name"] for check in failed]
    assert sum("paper against the inclusive sum" in name for name in names) == 2, "in both views"
    if fault != "exclusive sum":
        assert any("derivatives of paper" in name for name in names)
        assert not any("central differences" in name for name in names)


# --------------------------------------------------------------------
# Statistics
# --------------------------------------------------------------------


def simulated(transmittance: np.ndarray, spp: int, error: float = 0.0) -> Comparison:
    """A comparison at γ 2 whose path tracer is a binomial law around T + `error`."""
    rng = np.random.default_rng(7)
    exact = (1 - transmittance) / 2
    traced = (1 - rng.binomial(spp, np.clip(transmittance + error, 0, 1)) / spp) / 2
    return Comparison((0.0, 0.0), 2.0, spp, 1.0, exact, exact, exact, traced, exact)


def test_standard_errors_and_z_scores() -> None:
    transmittance = np.linspace(0, 1, 64 * 64).reshape(64, 64)
    values = simulated(transmittance, 200)
    np.testing.assert_array_equal(values.testable, 200 * transmittance * (1 - transmittance) >= 5)
    assert values.standard_error[32, 0] == pytest.approx(0.5 * np.sqrt(0.25 / 200), rel=1e-3)
    z = values.z[values.testable]
    assert abs(z.mean()) < 0.05 and z.std() == pytest.approx(1, abs=0.05)
    assert np.isnan(values.z[~values.testable]).all()
    assert 0 < values.untestable_paths < 20
    assert all(check.passed for check in value_checks(values))


@pytest.mark.parametrize("error", [0.01, -0.01])
def test_a_bias_of_a_third_of_a_standard_error_is_found(error: float) -> None:
    values = simulated(np.linspace(0.1, 0.9, 4096).reshape(64, 64), 200, error)
    assert [check.name for check in value_checks(values) if not check.passed] == ["view 0,0 γ 2: mean z"]


def test_without_testable_pixels_nothing_is_shown() -> None:
    (check, *_) = value_checks(simulated(np.full((4, 4), 0.999), 64))
    assert not check.passed and "more --spp" in check.expected


@pytest.mark.parametrize(("spp", "largest"), [(64, 1000), (100, 16), (4096, 8), (37, 5)])
def test_launches_add_up_and_double(spp: int, largest: int) -> None:
    counts = launches(spp, largest)
    assert sum(counts) == spp and max(counts) <= largest
    totals = np.cumsum(counts).tolist()
    assert {4 * 2**k for k in range(20) if 4 * 2**k <= spp} <= set(totals)


# --------------------------------------------------------------------
# Directions and quadratures
# --------------------------------------------------------------------


def test_directions_are_smooth_and_live_where_the_smoke_is() -> None:
    density = np.zeros((24, 48, 24))
    density[8:16, 10:30, 8:16] = 1
    first, second = random_directions(density, 2, (3, 4))
    inside = first[6:18, 8:32, 6:18]
    assert (first[6:18, 8:32, 6:18] != 0).all() and np.count_nonzero(first) == inside.size
    assert np.abs(np.diff(inside, axis=1)).mean() < 0.5 * np.abs(inside).mean()
    assert abs(np.vdot(first, second)) < 0.9 * np.linalg.norm(first) * np.linalg.norm(second)
    np.testing.assert_array_equal(first, next(random_directions(density, 1, (3, 4))))


def test_paper_departs_from_the_continuous_formula_as_predicted() -> None:
    """A uniform column: paper / exact is x/(eˣ − 1) with x = γ h d once it is opaque; the report says where x ≥ 1."""
    thin, threshold, thick = study_quadratures(np.full((60, 4, 4), 0.5, np.float32), [(0.0, 0.0)])
    for study in (threshold, thick):
        np.testing.assert_allclose(study.thickness, study.gamma * 0.5, rtol=1e-6)
        ratio = study.front_paper / study.front_exact
        np.testing.assert_allclose(ratio, darkening(np.float64(study.gamma * 0.5)), rtol=1e-4)
    assert not threshold.thick.any() and "no pixel" in threshold.in_words()
    assert thick.thick.all() and "22% of its light" in thick.in_words()
    assert thin.cut and thin.view != (0.0, 0.0), "errors are measured in an oblique view"
    assert relative_rms(thin.front_paper, thin.front_exact) == thin.departure < 0.03


def test_orders_of_convergence() -> None:
    z, y, x = np.meshgrid(*(np.linspace(-2, 2, n) for n in (20, 24, 16)), indexing="ij")
    density = np.maximum(np.exp(-(x**2 + y**2 + z**2)) - 0.02, 0).astype(np.float32)
    thin, threshold, _ = study_quadratures(density, [(30.0, 20.0)])
    for study in (thin, threshold):
        assert not study.cut
        assert study.exact_order == pytest.approx(2, abs=0.4)
        assert study.paper_order == pytest.approx(1, abs=0.2)
