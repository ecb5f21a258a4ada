"""Transport along the flow: an oracle in torch, closed forms, finite differences, and what one step gets wrong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import drjit as dr
import flow_oracle
import mitsuba as mi
import numpy as np
import pytest
import torch
from fields import blob, directional_error, smooth_noise

import tnst_mi
from tnst_mi.fields import flow_advection
from tnst_mi.fields.advection import METHODS, flow, step
from tnst_mi.fields.flow_map import MOST_STAGES, FlowMap
from tnst_mi.fields.grid import Cells
from tnst_mi.fields.potentials import PotentialVelocity

SHAPE = (9, 12, 7)
SCENES = Path(__file__).resolve().parents[2] / "scenes"


#: Of `advect`, by what they ask for.
ARGUMENTS = {"step": {}, "flow": {"trace": "flow"}, "conservative": {"trace": "flow", "conservative": True}}


def rotation(shape: tuple[int, int, int], turns: float) -> np.ndarray:
    """The velocity (D, H, W, 3) of a rigid rotation about the grid's centre, in the plane of x and y."""
    _, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape), indexing="ij")
    return np.float32(2 * np.pi * turns * np.stack([-y, x, 0 * x], -1))


def bundled() -> np.ndarray:
    with np.load(SCENES / "suzanne" / "frame_0010.npz") as arrays:
        return arrays["density"].astype(np.float32)


def swirls(rng: np.random.Generator, shape: tuple[int, int, int], fastest: float) -> np.ndarray:
    """A velocity without divergence, of eddies some ten cells wide."""
    v = tnst_mi.velocity(None, smooth_noise(rng, *shape, 3, passes=12), 0.0)
    return np.float32(v * (fastest / np.linalg.norm(v, axis=-1).max()))


