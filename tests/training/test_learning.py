"""Learning: the derivative of the weights is that of the loss, and trainings help and resume to the bit."""

import dataclasses
import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save

from tnst_mi.errors import InputError
from tnst_mi.fields.advection import step
from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.realtime.potential_network import Architecture, PotentialNetwork
from tnst_mi.realtime.prediction import fields_of, predicted, predicted_fields
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.training import learning, trainer
from tnst_mi.training.footage import Footage, Showing
from tnst_mi.training.learning import Neighbour
from tnst_mi.training.trainer import Trainer

RECIPE = Recipe(style=("spirals",), octaves=1, views=1, loss_scaling="none")


def frame(shift=0.0, shape=(20, 24, 20), number=1):
    z, y, x = (axis / n - 0.5 for axis, n in zip(np.indices(shape), shape, strict=True))
    far = (z * 2.6) ** 2 + (y * 2.2 + shift) ** 2 + (x * 3.0) ** 2
    waves = 0.6 + 0.4 * np.sin(19 * x) * np.cos(17 * z + 11 * y)
    return Frame((np.clip(1 - far, 0, None) * waves).astype(np.float32), name=f"frame_{number:04d}")


def small(width=4):
    torch.manual_seed(3)
    made = PotentialNetwork(Architecture(1, width))
    torch.nn.init.normal_(made.block.last.weight, std=0.2)
    return made


@pytest.fixture(scope="module")
def footage(network: GoogLeNet):
    return Footage("smoke", [frame(), frame(0.2, number=2)], RECIPE, network)


def test_the_derivative_of_the_weights_is_that_of_the_loss(footage, monkeypatch):
    """Against central differences along a direction of random size, without what only makes steps steadier."""
    monkeypatch.setattr(learning, "PULL", 0.0)
    monkeypatch.setattr(learning, "limited", lambda field, _: field)
    made, take, seed = small(), footage.take(0), (1, 2)
    learning.learn(made, footage, take, seed)
    torch.manual_seed(4)
    gradient = [weight.grad for weight in made.parameters()]
    # Upwards, so that differences are well above rounding.
    direction = [
        grad.sign() * torch.rand_like(weight) * weight.detach().abs().mean()
        for weight, grad in zip(made.parameters(), gradient, strict=True)
    ]
    analytic = float(sum((g * d).sum() for g, d in zip(gradient, direction, strict=True)))
    # `learn` divides by the size of the derivative of the potentials, which is found here independently.
    at = predicted_fields(made, take.plan, footage.problem.octave, take.density)
    raw = footage.problem.gradient(take.plan, at, take.density, seed).gradients[0]["psi"].numpy()
    analytic *= float(np.sqrt(np.square(raw, dtype=np.float64).sum()))

    def loss(step):
        with torch.no_grad():
            for weight, d in zip(made.parameters(), direction, strict=True):
                weight += step * d
            fields = predicted_fields(made, take.plan, footage.problem.octave, take.density)
            for weight, d in zip(made.parameters(), direction, strict=True):
                weight -= step * d
        return float(footage.problem.gradient(take.plan, fields, take.density, seed).loss)

    step = 5e-4
    central = (loss(step) - loss(-step)) / (2 * step)
    assert abs(central) > 1e-3
    # The network's own derivative is rounded to half precision.
    assert analytic == pytest.approx(central, rel=0.03)


def test_learning_lowers_the_loss_of_smoke_that_is_not_learned_from(network, monkeypatch):
    monkeypatch.setattr(trainer, "RATE", 6e-3)
    monkeypatch.setattr(trainer, "RISING", 5)
    # So few updates are for smoke as it is.
    for name, as_it_is in (("_ZOOM", 1.0), ("_THICKER", 1.0), ("_OTHER_LAM", 0.0)):
        monkeypatch.setattr(trainer, name, as_it_is)
    torch.manual_seed(0)
    made = PotentialNetwork(Architecture(1, 8))
    seen = Footage("seen", [frame(), frame(0.2, number=2)], RECIPE, network)
    unseen = Footage("unseen", [frame(-0.2, number=3)], RECIPE, network)
    training = Trainer(made, [seen], [unseen], seed=0)
    before = training.judged()
    assert before.after == before.before  # an untrained network changes nothing
    for number in range(60):
        training.update(number / 60)
    assert training.judged().after < 0.97 * before.before


