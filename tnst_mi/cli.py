"""The command line: find the command, let tyro read its flags, run it, and turn failures into exit codes.

Exit codes: 0 done, 1 failed, 2 bad input, 3 interrupted; 141, as of a program that SIGPIPE ends, if the reader of
stdout has left. Results go to stdout, progress and errors to stderr.

Imports are deferred until they are needed: the overview and unknown commands need none, --help and wrong flags only
those of `tnst_mi.commands.arguments`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import errno
import importlib
import io
import os
import re
import sys
import textwrap
import traceback
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine.address_space import require_address_space
from tnst_mi.machine.interrupt import ended_like_ctrl_c
from tnst_mi.machine.terminal import one_line
from tnst_mi.resources import VERSION, expanded

if TYPE_CHECKING:
    from tnst_mi.commands.base import Arguments

#: Commands with their summaries; the module of the same name in `tnst_mi.commands` provides `run`.
COMMANDS = {
    "demo": "Stylize the bundled frame with the bundled recipe; needs nothing else.",
    "stylize": "Stylize a density file, or a folder of numbered ones, towards pictures, features or classes.",
    "train": "Train a network that stylizes smoke of a kind in one pass, for `stylize --model`.",
    "batch": "Stylize every input by every recipe, one run after the other, and show the results on a page.",
    "reconstruct": "Find the density of smoke from pictures that cameras with known places took.",
    "render": "Render a density file, or each file of a folder, as PNG and EXR, or as a turntable video.",
    "show": "Show runs as they will be seen: lit, side by side, before and after, as a picture or a film.",
    "diff": "Compare two runs, finished or not, or two densities: recipes, numbers, and pictures side by side.",
    "compare": "Compare our images and gradients of smoke with those of Mitsuba's path tracer, or any two renderers.",
    "convert": "Convert a density file, or a folder of numbered ones, to npz, .vol, .uni, .vdb, or a stage of USD.",
    "atlas": "Show every channel of a layer: the picture that excites it, and what it makes of a ball of smoke.",
    "studio": "Open a page in the browser: look at smoke and runs from all sides, choose motifs, try them, and render.",
    "info": "Describe files or folders of frames: arrays or grids, how they are read, shape, ranges, mass, largest "
    "velocity.",
    "weights": "List the GoogLeNet weights found, and where to get others.",
    "doctor": "Check Python, Mitsuba, Dr.Jit, LLVM, GPU, OptiX, torch, weights and memory; say how to get what is "
    "missing.",
}

#: Commands that load neither the network nor what compiles kernels.
_WITHOUT_TORCH = ("info", "convert")

#: The exit code that shells show for a program that SIGPIPE has ended (128 + 13), as it ends git and the coreutils.
READER_LEFT = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `tnst-mi` with the given arguments (those of the process if None) and return its exit code."""
    if arguments is None:
        arguments = sys.argv[1:]
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # for consoles without λ and →
    arguments = list(arguments)
    try:
        with ended_like_ctrl_c():
            code = _code(arguments)
    except BrokenPipeError:  # such as `tnst-mi info ... | head`
        code = READER_LEFT
    try:
        if sys.stdout is not None:  # as in a program that is started without one
            sys.stdout.flush()
    except OSError as error:
        assert sys.stdout is not None
        # Python writes what is left on exit, and would complain once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return READER_LEFT
        return code or _failed(arguments, f"the output cannot be written ({error.strerror}){_remedy(error)}", 1)
    return code


def _code(arguments: list[str]) -> int:
    """The exit code of a command, which is run; what goes wrong is said in one line.

    Raises:
        BrokenPipeError: the reader of stdout or stderr has left.
    """
    try:
        return _run(arguments)
    except SystemExit as stop:  # after --help
        return int(stop.code or 0)
    except KeyboardInterrupt:
        kept = "; --resume continues" if arguments[:1] == ["stylize"] else ""
        return _failed(arguments, f"interrupted{kept}", 3)
    except StoppedError as error:
        return _failed(arguments, str(error), 3)
    except BrokenPipeError:
        raise
    except Exception as error:
        if any(isinstance(link, KeyboardInterrupt) for link in _chain(error)):
            return _failed(arguments, "interrupted", 3)  # inside a callback of Mitsuba's or Dr.Jit's
        bad_input = next((link for link in _chain(error) if isinstance(link, InputError)), None)
        if bad_input is not None:
            return _failed(arguments, str(bad_input), 2)
        if any(isinstance(link, MemoryError) for link in _chain(error)):
            return _failed(arguments, "out of memory: take smaller frames, or free some memory or raise its limit", 2)
        if isinstance(error, OSError) and error.strerror and error.filename is not None:
            return _failed(arguments, f"{error.filename}: {error.strerror}{_remedy(error)}", 1)
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EFBIG, errno.EIO, errno.EBADF):
            # Whatever is a file has its name in the error.
            return _failed(arguments, f"the output cannot be written ({error.strerror}){_remedy(error)}", 1)
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        because = "" if cause is error else f", caused by {type(cause).__name__}: {cause}"
        hint = "" if "--debug" in arguments else " (--debug shows where)"
        return _failed(arguments, f"{type(error).__name__}: {error}{because}{hint}", 1)


