"""Learning: the derivative of the weights is that of the loss, and trainings help and resume to the bit."""

import dataclasses

import drjit as dr
import numpy as np
import pytest
import torch

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.realtime.potential_network import Architecture, PotentialNetwork
from tnst_mi.realtime.prediction import fields_of, predicted
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.training import learning, trainer
from tnst_mi.training.footage import MIRRORINGS, Footage
from tnst_mi.training.trainer import Trainer

RECIPE = Recipe(style=("spirals",), octaves=1, views=1, loss_scaling="none")


def frame(shift=0.0, shape=(20, 24, 20), number=1):
    z, y, x = (axis / n - 0.5 for axis, n in zip(np.indices(shape), shape, strict=True))
    far = (z * 2.6) ** 2 + (y * 2.2 + shift) ** 2 + (x * 3.0) ** 2
    waves = 0.6 + 0.4 * np.sin(19 * x) * np.cos(17 * z + 11 * y)
    return Frame((np.clip(1 - far, 0, None) * waves).astype(np.float32), name=f"frame_{number:04d}")


def small(fields=None):
    torch.manual_seed(3)
    made = PotentialNetwork(Architecture(1, 4, fields or {"psi": 3}))
    torch.nn.init.normal_(made.block.last.weight, std=0.2)
    return made


@pytest.fixture(scope="module")
def footage(network: GoogLeNet):
    return Footage("smoke", [frame(), frame(0.2, number=2)], RECIPE, network)


def test_the_derivative_of_the_weights_is_that_of_the_loss(footage, monkeypatch):
    """Against central differences along a random direction, without what only makes steps steadier."""
    monkeypatch.setattr(learning, "PULL", 0.0)
    monkeypatch.setattr(learning, "limited", lambda field, _: field)
    made, take, seed = small(), footage.take(0), (1, 2)
    learning.learn(made, footage, take, seed)
    torch.manual_seed(4)
    direction = [torch.randn_like(weight) * weight.detach().abs().mean() for weight in made.parameters()]
    gradient = [weight.grad for weight in made.parameters()]
    analytic = float(sum((g * d).sum() for g, d in zip(gradient, direction, strict=True)))
    # `learn` divides by the size of the derivative of the potentials, which is found here independently.
    potentials = predicted(made, take.density.numpy())
    at = fields_of(potentials, made.architecture, 1.0)
    raw = footage.problem.gradient(take.plan, at, take.density, seed).gradients[0]["psi"].numpy()
    analytic *= float(np.sqrt(np.square(raw, dtype=np.float64).sum()))

    def loss(step):
        with torch.no_grad():
            for weight, d in zip(made.parameters(), direction, strict=True):
                weight += step * d
            fields = fields_of(predicted(made, take.density.numpy()), made.architecture, 1.0)
            for weight, d in zip(made.parameters(), direction, strict=True):
                weight -= step * d
        return float(footage.problem.gradient(take.plan, fields, take.density, seed).loss)

    step = 2e-3
    central = (loss(step) - loss(-step)) / (2 * step)
    assert abs(central) > 1e-3
    # The network's own derivative is rounded to half precision.
    assert analytic == pytest.approx(central, rel=0.03)


def test_learning_lowers_the_loss_of_smoke_that_is_not_learned_from(network, monkeypatch):
    monkeypatch.setattr(trainer, "RATE", 6e-3)
    monkeypatch.setattr(trainer, "RISING", 5)
    torch.manual_seed(0)
    made = PotentialNetwork(Architecture(1, 8, {"psi": 3}))
    seen = Footage("seen", [frame(), frame(0.2, number=2)], RECIPE, network)
    unseen = Footage("unseen", [frame(-0.2, number=3)], RECIPE, network)
    training = Trainer(made, [seen], [unseen], seed=0)
    before = training.judged()
    assert before.after == before.before  # an untrained network changes nothing
    for number in range(60):
        training.update(number / 60)
    assert training.judged().share < 0.97


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
        Trainer(small({"phi": 1}), [footage], [footage], 0).read(state)
    state.write_bytes(state.read_bytes()[:-7])
    with pytest.raises(InputError, match="damaged"):
        Trainer(small(), [footage], [footage], 0).read(state)
    with pytest.raises(InputError, match="no such file"):
        Trainer(small(), [footage], [footage], 0).read(tmp_path / "none")


def test_frames_are_mirrored_along_z_and_x(footage):
    density = footage.take(0).density.numpy()
    for along_z, along_x in MIRRORINGS:
        axes = ([0] if along_z else []) + ([2] if along_x else [])
        assert np.array_equal(footage.take(0, (along_z, along_x)).density.numpy(), np.flip(density, axes))


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
    potentials = np.zeros((*octave.shape, 3), np.float32)
    potentials[..., 2] = y
    fields = fields_of(potentials, Architecture(1, 4, {"psi": 3}), octave.cell_size)
    parameterisation, full = take.plan.parameterisation, coarse.plan.full
    with dr.suspend_grad():
        v = parameterisation.velocity(parameterisation.carried(fields, octave, full), full.cell_size).numpy()
    assert np.abs(v[8:-8, 8:-8, 8:-8, 0] - 2.0).max() < 1e-3