def weights_of(network):
    return {name: weight.detach().clone() for name, weight in network.state_dict().items()}


def test_a_training_that_is_resumed_ends_with_the_same_bits(footage, tmp_path):
    def begun():
        made = small()
        return made, Trainer(made, [footage], [footage], seed=5)

    whole, one = begun()
    for number in range(6):
        one.update(number / 6)
    stopped, two = begun()
    for number in range(3):
        two.update(number / 6)
    two.write(tmp_path / "state", 1.5)
    resumed, three = begun()
    assert three.read(tmp_path / "state") == 1.5 and three.updates == 3
    for number in range(3, 6):
        three.update(number / 6)
    assert all(torch.equal(weights_of(resumed)[name], weight) for name, weight in weights_of(whole).items())
    assert not all(torch.equal(weights_of(stopped)[name], weight) for name, weight in weights_of(whole).items())


def test_states_of_other_networks_and_damaged_ones_are_refused(footage, tmp_path):
    state = tmp_path / "state"
    Trainer(small(), [footage], [footage], 0).write(state, 0.0)
    with pytest.raises(InputError, match=r"of another network|damaged"):
        Trainer(small(8), [footage], [footage], 0).read(state)
    state.write_bytes(state.read_bytes()[:-7])
    with pytest.raises(InputError, match="damaged"):
        Trainer(small(), [footage], [footage], 0).read(state)
    with pytest.raises(InputError, match="no such file"):
        Trainer(small(), [footage], [footage], 0).read(tmp_path / "none")


def test_frames_are_mirrored_along_z_and_x(footage):
    density = footage.take(0).density.numpy()
    for along_z, along_x in itertools.product((False, True), repeat=2):
        axes = ([0] if along_z else []) + ([2] if along_x else [])
        shown = footage.take(0, Showing((along_z, along_x)))
        assert np.array_equal(shown.density.numpy(), np.flip(density, axes))


def drifting(by, count=3, shape=(20, 32, 20)):
    """Frames of smoke that drifts by so many cells per frame along z, y and x."""
    velocity = np.broadcast_to(np.float32(by[::-1]), (*shape, 3))
    first = np.zeros(shape, np.float32)
    first[shape[0] // 2 - 6 :, shape[1] // 2 - 12 :, shape[2] // 2 - 6 :][:12, :20, :12] = frame(
        shape=(12, 20, 12)
    ).density
    moved = [np.roll(first, np.multiply(by, number), (0, 1, 2)) for number in range(count)]
    return [Frame(density, velocity, name=f"f{number}", number=number) for number, density in enumerate(moved)]


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize(
    "showing", [Showing(), Showing((True, False)), Showing((False, True)), Showing((True, True), 2.0, 0.7)]
)
def test_the_flow_carries_a_neighbour_to_a_frame(network, showing, direction):
    footage = Footage("smoke", drifting((1, 3, 2)), RECIPE, network)
    other, displacement = footage.carrying(1, direction, showing)
    assert other == 1 + direction
    wanted, found = footage.take(1, showing).density.numpy(), footage.take(other, showing).density
    found = step(found, displacement, "semi_lagrangian", 1.0).numpy()
    # Beyond the border there is no smoke to be carried in, and a zoom puts some there.
    inside = (slice(6, -6),) * 3
    assert wanted[inside].max() > 0.3
    assert np.abs(found - wanted)[inside].max() < 1e-5


def test_frames_without_a_neighbour_have_none(network):
    frames = drifting((0, 4, 0))
    footage = Footage("smoke", frames, RECIPE, network)
    assert footage.carrying(0, -1, Showing()) is None and footage.carrying(2, 1, Showing()) is None
    still = Footage("smoke", [dataclasses.replace(one, velocity=None) for one in frames], RECIPE, network)
    assert still.carrying(1, -1, Showing()) is None