def _remedy(error: OSError) -> str:
    """What the system's words do not tell of a file that cannot be written, as the end of a message."""
    if error.errno == errno.EFBIG:
        return "; raise the limit on file sizes (ulimit -f)"
    full = error.filename is not None and error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))
    return "; free some space on its disk, or give another place" if full else ""


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An exception and those that led to it: libraries wrap what their callbacks raise."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _failed(arguments: list[str], message: str, code: int) -> int:
    # Where stderr cannot be written to either, as on a terminal that has been closed, the code has to do.
    with contextlib.suppress(OSError):
        if "--debug" in arguments:
            traceback.print_exc()
        print("tnst-mi:", one_line(message), file=sys.stderr)
    return code


def _run(arguments: list[str]) -> int:
    """Run the command that the arguments name, or print the overview."""
    name = arguments[0] if arguments else "--help"
    if name in ("-h", "--help"):
        print(_overview())
        return 0
    if name in ("-V", "--version"):
        print(f"tnst-mi {VERSION}")
        return 0
    if name not in COMMANDS:
        nearest = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"did you mean {nearest[0]}?" if nearest else f"expected one of {', '.join(COMMANDS)}"
        raise InputError(f"no command {name!r}; {hint} (tnst-mi --help explains them)")
    require_address_space(reading_only=True)
    parsed = _parsed(name, arguments[1:])
    require_address_space(name in _WITHOUT_TORCH)
    return importlib.import_module(f"tnst_mi.commands.{name}").run(parsed)


def _overview() -> str:
    """The commands with their summaries."""
    description = "Transport-based neural style transfer for smoke. Each command has its own --help."
    rows = [
        textwrap.fill(summary, width=80, initial_indent=f"  {name:12}", subsequent_indent=" " * 14)
        for name, summary in COMMANDS.items()
    ]
    return "\n".join(["usage: tnst-mi COMMAND ...", "", description, "", *rows])


def _parsed(name: str, arguments: list[str]) -> Arguments:
    """Read the arguments of a command; --help prints and raises SystemExit."""
    import tyro

    from tnst_mi.commands.arguments import ARGUMENTS

    _require_known_flags(name, arguments)
    framed = io.StringIO()
    try:
        with contextlib.redirect_stderr(framed):
            parsed, unknown = tyro.cli(
                ARGUMENTS[name],
                prog=f"tnst-mi {name}",
                args=arguments,
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
                return_unknown_args=True,
            )
    except SystemExit as stop:
        if stop.code:
            raise InputError(_unframed(framed.getvalue())) from None
        raise
    if unknown:
        hint = f"tnst-mi {name} --help lists what is known"
        if os.path.exists(unknown[0]):
            hint = "files of a sequence are given as their folder, or as a pattern in quotes, such as 'smoke_*.vdb'"
        raise InputError(f"{name}: unexpected {unknown[0]!r}; {hint}")
    _expand_home(parsed)
    return parsed


def _require_known_flags(name: str, arguments: Sequence[str]) -> None:
    """Check the names of the flags: of unknown ones, tyro may take the values for other arguments.

    Raises:
        InputError: a command does not have one of them.
    """
    from tnst_mi.commands.arguments import ARGUMENTS, POSITIONAL
    from tnst_mi.commands.base import OTHER_FLAGS

    fields = list(_fields(ARGUMENTS[name]))
    flags = {"-h", "--help"} | {f"--{field.replace('_', '-')}" for field in fields if field not in POSITIONAL}
    flags |= {other for field in fields for other in OTHER_FLAGS.get(field, ())}
    for word in arguments:
        flag = re.match(r"--?[a-zA-Z][^=]*", word)
        if flag and flag[0].replace("_", "-") not in flags:
            raise InputError(f"{name}: unexpected {flag[0]!r}; {_hint(name, flag[0], fields)}")


def _hint(name: str, flag: str, known: Collection[str]) -> str:
    """What a flag that a command does not have probably means, of the arguments that it knows."""
    from tnst_mi.commands.arguments import POSITIONAL
    from tnst_mi.recipe.synonyms import advice, meant

    if found := meant(flag, known):
        if found in POSITIONAL:
            return f"{POSITIONAL[found]} is given without a flag"
        return f"did you mean --{found.replace('_', '-')}?"
    return advice(flag, known) or f"tnst-mi {name} --help lists what is known"


def _fields(arguments: Any) -> Iterator[str]:
    """The names of the arguments that a dataclass defines, including those of nested ones."""
    for field in dataclasses.fields(arguments):
        if dataclasses.is_dataclass(field.default_factory):
            yield from _fields(field.default_factory)
        else:
            yield field.name


def _expand_home(arguments: Arguments) -> None:
    """Replace ~ in paths, which shells leave alone in `--out=~/smoke` and in quotes."""
    for field in dataclasses.fields(arguments):
        value = getattr(arguments, field.name)
        if isinstance(value, Path):
            setattr(arguments, field.name, expanded(value))
        elif isinstance(value, tuple) and value and all(isinstance(item, Path) for item in value):
            setattr(arguments, field.name, tuple(expanded(item) for item in value))


def _unframed(framed: str) -> str:
    """tyro's framed error message as one line, without the frame's title and the closing pointer to --help."""
    rows = [row.strip("│╰╯─| ") for row in framed.splitlines()[1:]]
    return " ".join(row for row in rows if row).split(" For full helptext")[0]
