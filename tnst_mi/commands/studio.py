"""`tnst-mi studio`: a page in the browser to look, choose, try and render."""

from __future__ import annotations

import os
import platform
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tnst_mi.commands.arguments import StudioArguments
from tnst_mi.commands.base import checked, given, say
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import make_folder
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.heap import give_back_large_blocks
from tnst_mi.machine.lock import FolderLock, locked
from tnst_mi.machine.terminal import one_line
from tnst_mi.network.weights import ENVIRONMENT_VARIABLE, find_weights
from tnst_mi.recipe.keys import Integer
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import expanded
from tnst_mi.run.folder import holds_run
from tnst_mi.studio.choices.examples import ExampleMaker
from tnst_mi.studio.choices.motifs import MotifBrowser
from tnst_mi.studio.jobs.clusters import checked_address
from tnst_mi.studio.page.routes import StudioRoutes
from tnst_mi.studio.page.server import StudioServer
from tnst_mi.studio.places import Places
from tnst_mi.studio.session import Session

#: What reaches no other machine.
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def run(arguments: StudioArguments) -> int:
    """Serve the page until Ctrl-C."""
    port = checked("port", arguments.port, Integer(0, 65535))
    first, root = first_and_root(arguments.input)
    recipe = Recipe().updated_by_flags(given(arguments.resources))
    give_back_large_blocks()
    activate(recipe.variant)
    if recipe.weights is not None:
        find_weights(recipe.weights)  # what cannot be used is refused before anything is shown
        # What is resumed may have been begun without: it takes the same network, or is refused.
        os.environ[ENVIRONMENT_VARIABLE] = recipe.weights
    out = expanded(arguments.out)
    require_writable(out, remedy=None)
    with alone_in(out) as lock:
        cluster = None if arguments.cluster is None else checked_address(arguments.cluster, None)
        session = Session(Places(root), out, cluster, lock, recipe.weights)
        return _serve(arguments, port, first, session, out)


@contextmanager
def alone_in(out: Path) -> Iterator[FolderLock]:
    """Within the block, no other studio has this folder, which is made; if nothing is in it at the end, it is removed.

    Raises:
        InputError: another one has it.
        OSError: it cannot be written to.
    """
    new = not out.exists()
    make_folder(out)
    try:
        with locked(out, by="studio") as lock:
            yield lock
    finally:
        if new:
            with suppress(OSError):  # something is in it
                out.rmdir()


def _serve(arguments: StudioArguments, port: int, first: Path | None, session: Session, out: Path) -> int:
    if first is not None:
        _open(session, first)
    motifs, examples = MotifBrowser(session.places, out), ExampleMaker(out)
    server = StudioServer(arguments.host, port, StudioRoutes(session, motifs, examples))
    if arguments.host not in LOOPBACK:
        say(
            [
                f"note: --host {arguments.host}: whoever reaches this machine there and has the URL can read the smoke "
                f"below {session.places.root} and compute here; it is not encrypted. An ssh tunnel needs no --host"
            ]
        )
    print(f"studio    {_url(arguments.host, server)}", flush=True)
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    try:
        # A join without a limit would not hear of Ctrl-C on every system.
        while serving.is_alive():
            serving.join(1.0)
    except KeyboardInterrupt:
        pass  # the way to end it
    finally:
        examples.end()
        paused = session.end()
        server.shutdown()
        server.server_close()
    say([f"paused    {out / name}; a studio with this --out goes on with it" for name in paused])
    return 0


def _open(session: Session, first: Path) -> None:
    """Show what was named; of a folder in which something cannot be shown, the page says so and offers the rest.

    What was to be said before, nobody has seen yet.

    Raises:
        InputError: it is a file or a run, and cannot be shown.
    """
    notices = [session.notice]
    try:
        session.open(first)
    except InputError as error:
        if not first.is_dir() or holds_run(first):
            raise
        notices.append(one_line(str(error)))
    session.notice = "; ".join(filter(None, notices)) or None


def first_and_root(given: Path | None) -> tuple[Path | None, Path]:
    """What is opened first, if anything, and the folder below which all that can be opened lies.

    Args:
        given: densities, a run, a folder of these, or None for the current folder.

    Raises:
        InputError: nothing is there.
    """
    if given is None:
        return None, Path.cwd()
    if given.is_dir():
        if holds_run(given):
            return given, given.resolve().parent
        return (given if _has_frames(given) else None), given
    if not given.parent.is_dir():
        raise InputError(f"{given}: no such file or folder")
    return given, given.parent


def _has_frames(folder: Path) -> bool:
    """Whether a folder holds frames rather than folders of them and runs."""
    return any(entry.kind == "frames" for entry in Places(folder).found(""))


def _url(host: str, server: StudioServer) -> str:
    # An address that stands for all addresses of this machine leads nowhere.
    named = platform.node() if host in ("", "0.0.0.0", "::") else host
    shown = f"[{named}]" if ":" in named else named
    return f"http://{shown}:{server.server_port}/?token={server.access.token}"