def test_frames_that_are_two_apart_are_carried_twice_as_far(network):
    """And frames with a gap between them are no neighbours."""
    frames = [dataclasses.replace(one, velocity=one.velocity / 2) for one in drifting((0, 4, 0))]

    def numbered(*numbers):
        pairs = zip(frames, numbers, strict=True)
        return Footage("smoke", [dataclasses.replace(one, number=number) for one, number in pairs], RECIPE, network)

    footage = numbered(4, 6, 8)
    other, displacement = footage.carrying(1, -1, Showing())
    found = step(footage.take(other).density, displacement, "semi_lagrangian", 1.0).numpy()
    assert np.abs(found - footage.take(1).density.numpy())[6:-6, 6:-6, 6:-6].max() < 1e-5
    assert numbered(4, 6, 9).carrying(2, -1, Showing()) is None


def gradient_of(made, *arguments):
    made.zero_grad()
    learning.learn(made, *arguments)
    return [weight.grad.clone() for weight in made.parameters()]


def stepped(made, more, less):
    """Go a short way along what one gradient has more than another."""
    along = [a - b for a, b in zip(more, less, strict=True)]
    length = sum(float(part.square().sum()) for part in along) ** 0.5
    with torch.no_grad():
        for weight, part in zip(made.parameters(), along, strict=True):
            weight -= 0.02 * part / length


def test_learning_turns_potentials_towards_those_of_a_neighbour(network):
    made = small()
    footage = Footage("smoke", drifting((0, 2, 0), 2, (40, 56, 40)), RECIPE, network)
    other, displacement = footage.carrying(1, -1, Showing())
    take, before = footage.take(1), footage.take(other)

    def angle():
        octave, smoke = footage.problem.octave, np.minimum(take.density.numpy(), 1)[..., None]
        here, there = (predicted_fields(made, one.plan, octave, one.density)["psi"].numpy() for one in (take, before))
        parts = [mi.TensorXf(np.ascontiguousarray(part)) for part in np.moveaxis(there, -1, 0)]
        moved = np.stack([step(part, displacement, "semi_lagrangian", 1.0).numpy() for part in parts], axis=-1)
        here, there = smoke * here, smoke * moved
        return 1 - (here * there).sum() / np.linalg.norm(here) / np.linalg.norm(there)

    more, less = (
        gradient_of(made, footage, take, (1, 2), Neighbour(before, displacement, pull)) for pull in (10.0, 0.0)
    )
    was = angle()
    stepped(made, more, less)
    assert angle() < 0.99 * was


def test_the_pull_weakens_potentials(footage, monkeypatch):
    made, take = small(), footage.take(0)

    def size():
        return np.linalg.norm(predicted(made, take.density.numpy(), take.plan.recipe.extinction, 0.0)[..., 1:])

    found, was = [], size()
    for pull in (5.0, 0.0):
        monkeypatch.setattr(learning, "PULL", pull)
        found.append(gradient_of(made, footage, take, (1, 2)))
    stepped(made, *found)
    assert size() < 0.999 * was


@pytest.mark.parametrize("side", [4, 8])
def test_tiny_smoke_has_a_derivative(network, side):
    """Where the convolutions have one or two cells, half precision would read memory that nothing has written."""
    footage = Footage("tiny", [frame(shape=(side, side, side))], RECIPE, network)
    for _ in range(10):
        unused = [torch.full((n,), torch.nan) for n in (10, 100, 1000, 10_000, 100_000)]
        del unused
        torch.manual_seed(0)
        made = PotentialNetwork(Architecture(1, 32))
        assert all(torch.isfinite(part).all() for part in gradient_of(made, footage, footage.take(0), (1, 2)))


def test_a_derivative_that_is_not_finite_ends_the_training_before_it_spoils_the_weights(footage, monkeypatch):
    made = small()
    training, before = Trainer(made, [footage], [footage], 0), weights_of(made)
    monkeypatch.setattr(learning, "PULL", np.nan)
    with pytest.raises(InputError, match="not finite in update 0"):
        training.update(0.0)
    assert all(torch.equal(before[name], weight) for name, weight in weights_of(made).items())


