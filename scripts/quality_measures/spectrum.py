"""Contrast of a change inside the smoke, and how its energy is spread over spatial frequencies, against the style's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from figures.measures import frequencies

from quality_measures.crops import Picture, drawn


def contrast(pictures: Sequence[Picture]) -> float:
    """Standard deviation of the grey values inside, over all pictures together."""
    return float(np.concatenate([picture.grey[picture.inside] for picture in pictures]).std(dtype=np.float64))


def energy_shares(pictures: Sequence[Picture], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """How the energy of pieces of pictures of one size is spread over spatial frequencies.

    Each piece loses its mean and is faded out by a Hann window, so that its border is no edge; energies of all pieces
    are added over rings of one step of frequency, 1 / edge cycles per pixel.

    Returns:
        |f| in cycles per pixel in the middle of each ring, (R,), and its share of the energy, (R,), which sum to 1;
        shares of 0 where the pictures have no contrast.
    """
    grey, _ = drawn(pictures, seed)
    edge = grey.shape[1]
    ramp = np.sin(np.pi * (np.arange(edge) + 0.5) / edge) ** 2
    window = np.outer(ramp, ramp)
    # The mean under the window, so that nothing of it is left at frequency 0.
    mean = (grey * window).sum((1, 2), keepdims=True, dtype=np.float64) / window.sum()
    energy = (np.abs(np.fft.fft2((grey - mean) * window)) ** 2).sum(0)
    ring = np.rint(frequencies(energy.shape) * edge).astype(int).ravel()
    shares = np.bincount(ring, energy.ravel())
    total = shares.sum()
    return np.arange(len(shares)) / edge, shares / total if total > 0 else shares


def mean_frequency(cycles: np.ndarray, shares: np.ndarray) -> float:
    """The mean of frequencies (R,), in cycles per pixel, by their shares of the energy."""
    return float((cycles * shares).sum())


def spectral_distance(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the energy, 0 to 1, that would have to change its frequency to turn one spectrum into the other."""
    return 0.5 * float(np.abs(one - other).sum())


def scrambled(change: np.ndarray, inside: np.ndarray, seed: int = 0) -> np.ndarray:
    """A change (H, W) with the spectrum of the given one, and random phases: its contrast without its motifs.

    Its mean and standard deviation inside (H, W) are those of the change.
    """
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal(change.shape))
    values = np.fft.irfft2(np.abs(np.fft.rfft2(change)) * noise / np.abs(noise), change.shape)
    found, wanted = values[inside], change[inside].astype(np.float64)
    if not found.std():
        return change
    return ((values - found.mean()) * (wanted.std() / found.std()) + wanted.mean()).astype(np.float32)
