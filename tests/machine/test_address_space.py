"""A limit of the address space is found before libraries fail to load."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
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


linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not keep the limit")


@linux
@pytest.mark.parametrize("most", [20, 60, 100, 150, 200, 245, 260, 290, 307, 328, 400, 449])
@pytest.mark.parametrize("command", ["info", "stylize"])
def test_a_small_limit_ends_a_command_with_one_line(command: str, most: int) -> None:
    """Whatever Mitsuba, LLVM and numpy would do under it: say something of theirs, or abort the process."""
    done = under_limit(f"{most}_000_000", f"main(['{command}', 'a.npz'])")
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1), done.stderr
    assert done.stderr.startswith(f"tnst-mi: memory: this process may use {most / 1e3:.2g} GB")
    assert "need 0.45 GB; raise the limit (ulimit -v" in done.stderr


@linux
@pytest.mark.parametrize("most", ["450_000_000", "1_000_000_000"])
def test_a_limit_for_reading_is_too_small_for_computing(most: str) -> None:
    done = under_limit(most, "main(['stylize', 'a.npz', '--out', 'b'])")
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1), done.stderr
    assert "need 2 GB; raise the limit (ulimit -v" in done.stderr


@linux
def test_a_small_limit_is_named_to_a_program() -> None:
    done = under_limit("300_000_000", "__import__('tnst_mi').load_frames('a.npz')")
    assert done.returncode == 1 and "InputError: memory: this process may use 0.3 GB" in done.stderr


@linux
def test_memory_that_runs_out_all_the_same(tmp_path: Path) -> None:
    """As it does where something else has taken it since it was free."""
    np.savez_compressed(tmp_path / "a.npz", density=np.zeros((300, 300, 300), np.float32))
    program = f"""
import resource, psutil
from tnst_mi.cli import main
from tnst_mi.commands import info  # libraries are there before the limit is
from tnst_mi.io import untrusted
untrusted.free_memory = lambda: 1 << 40
most = psutil.Process().memory_info().vms + 80_000_000
resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
raise SystemExit(main(["info", {str(tmp_path / "a.npz")!r}]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1), done.stderr
    assert done.stderr.endswith("a.npz: takes more memory than there is\n")


def under_limit(most: str, call: str) -> subprocess.CompletedProcess[str]:
    """A Python program that imports the command under a limit of so many bytes."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({most}, resource.RLIM_INFINITY)); "
    program = f"{limit}from tnst_mi.cli import main; raise SystemExit({call})"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