@pytest.mark.parametrize("progress", [[np.nan, 0, 0], [-5, 0, 0], [np.inf, 0, 0], [3, 4, 0], [3, 3, np.nan], [3, 3]])
def test_progress_that_there_cannot_be_is_refused(footage, tmp_path, progress):
    training, state = Trainer(small(), [footage], [footage], 0), tmp_path / "state"
    training.write(state, 1.0)
    stored = load_file(state) | {"progress": torch.tensor(progress, dtype=torch.float64)}
    state.write_bytes(save(stored))
    with pytest.raises(InputError, match="damaged"):
        training.read(state)


def test_potentials_that_move_with_the_smoke_are_steady(network):
    """The network is steady itself for smoke that drifts by whole groups of cells: 4 with one octave."""
    made = small()

    def unsteady(by):
        footage = Footage("smoke", drifting(by, 2, (40, 56, 40)), RECIPE, network)
        other, displacement = footage.carrying(1, -1, Showing())
        take, octave = footage.take(1), footage.problem.octave
        with torch.autocast("cpu", torch.bfloat16):
            now = torch.from_numpy(predicted(made, take.density.numpy(), take.plan.recipe.extinction, 0.0))
        now[..., 0] = 0  # Φ, which λ = 0 leaves out
        neighbour = Neighbour(footage.take(other), displacement, 1.0)
        return now, learning._unsteady(made, now, take, neighbour, octave)

    _, steady = unsteady((0, 4, 0))
    now, turned = unsteady((0, 2, 0))
    assert steady.norm() < 0.05 * turned.norm()
    # They are turned, and neither weakened nor strengthened.
    assert turned.norm() > 0.01
    assert abs((turned * now).sum()) < 1e-4 * turned.norm() * now.norm()


def test_smoke_that_is_shown_thicker_and_larger_is_as_bright(network):
    """Or the loss would ask for darker smoke."""
    footage = Footage("smoke", [frame(shape=(24, 32, 24))], RECIPE, network)

    def brightest(showing):
        take = footage.take(0, showing)
        with dr.suspend_grad():
            images = footage.problem._rendered(take.density, [take.plan.recipe.main_view], take.plan, (0,), None)
        return float(images.numpy().max())

    plain = brightest(Showing())
    assert 0.8 < plain <= 1
    assert brightest(Showing(thicker=2.0)) == pytest.approx(plain, abs=0.08)
    assert brightest(Showing(thicker=0.5, zoom=1.3)) == pytest.approx(plain, abs=0.08)


def test_what_lambda_leaves_out_is_not_learned(network):
    footage, made = Footage("smoke", [frame()], RECIPE, network), small()
    learning.learn(made, footage, footage.take(0), (1, 2))
    bias = made.block.last.bias.grad.reshape(4, 8)
    assert not bias[0].any() and bias[1:].any()
    made.zero_grad()
    learning.learn(made, footage, footage.take(0, Showing(lam=1.0)), (1, 2))
    bias = made.block.last.bias.grad.reshape(4, 8)
    assert bias[0].any() and not bias[1:].any()


def test_on_a_coarser_grid_the_loss_is_that_of_the_octave(network):
    """With images coarser than the input, the network works on their grid, and its potentials fit the input's."""
    recipe = dataclasses.replace(RECIPE, motif_size=1.0)
    coarse = Footage("smoke", [frame(shape=(40, 48, 40))], recipe, network)
    octave = coarse.problem.octave
    assert octave.shape == (20, 24, 20) and octave.cell_size == 2.0
    take = coarse.take(0)
    assert tuple(take.density.shape) == octave.shape
    # A potential that moves smoke by one cell of the octave along x moves it by two of the input's.
    y = np.indices(octave.shape, np.float32)[1]
    potentials = np.zeros((*octave.shape, 4), np.float32)
    potentials[..., 3] = y
    fields = fields_of(potentials, take.plan.parameterisation, octave.cell_size)
    parameterisation, full = take.plan.parameterisation, coarse.plan.full
    with dr.suspend_grad():
        v = parameterisation.velocity(parameterisation.carried(fields, octave, full), full.cell_size).numpy()
    assert np.abs(v[8:-8, 8:-8, 8:-8, 0] - 2.0).max() < 1e-3