def smoke_in_air(rng: np.random.Generator, shape: Sequence[int]) -> np.ndarray:
    """A box of noise with nothing around it."""
    density = np.zeros(shape, np.float32)
    inner = tuple(slice(n // 4, -(n // 4)) for n in shape[:3])
    density[inner] = np.abs(smooth_noise(rng, *density[inner].shape))
    return density


def ends(v: np.ndarray, stages: int, sign: int) -> np.ndarray:
    """Displacements (D, H, W, 3) at the ends of all paths."""
    shape = v.shape[:3]
    components = mi.Vector3f(*(mi.Float(v[..., c].ravel()) for c in range(3)))
    found = FlowMap(components, 1.0, shape, with_volume=False)
    _, traced = found.trace(Cells.of(shape), sign, stages)
    return np.stack([np.array(x).reshape(shape) for x in traced], -1)


@pytest.mark.parametrize("conservative", [False, True])
@pytest.mark.parametrize("outside", ["zero", "edge"])
@pytest.mark.parametrize("method", METHODS)
def test_values_and_derivatives_are_the_oracle_s(method: str, outside: str, conservative: bool) -> None:
    """Of the field and of v, in float64 by autograd; where rounding may switch the limiter, its choice is given."""
    rng = np.random.default_rng(1)
    stages, h = 3, 1.3
    values, velocities = smooth_noise(rng, *SHAPE), 4 * smooth_noise(rng, *SHAPE, 3)
    weights = smooth_noise(rng, *SHAPE)
    d64 = torch.tensor(values, dtype=torch.float64)[..., None].requires_grad_()
    v64 = torch.tensor(velocities, dtype=torch.float64).requires_grad_()
    with torch.no_grad():
        plain = flow_oracle.transported(d64, v64 / h, stages, "semi_lagrangian", outside)
        limited = flow_oracle.transported(d64, v64 / h, stages, "maccormack", outside)
    reverted = plain == limited
    expected = flow_oracle.transported(d64, v64 / h, stages, method, outside, conservative, reverted)
    (expected[..., 0] * torch.tensor(weights)).sum().backward()

    d, v = mi.TensorXf(values), mi.TensorXf(velocities)
    dr.enable_grad(d, v)
    choice = mi.TensorXf(reverted[..., 0].float().numpy()) if method == "maccormack" else None
    result = flow(d, v, method, h, outside, choice, stages, conservative)
    dr.backward(dr.sum(result * mi.TensorXf(weights), axis=None))
    np.testing.assert_allclose(result.numpy(), expected[..., 0].detach().numpy(), atol=5e-6)
    for found, leaf in ((dr.grad(d).numpy(), d64.grad[..., 0]), (dr.grad(v).numpy(), v64.grad)):
        np.testing.assert_allclose(found, leaf.numpy(), atol=2e-5 * float(leaf.abs().max()))
    if method == "maccormack":
        assert 0.05 < float(reverted.double().mean()) < 0.8
        free = flow(mi.TensorXf(values), mi.TensorXf(velocities), method, h, outside, None, stages, conservative)
        assert (np.abs(free.numpy() - result.numpy()) > 1e-5).mean() < 1e-2


@pytest.mark.parametrize("conservative", [False, True])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("channels", [1, 3])
def test_backward_is_the_transpose_of_forward(channels: int, method: str, conservative: bool) -> None:
    rng = np.random.default_rng(7)
    shape = SHAPE if channels == 1 else (*SHAPE, 3)
    values, v_values = smooth_noise(rng, *shape), 3 * smooth_noise(rng, *SHAPE, 3)
    tangents, w = (smooth_noise(rng, *shape), smooth_noise(rng, *SHAPE, 3)), smooth_noise(rng, *shape)
    arguments = {"method": method, "h": 1.3, "outside": "edge", "trace": "flow", "stages": 3}

    field, v = mi.TensorXf(values), mi.TensorXf(v_values)
    dr.enable_grad(field, v)
    result = tnst_mi.advect(field, v, **arguments, conservative=conservative)
    dr.backward(dr.sum(result * mi.TensorXf(w), axis=None))
    adjoint = (dr.grad(field).numpy() * tangents[0]).sum() + (dr.grad(v).numpy() * tangents[1]).sum()

    field, v = mi.TensorXf(values), mi.TensorXf(v_values)
    dr.enable_grad(field, v)
    dr.set_grad(field, mi.TensorXf(tangents[0]))
    dr.set_grad(v, mi.TensorXf(tangents[1]))
    tangent = dr.forward_to(tnst_mi.advect(field, v, **arguments, conservative=conservative)).numpy()
    assert (tangent * w).sum() == pytest.approx(adjoint, rel=2e-5, abs=5e-5)


@pytest.mark.parametrize("conservative", [False, True])
@pytest.mark.parametrize("names", [("phi",), ("psi",), ("phi", "psi")])
def test_gradient_of_potentials_against_central_differences(names: tuple[str, ...], conservative: bool) -> None:
    """The whole chain, potentials → velocity → density, along 16 directions, with the limiter's choice held."""
    rng = np.random.default_rng(8)
    shape, lam, h = (12, 16, 12), 0.4, 1.3
    density, w = smoke_in_air(rng, shape), smooth_noise(rng, *shape)
    shapes = {name: shape if name == "phi" else (*shape, 3) for name in names}
    base = {name: 90 * smooth_noise(rng, *size, passes=6) for name, size in shapes.items()}

    def moved(potentials: dict[str, mi.TensorXf], method: str, reverted: mi.TensorXf | None) -> mi.TensorXf:
        v = PotentialVelocity(potentials.get("phi"), potentials.get("psi"), lam, h)
        return flow(mi.TensorXf(density), v, method, h, "zero", reverted, 4, conservative)

    leaves = {name: mi.TensorXf(value) for name, value in base.items()}
    choice = mi.TensorXf(
        np.float32(moved(leaves, "maccormack", None).numpy() != moved(leaves, "maccormack_unlimited", None).numpy())
    )
    assert 0.02 < choice.numpy().mean() < 0.7
    dr.enable_grad(leaves)
    dr.backward(dr.sum(moved(leaves, "maccormack", choice) * mi.TensorXf(w), axis=None))
    for name in names:

        def objective(point: np.ndarray, name: str = name) -> float:
            tensors = {other: mi.TensorXf(value) for other, value in (base | {name: point}).items()}
            return float((moved(tensors, "maccormack", choice).numpy().astype(np.float64) * w).sum())

        directions = [smooth_noise(rng, *shapes[name], passes=4) for _ in range(16)]
        assert directional_error(objective, dr.grad(leaves[name]).numpy(), base[name], directions, 4e-3) <= 1e-2


def test_a_blob_is_turned_by_a_quarter() -> None:
    """Rigid rotation by 90° in eight stages, and in one step."""
    shape = (1, 65, 65)
    v = rotation(shape, 0.25)
    start, end = blob(shape, (44, 32, 0), 5.0), blob(shape, (32, 44, 0), 5.0)
    turned = tnst_mi.advect(start, v, trace="flow", stages=8)
    assert np.abs(turned - end).max() <= 2e-3 * end.max()
    assert np.abs(tnst_mi.advect(start, v) - end).max() > 0.5


def test_order_of_the_trace() -> None:
    """The ends of paths of a rigid rotation, whose interpolation is exact: errors against the number of stages."""
    shape = (1, 33, 33)
    _, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape), indexing="ij")
    inside = np.hypot(x, y) < 14
    stages = np.array([2, 4, 8, 16])
    for sign in (1, -1):
        angle = sign * np.pi / 2
        exact = np.stack([np.cos(angle) * x - np.sin(angle) * y - x, np.sin(angle) * x + np.cos(angle) * y - y], -1)
        errors = [np.abs(ends(rotation(shape, 0.25), n, sign)[..., :2] - exact)[inside].max() for n in stages]
        order = -np.polyfit(np.log(stages), np.log(errors), 1)[0]
        assert 2.7 < order < 3.3
        assert errors[2] < 0.02


