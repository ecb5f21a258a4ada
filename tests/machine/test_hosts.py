"""Programs that the package is a part of: their threads, their processes, and the variants that they choose."""

from __future__ import annotations

import multiprocessing
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch

import tnst_mi
from tnst_mi.io import load_frames, save_frames
from tnst_mi.losses.objective import Objective
from tnst_mi.losses.terms import Semantic
from tnst_mi.machine.gate import silenced
from tnst_mi.network.googlenet import GoogLeNet

SHAPE = (20, 24, 16)
RECIPE = {"style": ["spirals"], "octaves": 1, "iterations": 1, "views": 1, "weights": "patterns"}

#: Defines `density`, `recipe`, and `in_child(work)`: what a forked child answers, or its error; it may not hang.
HOST = f"""
import os, signal, sys
import numpy as np, tnst_mi, mitsuba as mi
density = np.random.default_rng(0).random((8, 12, 8)).astype(np.float32)
recipe = {RECIPE}
def in_child(work):
    reader, writer = os.pipe()
    if os.fork() == 0:
        signal.alarm(60)
        try:
            answer = str(work())
        except tnst_mi.InputError as error:
            answer = f"InputError {{error}}"
        os.write(writer, answer.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        answer = pipe.read()
    os.wait()
    return answer or "hangs"
"""


