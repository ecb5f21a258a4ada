"""The command line: find the command, let tyro read its flags, run it, and turn failures into exit codes.

Exit codes: 0 done, 1 failed, 2 bad input, 3 interrupted. Results go to stdout, progress and errors to stderr.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import io
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from functools import reduce
from operator import or_
from typing import Annotated

import tyro

from tnst_mi.commands.atlas import Atlas
from tnst_mi.commands.base import Command
from tnst_mi.commands.compare import Compare
from tnst_mi.commands.convert import Convert
from tnst_mi.commands.demo import Demo
from tnst_mi.commands.doctor import Doctor
from tnst_mi.commands.info import Info
from tnst_mi.commands.render import Render
from tnst_mi.commands.stylize import Stylize
from tnst_mi.commands.weights import Weights
from tnst_mi.errors import InputError, StoppedError

COMMANDS: dict[str, type[Command]] = {
    "demo": Demo,
    "stylize": Stylize,
    "render": Render,
    "compare": Compare,
    "convert": Convert,
    "atlas": Atlas,
    "info": Info,
    "weights": Weights,
    "doctor": Doctor,
}

_MARKERS = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `tnst-mi` with the given arguments (those of the process if None) and return its exit code."""
    if arguments is None:
        arguments = sys.argv[1:]
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(errors="replace")  # for consoles without λ and →
    arguments = list(arguments)
    try:
        code = _parsed(arguments).run()
        sys.stdout.flush()
        return code
    except SystemExit as stop:  # after --help
        return int(stop.code or 0)
    except KeyboardInterrupt:
        kept = "; --resume continues" if arguments[:1] == ["stylize"] else ""
        return _failed(arguments, f"interrupted{kept}", 3)
    except StoppedError as error:
        return _failed(arguments, str(error), 3)
    except BrokenPipeError:  # such as `tnst-mi info ... | head`
        # Python flushes stdout once more when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        bad_input = next((link for link in _chain(error) if isinstance(link, InputError)), None)
        if bad_input is not None:
            return _failed(arguments, str(bad_input), 2)
        cause = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        because = "" if cause is error else f", caused by {type(cause).__name__}: {cause}"
        hint = "" if "--debug" in arguments else " (--debug shows where)"
        return _failed(arguments, f"{type(error).__name__}: {error}{because}{hint}", 1)


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An exception and those that led to it: libraries wrap what their callbacks raise."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _failed(arguments: list[str], message: str, code: int) -> int:
    if "--debug" in arguments:
        traceback.print_exc()
    print("tnst-mi:", " ".join(message.split()), file=sys.stderr)
    return code


def _parsed(arguments: list[str]) -> Command:
    """Read the arguments; --help prints and raises SystemExit."""
    name = arguments[0] if arguments else "--help"
    if name in ("-h", "--help"):
        return _help()
    if name not in COMMANDS:
        nearest = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f"did you mean {nearest[0]}?" if nearest else f"expected one of {', '.join(COMMANDS)}"
        raise InputError(f"no command {name!r}; {hint} (tnst-mi --help explains them)")
    framed = io.StringIO()
    try:
        with contextlib.redirect_stderr(framed):
            command, unknown = tyro.cli(
                COMMANDS[name],
                prog=f"tnst-mi {name}",
                args=arguments[1:],
                config=_MARKERS,
                return_unknown_args=True,
            )
    except SystemExit as stop:
        if stop.code:
            raise InputError(_unframed(framed.getvalue())) from None
        raise
    if unknown:
        flag = unknown[0].partition("=")[0]
        nearest = difflib.get_close_matches(flag, _flags(command), n=1, cutoff=0.5)
        hint = f"did you mean {nearest[0]}?" if nearest else f"tnst-mi {name} --help lists what is known"
        raise InputError(f"{name}: unexpected {flag!r}; {hint}")
    return command


def _help() -> Command:
    """Print what the commands do."""
    commands = [Annotated[command, tyro.conf.subcommand(name)] for name, command in COMMANDS.items()]
    description = "Transport-based neural style transfer for smoke. Each command has its own --help."
    return tyro.cli(reduce(or_, commands), prog="tnst-mi", description=description, args=["--help"])


def _flags(command: object) -> Iterator[str]:
    """The flags of a command, those of its nested dataclasses included."""
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if dataclasses.is_dataclass(value):
            yield from _flags(value)
        else:
            yield "--" + field.name.replace("_", "-")


def _unframed(framed: str) -> str:
    """tyro's framed error message as one line, without the frame's title and the closing hint at --help."""
    rows = [row.strip("│╰╯─| ") for row in framed.splitlines()[1:]]
    return " ".join(row for row in rows if row).split(" For full helptext")[0]