def test_no_path_crosses_the_outermost_cells_of_a_solid() -> None:
    """A velocity of up to 44 cells that is 0 inside a solid: interpolation at the end of every path sees some fluid.

    The continuous flow approaches the centres of a solid's outermost cells without end; stages that are too long cross.
    """
    rng, shape = np.random.default_rng(14), (14, 18, 16)
    solid = np.zeros(shape, bool)
    solid[4:10, 6:9, 3:12] = True
    v = smooth_noise(rng, *shape, 3)
    v *= 44 / np.linalg.norm(v, axis=-1).max()
    v[solid] = 0
    inside = torch.tensor(solid, dtype=torch.float64)[..., None]
    for sign in (-1, 1):
        crossing = {}
        for stages in (16, MOST_STAGES):
            end = flow_oracle.centres(shape) + torch.tensor(ends(v, stages, sign), dtype=torch.float64)
            around, weights = flow_oracle.corners(inside, end, "zero")
            fluid = ((1 - around) * weights).sum(0)[..., 0].numpy()
            crossing[stages] = int((fluid[~solid] == 0).sum())
        assert crossing[16] > 0 and crossing[MOST_STAGES] == 0


def test_forward_and_back_again_returns_the_density() -> None:
    density = bundled()
    v = swirls(np.random.default_rng(3), density.shape, 15.0)

    def returned(**arguments: object) -> float:
        there = tnst_mi.advect(density, v, **arguments)
        return float(np.sqrt(np.mean((tnst_mi.advect(there, -v, **arguments) - density) ** 2)))

    assert returned(trace="flow") <= 0.3 * returned()


def test_a_velocity_without_divergence_keeps_the_mass() -> None:
    """An eddy around the bundled smoke, of up to 22 cells."""
    density = bundled()
    psi = np.zeros((*density.shape, 3), np.float32)
    psi[..., 1] = blob(density.shape, (31, 45, 30), 14.0)
    v = tnst_mi.velocity(None, psi, 0.0)
    v *= 22 / np.linalg.norm(v, axis=-1).max()
    mass = density.sum(dtype=np.float64)
    lost = {
        name: 1 - tnst_mi.advect(density, v, **arguments).sum(dtype=np.float64) / mass
        for name, arguments in ARGUMENTS.items()
    }
    assert lost["step"] > 0.05
    assert abs(lost["flow"]) <= 0.01 and abs(lost["conservative"]) <= 0.01


