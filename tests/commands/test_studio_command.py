"""`tnst-mi studio`: what it opens, refuses and says, and how it ends."""

from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Run, refused, run, smoke
from jobs import FakeOptimiser, optimiser

import tnst_mi.run.job
from tnst_mi.commands.studio import _open, alone_in, first_and_root
from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.prepare import prepare
from tnst_mi.studio.places import Places
from tnst_mi.studio.session import Session

__all__ = ["optimiser", "run", "smoke"]


def test_what_cannot_be_served_is_refused(run: Run, smoke: Path) -> None:
    for flags, message in (
        (["--port", "x"], "--port x: expected an integer from 0 to 65535"),
        (["--port", "65536"], "from 0 to 65535"),
        (["--host", "no.such.host.invalid"], "cannot listen on no.such.host.invalid"),
        (["--variant", "scalar_rgb"], "variant"),
        (["--out", smoke / "f_07.npz" / "x"], "cannot be written to"),
        (["--token", "x"], "unexpected '--token'"),
        (["--weights", smoke / "none"], "no such file or folder; expected GoogLeNet weights, or patterns"),
        (["--weights", next(smoke.glob("*.npz"))], "weights"),
    ):
        refused(run, smoke.parent, ["studio", smoke, "--out", smoke.parent / "out", *flags], message)
    refused(run, smoke.parent, ["studio", smoke / "none" / "none.npz"], "no such file or folder")
    refused(run, smoke.parent, ["studio", smoke / "none.npz", "--out", smoke.parent / "out"], "none.npz")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused(run, smoke.parent, ["studio", smoke, "--out", smoke.parent / "out", "--port", port], f"port {port} ")


def test_what_is_opened_first_and_below_what(smoke: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    folder = tmp_path / "runs"
    list(tnst_mi.run.job.Run(prepare(smoke, Recipe(style=("net",)), folder / "a"), progress=False))
    file = next(smoke.glob("*.npz"))
    assert first_and_root(None) == (None, Path.cwd())
    assert first_and_root(smoke) == (smoke, smoke)
    assert first_and_root(file) == (file, smoke)
    assert first_and_root(folder) == (None, folder)
    assert first_and_root(folder / "a") == (folder / "a", folder)
    assert first_and_root(smoke / "f_##.npz") == (smoke / "f_##.npz", smoke)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems listen on 127.0.0.1 of all that begin with 127")
def test_the_url_is_printed_exposure_is_said_and_ctrl_c_ends_it(smoke: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tnst_mi", "studio", str(smoke), "--out", str(tmp_path / "out")]
    started = subprocess.Popen(
        [*command, "--host", "127.0.0.2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with started as process:
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        host, query = url.removeprefix("http://").split("/")
        for path, status in (("/" + query, 303), ("/", 403)):
            connection = http.client.HTTPConnection(host, timeout=60)
            connection.request("GET", path)
            assert connection.getresponse().status == status
            connection.close()
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
        assert process.returncode == 0 and out == ""
    (note,) = errors.splitlines()
    assert note.startswith("note: --host 127.0.0.2: whoever reaches") and str(smoke) in note
    assert os.listdir(tmp_path) == ["smoke"]  # a studio in which nothing is done writes nothing


def test_one_studio_at_a_time_has_a_folder(run: Run, smoke: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with alone_in(out):
        message = f"another studio is writing there .process {os.getpid()} on "
        refused(run, smoke.parent, ["studio", smoke, "--out", out], message)
        (out / "tries").mkdir()
    assert os.listdir(out) == ["tries"]
    with alone_in(out):
        pass
    assert os.listdir(out) == ["tries"]


def test_a_folder_with_a_damaged_frame_is_opened_with_the_error(smoke: Path, tmp_path: Path) -> None:
    """A file that is named has to be sound."""
    (smoke / "f_08.npz").write_bytes(b"")
    session = Session(Places(smoke), tmp_path / "out")
    with pytest.raises(InputError, match=r"f_08\.npz"):
        _open(session, smoke / "f_08.npz")
    _open(session, smoke)
    told = session.state()
    assert told["opened"] is None and "0 bytes" in told["notice"] and "\n" not in told["notice"]
    # It goes as soon as something else is opened.
    session.open(smoke / "f_07.npz")
    assert session.state()["notice"] is None
    session.end()
