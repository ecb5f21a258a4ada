"""Shared fixtures: the JIT variant under test, and the optional assets kept beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import pytest

# Before any test module imports torch, whose idle threads would spin and take Dr.Jit's cores; see `tnst_mi.__init__`.
import tnst_mi

if TYPE_CHECKING:
    from tnst_mi.network.googlenet import GoogLeNet

# Examples are the same in every run: a change fails the tests, or does not. `--hypothesis-profile=search` looks for new
# ones.
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.register_profile("search")
hypothesis.settings.load_profile("repeatable")

ASSETS = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session", autouse=True)
def variant() -> str:
    """Every test runs on llvm_ad_rgb unless TNST_MI_TEST_VARIANT names another variant."""
    return tnst_mi.activate(os.environ.get("TNST_MI_TEST_VARIANT", "llvm_ad_rgb"))


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a narrow GoogLeNet with random weights."""
    from networks import random_googlenet

    return random_googlenet(tmp_path_factory.mktemp("weights") / "random.safetensors", narrow=8)


@pytest.fixture(scope="session")
def network(weights: Path) -> GoogLeNet:
    """That network."""
    from tnst_mi.network.googlenet import GoogLeNet

    return GoogLeNet.load(weights)


def _asset(relative: str) -> Path:
    path = ASSETS / relative
    if not path.exists():
        pytest.skip(f"{relative} is not beside the checkout (looked for {path})")
    return path


@pytest.fixture(scope="session")
def bvlc_weights() -> Path:
    """The real BVLC GoogLeNet weights, or a skip where they are not at hand."""
    return _asset("weights/googlenet_bvlc.safetensors")


@pytest.fixture(scope="session")
def asset() -> object:
    """A function from a relative path to a real asset; skips where it is not at hand."""
    return _asset