def test_the_conservative_form_keeps_the_sum_where_smoke_is_compressed() -> None:
    shape = (32, 40, 32)
    density = blob(shape, (15, 20, 16), 4.0)
    phi = 30 * blob(shape, (17, 19, 15), 9.0)
    for sign in (1, -1):
        v = tnst_mi.velocity(np.float32(sign * phi), None, 1.0)
        advective, conservative = (
            tnst_mi.advect(density, v, trace="flow", stages=8, conservative=kept).sum() / density.sum()
            for kept in (False, True)
        )
        assert abs(advective - 1) > 0.25
        assert abs(conservative - 1) < 0.01


def test_volumes_of_a_uniform_expansion() -> None:
    """u = a x: the flow is x → e^a x, and the determinant of its inverse e^{-3a}, however the density is sampled."""
    shape, a = (24, 24, 24), 0.3
    grid = np.stack(np.meshgrid(*(np.arange(n) - 11.5 for n in shape), indexing="ij")[::-1], -1)
    moved = tnst_mi.advect(
        np.ones(shape), a * grid, "semi_lagrangian", trace="flow", stages=8, outside="edge", conservative=True
    )
    np.testing.assert_allclose(moved, np.exp(-3 * a), rtol=1e-4)


def test_the_same_velocity_everywhere_is_one_step() -> None:
    rng = np.random.default_rng(5)
    field, v = smoke_in_air(rng, SHAPE), np.broadcast_to(np.float32([1.3, -2.1, 0.4]), (*SHAPE, 3)).copy()
    for stages in (1, 5):
        along = tnst_mi.advect(field, v, "maccormack_unlimited", trace="flow", stages=stages)
        np.testing.assert_allclose(along, tnst_mi.advect(field, v, "maccormack_unlimited"), atol=2e-6)