def run(program: str, **environment: str) -> list[str]:
    """The lines that a program prints, in a process of its own."""
    command, given = [sys.executable, "-c", HOST + program], os.environ | environment
    result = subprocess.run(command, env=given, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


# --------------------------------------------------------------------
# Threads
# --------------------------------------------------------------------


def density(number: int) -> np.ndarray:
    return np.random.default_rng(number).random(SHAPE).astype(np.float32)


def rendered(number: int) -> list[np.ndarray]:
    """Grids of one shape share a medium."""
    return [tnst_mi.render(density(number), view=(7, number))]


def rendered_gradient(number: int) -> list[np.ndarray]:
    smoke = torch.tensor(density(number), requires_grad=True)
    tnst_mi.render(smoke, view=[(10, 5), (0, number)], quadrature="exact").square().sum().backward()
    return [smoke.grad.numpy()]


def transported_gradients(number: int) -> list[np.ndarray]:
    smoke, phi = (torch.tensor(density(seed), requires_grad=True) for seed in (number, number + 1))
    tnst_mi.advect(smoke, tnst_mi.velocity(9 * phi, None, 0.5)).square().sum().backward()
    return [smoke.grad.numpy(), phi.grad.numpy()]


def transported(number: int) -> list[np.ndarray]:
    return [tnst_mi.advect(density(number), np.stack([density(number + 1)] * 3, -1), trace="flow")]


@pytest.fixture(scope="module")
def network() -> GoogLeNet:
    return GoogLeNet.load("patterns")


def in_threads(work: list[Callable[[], object]]) -> list[object]:
    """What each function answers in a thread of its own, or raises."""
    answers: list[object] = [None] * len(work)
    gate = threading.Barrier(len(work))

    def answer(index: int) -> None:
        gate.wait()
        try:
            answers[index] = work[index]()
        except Exception as error:
            answers[index] = error

    threads = [threading.Thread(target=answer, args=(index,)) for index in range(len(work))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers


def test_threads_get_the_bits_of_serial_calls(variant: str, network: GoogLeNet) -> None:
    """Values and derivatives of all functions, by eight threads that mix them."""

    def judged(number: int) -> list[np.ndarray]:
        images = torch.from_numpy(density(number)[:2]).requires_grad_()
        objective: Objective = Semantic("conv2/3x3", (number,))
        objective.bind(network, *SHAPE[1:])(images).backward()
        return [images.grad.numpy()]

    jobs = [rendered, rendered_gradient, transported_gradients, transported, judged]
    serial = {(job, number): job(number) for job in jobs for number in range(3)}
    wrong = []

    def mixed(first: int) -> None:
        for turn in range(first, first + 15):
            job, number = jobs[turn % 5], turn % 3
            if any(a.tobytes() != b.tobytes() for a, b in zip(job(number), serial[job, number], strict=True)):
                wrong.append(job.__name__)

    assert in_threads([lambda first=first: mixed(first) for first in range(8)]) == [None] * 8
    assert wrong == []
    assert mi.variant() == variant


def test_runs_in_threads_get_the_bits_of_serial_ones() -> None:
    def stylized(number: int) -> bytes:
        return tnst_mi.stylize(density(number)[:6, :12, :8], RECIPE, progress=False).densities[0].tobytes()

    serial = [stylized(number) for number in range(2)]
    assert in_threads([lambda number=number: stylized(number) for number in (0, 1, 0)]) == [*serial, serial[0]]


def test_threads_read_and_write_files_at_once(tmp_path: Path) -> None:
    """One file of all of them, too: it is whole, by whomever."""
    frames = [tnst_mi.Frame(density(number), name=f"f_{number:02d}") for number in range(4)]

    def written(frame: tnst_mi.Frame) -> float:
        for _ in range(5):
            save_frames(tmp_path / "same.npz", frame)
        save_frames(tmp_path / f"{frame.name}.npz", frame)
        return load_frames(tmp_path / f"{frame.name}.npz")[0].mass

    assert in_threads([lambda frame=frame: written(frame) for frame in frames]) == [frame.mass for frame in frames]
    assert load_frames(tmp_path / "same.npz")[0].mass in {frame.mass for frame in frames}
    assert len(list(tmp_path.iterdir())) == 5


def test_stderr_is_there_again_after_threads_have_silenced_it(capfd: pytest.CaptureFixture[str]) -> None:
    def quiet() -> None:
        for _ in range(200):
            with silenced():
                pass

    in_threads([quiet] * 4)
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"


# --------------------------------------------------------------------
# Processes
# --------------------------------------------------------------------


def test_a_spawned_worker_computes() -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        image = pool.apply(tnst_mi.render, (density(0),))
    np.testing.assert_array_equal(image, tnst_mi.render(density(0)))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_forked_child_computes_or_says_why_not() -> None:
    """Before anything was used; after torch was, whose idle threads the child lacks; after Dr.Jit was."""
    told = run(
        "print(in_child(lambda: tnst_mi.render(density).shape))\n"
        "import torch\n"
        "torch.conv2d(torch.rand(1, 3, 99, 99, requires_grad=True), torch.rand(8, 3, 3, 3)).sum().backward()\n"
        "network = tnst_mi.GoogLeNet.load('patterns')\n"
        "def features():\n"
        "    return network(torch.ones(1, 3, 64, 64), layers=['conv2/3x3'])['conv2/3x3'].shape\n"
        "print(features())\n"
        "print(in_child(features))\n"
        "print(in_child(lambda: tnst_mi.stylize(density, recipe, progress=False).densities[0].shape))\n"
        "mi.set_variant('scalar_rgb')\n"
        "print(in_child(lambda: tnst_mi.render(density).shape))\n"
        "tnst_mi.render(density)\n"
        "print(mi.variant())\n"
        "for work in (lambda: tnst_mi.render(density), lambda: tnst_mi.stylize(density, recipe, progress=False)):\n"
        "    print(in_child(work))\n"
        "print(in_child(features))\n"
        "print(tnst_mi.render(density).shape)\n"
    )
    features = "torch.Size([1, 192, 32, 32])"
    assert told[:6] == ["(12, 8)", features, features, "(8, 12, 8)", "(12, 8)", "scalar_rgb"]
    refused = (
        r"InputError process \d+ was forked after Dr.Jit had been used, and cannot use it: fork earlier, or start .*"
    )
    assert all(re.fullmatch(refused, line) for line in told[6:8]), told[6:8]
    assert told[8:] == [features, "(12, 8)"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_child_knows_that_another_package_has_used_drjit() -> None:
    (told,) = run("mi.set_variant('llvm_ad_spectral')\nprint(in_child(lambda: tnst_mi.render(density)))\n")
    assert told.startswith("InputError process ") and "was forked after Dr.Jit had been used" in told


# --------------------------------------------------------------------
# Variants
# --------------------------------------------------------------------


def test_another_package_s_variant_is_put_back() -> None:
    told = run(
        "import torch\n"
        "first = tnst_mi.render(density), tnst_mi.stylize(density, recipe, progress=False).densities[0]\n"
        "for variant in ('scalar_rgb', 'llvm_ad_spectral'):\n"
        "    mi.set_variant(variant)\n"
        "    again = tnst_mi.render(density), tnst_mi.stylize(density, recipe, progress=False).densities[0]\n"
        "    print(all((a == b).all() for a, b in zip(first, again)), mi.variant())\n"
        "    try:\n"
        "        tnst_mi.stylize(density, recipe | {'octaves': 0}, progress=False)\n"
        "    except tnst_mi.InputError:\n"
        "        print(mi.variant())\n"
        "    try:\n"
        "        tnst_mi.render(torch.from_numpy(density).requires_grad_())\n"
        "    except tnst_mi.InputError as error:\n"
        "        print(error)\n"
        "print(tnst_mi.activate(), mi.variant())\n"
    )
    lines = [
        line
        for active in ("scalar_rgb", "llvm_ad_spectral")
        for line in (
            f"True {active}",
            active,
            f"render: the variant {active} is active, and derivatives need one of cuda_ad_rgb, llvm_ad_rgb until they "
            "have been taken: call tnst_mi.activate() before",
        )
    ]
    chosen = told[-1].split()[0]
    assert told == [*lines, f"{chosen} {chosen}"] and chosen.endswith("_ad_rgb")


def test_the_variant_of_a_thread_is_that_of_all() -> None:
    """Mitsuba keeps one for the process: what a thread chooses, the others get."""
    told = run(
        "import threading\n"
        "tnst_mi.activate('llvm_ad_rgb')\n"
        "thread = threading.Thread(target=lambda: mi.set_variant('scalar_rgb'))\n"
        "thread.start(); thread.join()\n"
        "print(mi.variant(), tnst_mi.render(density).shape)\n"
    )
    assert told == ["scalar_rgb (12, 8)"]


@pytest.mark.skipif(not dr.has_backend(dr.JitBackend.LLVM), reason="LLVM is to be found first")
def test_a_library_that_is_not_there_is_named_with_the_remedy() -> None:
    nowhere = "/nowhere/libLLVM-19.so"
    told = run(
        "try:\n    tnst_mi.activate('llvm_ad_rgb')\nexcept tnst_mi.InputError as error:\n    print(error)\n",
        DRJIT_LIBLLVM_PATH=nowhere,
        _TNST_MI_LIBLLVM_PATH="",
    )
    assert len(told) == 1 and f"DRJIT_LIBLLVM_PATH names {nowhere}; unset it, or name a library" in told[0]
