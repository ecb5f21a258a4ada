"""A limit of the address space is found before libraries fail to load."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tnst_mi.errors import InputError
from tnst_mi.machine import address_space, environment

resource = pytest.importorskip("resource")


def limited(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(address_space.resource, "getrlimit", lambda which: (most, most))


@pytest.mark.parametrize(("most", "reads", "computes"), [(2_000_000_000, True, True), (1_900_000_000, True, False)])
def test_commands_need_what_their_libraries_need(
    monkeypatch: pytest.MonkeyPatch, most: int, reads: bool, computes: bool
) -> None:
    limited(monkeypatch, most)
    for reading_only, fits in ((True, reads), (False, computes)):
        if fits:
            address_space.require_address_space(reading_only)
        else:
            with pytest.raises(InputError, match=r"this process may use 1\.9 GB of address space, .* need 2 GB; raise"):
                address_space.require_address_space(reading_only)
    limited(monkeypatch, 400_000_000)
    with pytest.raises(InputError, match=r"0\.4 GB of address space"):
        address_space.require_address_space(True)


def test_free_memory_is_within_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    used = environment.psutil.Process().memory_info().vms
    limited(monkeypatch, used + 100_000_000)
    assert 0 <= environment.free_memory() <= 100_000_000
    limited(monkeypatch, 1)
    assert environment.free_memory() == 0
    limited(monkeypatch, resource.RLIM_INFINITY)
    assert address_space.limit() is None and environment.free_memory() > 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not keep the limit")
def test_a_small_limit_ends_a_command_with_one_line() -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_AS, (1_000_000_000, resource.RLIM_INFINITY)); "
    program = f"{limit}from tnst_mi.cli import main; raise SystemExit(main(['stylize', 'a.npz', '--out', 'b']))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("tnst-mi: memory: this process may use 1 GB of address space")