@pytest.mark.parametrize("conservative", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_zero_velocity_returns_the_bits(method: str, conservative: bool) -> None:
    field = smooth_noise(np.random.default_rng(2), *SHAPE)
    moved = tnst_mi.advect(field, np.zeros((*SHAPE, 3)), method, trace="flow", conservative=conservative)
    np.testing.assert_array_equal(moved, field)


@pytest.mark.parametrize("v", [0.0, 1.0, np.nan, np.inf])
def test_nothing_stays_nothing(v: float) -> None:
    field = np.zeros(SHAPE)
    velocities = mi.TensorXf(np.full((*SHAPE, 3), v, np.float32))
    dr.enable_grad(velocities)
    moved = tnst_mi.advect(mi.TensorXf(np.float32(field)), velocities, trace="flow")
    dr.backward(dr.sum(moved, axis=None))
    if np.isfinite(v):
        assert not moved.numpy().any() and not dr.grad(velocities).numpy().any()


@pytest.mark.parametrize("conservative", [False, True])
@pytest.mark.parametrize("outside", ["zero", "edge"])
@pytest.mark.parametrize(("channels", "size"), [((), 3.0), ((), 0.5), ((), 20.0), ((3,), 3.0)])
def test_tracing_all_cells_gives_what_tracing_those_that_matter_gives(
    channels: tuple[int, ...], size: float, outside: str, conservative: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a GPU, and as on a CPU; smoke and velocity are in a part of the grid, and still cells next to smoke."""
    rng = np.random.default_rng(18)
    shape = (16, 20, 14)
    field = smoke_in_air(rng, (*shape, *channels))
    v = size * smooth_noise(rng, *shape, 3)
    v[:, :, :8] = 0
    weights, found = smooth_noise(rng, *shape, *channels), {}
    for everywhere in (False, True):
        monkeypatch.setattr(flow_advection, "on_gpu", lambda everywhere=everywhere: everywhere)
        velocity = mi.TensorXf(v)
        dr.enable_grad(velocity)
        result = flow(mi.TensorXf(field), velocity, outside=outside, stages=4, conservative=conservative)
        dr.set_grad(result, mi.TensorXf(weights))
        dr.enqueue(dr.ADMode.Backward, result)
        dr.traverse(dr.ADMode.Backward)
        found[everywhere] = dr.detach(result).numpy(), dr.grad(velocity).numpy()
    for one, other in zip(found[False], found[True], strict=True):
        np.testing.assert_array_equal(one, other)
    assert 0.1 < found[True][1].any(-1).mean() < 0.9 and found[True][1][:, :, 4:7].any()


def test_ten_runs_give_the_same_bits() -> None:
    rng = np.random.default_rng(9)
    shape = (32, 48, 32)
    field, v = smoke_in_air(rng, shape), 6 * smooth_noise(rng, *shape, 3, passes=4)
    results = set()
    for _ in range(10):
        f, u = mi.TensorXf(field), mi.TensorXf(v)
        dr.enable_grad(f, u)
        dr.backward(dr.sum(dr.square(tnst_mi.advect(f, u, trace="flow", conservative=True)), axis=None))
        results.add(dr.grad(f).numpy().tobytes() + dr.grad(u).numpy().tobytes())
    assert len(results) == 1


@pytest.mark.parametrize(("fastest", "h"), [(2.0, 1.0), (20.0, 1.0), (20.0, 1.8), (400.0, 1.0)])
def test_auto_takes_as_many_stages_as_a_path_needs(fastest: float, h: float) -> None:
    """By the largest velocity of a trial in one stage, a stage for every three cells, up to 32."""
    rng = np.random.default_rng(6)
    field, v = smooth_noise(rng, *SHAPE), smooth_noise(rng, *SHAPE, 3)
    v *= fastest / np.linalg.norm(v, axis=-1).max()
    u, here = torch.tensor(v, dtype=torch.float64) / h, flow_oracle.centres(SHAPE)
    rate, met = torch.zeros_like(u), torch.zeros(SHAPE, dtype=torch.float64)
    for share in (0.0, 0.5, 0.75):
        rate = flow_oracle.interpolated(u, here - share * rate, "edge")
        met = torch.maximum(met, rate.norm(dim=-1))
    stages = torch.clamp(torch.ceil(met / 3), 1, 32).int().numpy()
    auto = tnst_mi.advect(field, v, "semi_lagrangian", h, trace="flow")
    for count in np.unique(stages):
        given = tnst_mi.advect(field, v, "semi_lagrangian", h, trace="flow", stages=int(count))
        np.testing.assert_array_equal(auto[stages == count], given[stages == count])
    assert (stages.max() == 1) == (fastest < 3) and (stages.max() == 32) == (fastest > 96)


@pytest.mark.parametrize("stages", [(3, 7), (None, None)])
def test_other_numbers_need_no_other_kernels(stages: tuple[int | None, int | None]) -> None:
    """The velocity, λ and the number of stages change from one iteration to the next."""
    rng, shape = np.random.default_rng(11), (12, 16, 14)
    density = mi.TensorXf(smoke_in_air(rng, shape))

    def run(size: float, stages: int | None, lam: float) -> None:
        psi, phi = (mi.TensorXf(size * smooth_noise(rng, *shape, *channels)) for channels in ((3,), ()))
        dr.enable_grad(phi, psi)
        dr.backward(dr.sum(flow(density, PotentialVelocity(phi, psi, lam, 1.2), stages=stages), axis=None))
        dr.eval(dr.grad(phi), dr.grad(psi))

    run(3.0, stages[0], 0.4)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        run(20.0, stages[1], 0.6)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 10 and all(kernel["cache_hit"] for kernel in kernels)


def test_torch_differentiates_it() -> None:
    rng = np.random.default_rng(12)
    d = torch.tensor(smoke_in_air(rng, SHAPE))
    v = torch.tensor(3 * smooth_noise(rng, *SHAPE, 3)).requires_grad_()
    tnst_mi.advect(d, v, "maccormack_unlimited", trace="flow", stages=2).square().sum().backward()
    w = v.detach().double().requires_grad_()
    flow_oracle.transported(d.double()[..., None], w, 2, "maccormack_unlimited").square().sum().backward()
    np.testing.assert_allclose(v.grad, w.grad, atol=2e-5 * float(w.grad.abs().max()))


def test_one_step_is_left_as_it_was() -> None:
    """`advect` without a trace is `step`, to the bit."""
    rng = np.random.default_rng(13)
    field, v = smoke_in_air(rng, SHAPE), 3 * smooth_noise(rng, *SHAPE, 3)
    np.testing.assert_array_equal(tnst_mi.advect(field, v), step(mi.TensorXf(field), mi.TensorXf(v)).numpy())


@pytest.mark.parametrize(
    "change",
    [
        {"trace": "curve"},
        {"trace": "flow", "stages": 0},
        {"trace": "flow", "stages": 65},
        {"trace": "flow", "stages": "many"},
        {"trace": "flow", "stages": True},
        {"trace": "flow", "steps": 2},
        {"trace": "flow", "steps": "auto"},
        {"stages": 4},
        {"conservative": True},
    ],
)
def test_bad_arguments_are_named(change: dict) -> None:
    with pytest.raises(tnst_mi.InputError, match=r"advect: .*expected"):
        tnst_mi.advect(np.zeros((3, 3, 3)), np.zeros((3, 3, 3, 3)), **change)


def test_auto_differentiates_the_trace_that_it_took() -> None:
    """Each cell's value is, to the bit, that of some number of stages; so is its share of the derivative."""
    rng = np.random.default_rng(12)
    values, v_values = rng.random(SHAPE, np.float32), swirls(rng, SHAPE, 11.0)
    w = rng.standard_normal(SHAPE).astype(np.float32)

    def run(stages: int | str, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        v = mi.TensorXf(v_values)
        dr.enable_grad(v)
        field = mi.TensorXf(values)
        result = tnst_mi.advect(field, v, "semi_lagrangian", 1.0, "edge", trace="flow", stages=stages)
        dr.backward(dr.sum(result * mi.TensorXf(w if weights is None else weights), axis=None))
        return result.numpy(), dr.grad(v).numpy()

    auto, found = run("auto", None)
    left, expected, used = np.ones(SHAPE, bool), np.zeros_like(found, np.float64), []
    for stages in range(1, 6):
        same = left & (run(stages, None)[0] == auto)
        expected += run(stages, np.where(same, w, 0))[1]
        left &= ~same
        used.append(int(same.sum()))
    assert not left.any() and sum(count > 50 for count in used) >= 3
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.abs(expected).max())


@pytest.mark.parametrize("everywhere", [False, True])
@pytest.mark.parametrize("speed", [100.0, 1e4])
def test_empty_cells_stay_empty_however_much_they_are_compressed(
    everywhere: bool, speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Volumes overflow there; 0 times any volume is 0, on a GPU as on a CPU."""
    monkeypatch.setattr("tnst_mi.fields.flow_advection.on_gpu", lambda: everywhere)
    rng = np.random.default_rng(13)
    density = smoke_in_air(rng, (16, 18, 20))
    v = np.float32(speed) * rng.standard_normal((16, 18, 20, 3)).astype(np.float32)
    assert np.isfinite(tnst_mi.advect(density, v, trace="flow", conservative=True)).all()
    assert np.isfinite(tnst_mi.advect(np.zeros_like(density), v, trace="flow", conservative=True)).all()


def test_a_velocity_that_is_not_a_number_has_no_valid_derivative() -> None:
    """Its sums were finite, and wrong."""
    rng = np.random.default_rng(14)
    density, v_values = smoke_in_air(rng, SHAPE), 3 * smooth_noise(rng, *SHAPE, 3)
    v_values[SHAPE[0] // 2, SHAPE[1] // 2, SHAPE[2] // 2] = np.nan
    v = mi.TensorXf(v_values)
    dr.enable_grad(v)
    dr.backward(dr.sum(dr.square(tnst_mi.advect(mi.TensorXf(density), v, trace="flow")), axis=None))
    assert not np.isfinite(dr.grad(v).numpy()).all()
