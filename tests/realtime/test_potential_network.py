"""The network: untrained it changes nothing, blocks agree with the whole, and what it gives has a bound."""

import numpy as np
import pytest
import torch

from tnst_mi.realtime.potential_network import BLOCK_REACH, CHANNELS, LARGEST, Architecture, Block, PotentialNetwork
from tnst_mi.realtime.prediction import Example, _blocks, _in_blocks, edge_fade, network_box, predicted

#: γ of a cell, and λ.
SEEN = (0.1, 0.0)


def network(octaves=2, width=4, spread=2.0):
    """A network with weights that are not 0, so that all of its parts matter."""
    torch.manual_seed(0)
    made = PotentialNetwork(Architecture(octaves, width)).eval()
    torch.nn.init.normal_(made.block.last.weight, std=spread)
    return made


def smoke(shape=(40, 56, 48), centre=(20, 30, 22), size=8):
    z, y, x = np.indices(shape)
    far = sum(((axis - c) / size) ** 2 for axis, c in zip((z, y, x), centre, strict=True))
    return np.exp(-far * 2).astype(np.float32)


def test_an_untrained_network_leaves_smoke_as_it_is():
    made = PotentialNetwork(Architecture(3, 4)).eval()
    assert not predicted(made, smoke(), *SEEN).any()


@pytest.mark.parametrize("octaves", [1, 2, 3])
def test_potentials_are_within_their_bound(octaves):
    made = network(octaves, spread=1e4)
    bound = LARGEST * (2**octaves - 1)
    found = predicted(made, smoke(), *SEEN)
    assert 0.8 * bound < np.abs(found).max() <= bound


def test_blocks_agree_with_the_whole():
    made = network(octaves=2)
    density = torch.from_numpy(smoke((64, 160, 96), (30, 80, 50), 30))[None, None]
    lam = torch.tensor([0.3])
    whole = made(density, lam).detach()
    parts = list(_blocks((64, 160, 96), (2 * BLOCK_REACH + 16) ** 3))
    assert len(parts) > 20
    with torch.no_grad():
        found = _in_blocks(made, density, lam, (2 * BLOCK_REACH + 16) ** 3)
    assert whole.abs().max() > 1
    assert torch.allclose(found, whole, rtol=0, atol=2e-5)


def test_what_is_beyond_the_reach_of_a_block_does_not_matter():
    torch.manual_seed(0)
    block = Block(4)
    torch.nn.init.normal_(block.last.weight, std=0.3)
    seen = torch.rand(1, 3 + CHANNELS, 8, 8, 160)
    seen.requires_grad_()
    at = 81
    block(seen)[..., at].sum().backward()
    touched = np.flatnonzero(seen.grad.abs().sum((0, 1, 2, 3)).numpy())
    assert BLOCK_REACH - 4 <= max(at - touched.min(), touched.max() - at) <= BLOCK_REACH


@pytest.mark.parametrize("most_cells", [1, 1 << 12, 1 << 18])
def test_blocks_cover_a_grid_once(most_cells):
    covered = np.zeros((37, 61, 45), int)
    for part in _blocks(covered.shape, most_cells):
        covered[part] += 1
        assert all(along.start % 4 == 0 for along in part)
    assert (covered == 1).all()


def test_the_box_has_the_smoke_and_a_margin_with_a_soft_edge():
    density = smoke((64, 80, 72), (34, 40, 36))
    box = network_box(density, 8)
    assert box is not None
    outside = density.copy()
    outside[box] = 0
    assert outside.max() < 1e-3
    assert all(along.start % 8 == 0 for along in box)
    fade = edge_fade(density.shape, box)
    inside = density[box] > 1e-3
    assert fade[inside].min() == 1.0  # potentials are not lowered where there is smoke
    assert max(fade[0].max(), fade[:, 0].max(), fade[:, :, -1].max()) < 0.02  # and they do not jump at the sides
    assert network_box(np.zeros((8, 8, 8), np.float32), 8) is None


def test_smoke_that_fills_the_grid_has_no_soft_edge():
    density = np.ones((16, 24, 16), np.float32)
    box = network_box(density, 8)
    assert box == (slice(0, 16), slice(0, 24), slice(0, 16))
    assert (edge_fade(density.shape, box) == 1).all()


def test_smoke_that_moves_by_whole_groups_of_cells_takes_its_motif_along():
    """So a motif neither stays behind nor shifts within the smoke while that drifts."""
    made = network(octaves=2)
    here = predicted(made, smoke((72, 88, 64), (36, 36, 32)), *SEEN)
    there = predicted(made, smoke((72, 88, 64), (36, 44, 32)), *SEEN)
    assert np.abs(here).max() > 1
    assert np.abs(there[:, 8:] - here[:, :-8]).max() < 1e-4


def test_potentials_of_empty_frames_are_0():
    found = predicted(network(), np.zeros((8, 12, 8), np.float32), *SEEN)
    assert found.shape == (8, 12, 8, 4) and not found.any()


def test_gradients_reach_every_weight():
    made = network(octaves=3)
    Example(smoke(), 0.1, 0.5, made).potentials(made).square().sum().backward()
    assert all(weight.grad is not None and weight.grad.abs().sum() > 0 for weight in made.parameters())


def test_thicker_smoke_and_a_larger_gamma_are_the_same():
    made, density = network(), smoke()
    assert np.array_equal(predicted(made, 2 * density, 0.1, 0.0), predicted(made, density, 0.2, 0.0))
    assert np.abs(predicted(made, density, 0.2, 0.0) - predicted(made, density, 0.1, 0.0)).max() > 0.1


def test_lambda_is_seen():
    made, density = network(), smoke()
    assert np.abs(predicted(made, density, 0.1, 1.0) - predicted(made, density, 0.1, 0.0)).max() > 0.1
