"""How fast a shot would be on more workers than there are at hand, and what it asks of the network and the disk.

    python scripts/plan_cluster.py OUT|MEASURED.toml [--frames 24 120 1000] [--workers 1 8 64] [--plot PLAN.png]
    python scripts/plan_cluster.py OUT --frames 12 --workers 1 2 3 --per-machine 3 --cores 2

The second line is this machine of two cores, to be compared with what was measured there. It is a simulation of the
tasks of `tnst-mi stylize --cluster`, event by event: which task waits for which, a scheduler that does one thing at a
time on the first machine, workers that each take the tasks of a block of consecutive frames, and tasks of others when
they have none.
Printed is a table (Markdown):

    time        from the beginning of the run to its end
    speed-up    against one worker
    idle        the part of their time that workers wait for tasks
    read        from the shared folder over the network, and with "written" the rate that this comes to: a file server
                that is slower than that is what the run will wait for, and the table does not know it
    store       what OUT/.work takes at most; "results": what the results in OUT take

What was measured is read from OUT, the folder of a run on a cluster. `--cluster local:1` is one; of others it does not
tell what a scheduler of its own computes. It never tells the seconds of --latency, nor the sizes of the input's files,
which are not in the table then. Or it comes from a file in TOML or JSON:

    window = 5                    # 1 where each frame is stylized by itself
    iterations = [20, 20]         # of each octave
    prepare_seconds = 4.0         # the coordinator's, before the first task: these five may be left out
    conclude_seconds = 3.0        # and after the last
    coordinator_seconds = 0.1     # for each frame, beside these
    scheduler_seconds = 0.001     # the scheduler's and the coordinator's, for each task
    latency_seconds = 0.004       # from the end of a task to the start of one that waited for it

    [[tasks.step]]                # the first octave
    seconds = 0.9                 # on a core of one's own
    bytes_written = 600_000       # 0, if it is left out
    bytes_read = 2_400_000        # by a task whose window is whole and whose worker has nothing yet; without, all
                                  # that the items have that it needs
    [[tasks.step]]                # the second octave
    seconds = 3.1
    first_seconds = 4.0           # by a worker that has done none before: libraries are loaded, kernels compiled

Kinds of tasks, of which a list has an entry for each octave, are those of run.json: with a window inputs, fields,
gain, scales, step and average; without, inputs, fields, scales and iterate (all iterations of a frame); and finish,
whose list has one. gain, scales and finish may be missing. Files of the input are what `inputs` reads in the first
octave, results what `finish` writes.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from cluster_plan.graph import graph_of
from cluster_plan.measured import Measured, read_measured
from cluster_plan.recorded import measured_by
from cluster_plan.simulation import Cluster, Prediction, simulate
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi.errors import InputError, naming
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.terminal import amount

FRAMES, WORKERS = (24, 120, 1000), (1, 2, 4, 8, 16, 32, 64)

#: Flags that take the place of what was measured.
_SECONDS = {
    "prepare": "of the coordinator before the first task",
    "conclude": "of the coordinator after the last",
    "coordinator": "of the coordinator for each frame, beside these",
    "scheduler": "of scheduler and coordinator for each task",
    "latency": "from the end of a task to the start of one that waited for it",
}

_HEAD = ("frames", "workers", "time", "speed-up", "idle", "read", "written", "rate", "store", "results")

#: Of each number of frames, by number of workers.
Plan = dict[int, dict[int, Prediction]]


def main() -> int:
    """Print the table; 2 if something given cannot be used."""
    arguments = parsed()
    try:
        require(arguments)
        measured = found_in(arguments)
        with naming(arguments.measured):
            plan = planned(measured, arguments)
        if arguments.plot is not None:
            with written_whole(arguments.plot) as unfinished:
                unfinished.write_bytes(plotted(plan))
    except (InputError, OSError) as error:
        print(f"plan_cluster: {error}", file=sys.stderr)
        return 2
    print(table(plan))
    return 0


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("measured", type=Path, metavar="MEASURED", help="the folder of a run, or a .toml or .json file")
    parser.add_argument("--frames", type=int, nargs="+", default=FRAMES, metavar="N", help="lengths of the shot")
    parser.add_argument("--workers", type=int, nargs="+", default=WORKERS, metavar="N", help="of one thread each")
    parser.add_argument("--per-machine", type=int, default=1, metavar="N", help="workers that share a machine (1)")
    parser.add_argument(
        "--cores", type=float, default=math.inf, metavar="N", help="of a machine, if it has fewer than its workers need"
    )
    parser.add_argument(
        "--cache",
        type=float,
        default=0.0,
        metavar="BYTES",
        help="what a worker keeps of what it has read or written (0)",
    )
    for name, what in _SECONDS.items():
        parser.add_argument(f"--{name}", type=float, metavar="SECONDS", help=f"{what} (as measured, else 0)")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="also draw speed-up and network")
    return parser.parse_args()


def require(arguments: argparse.Namespace) -> None:
    """Check the numbers of the command line.

    Raises:
        InputError: one is too small.
    """
    leasts = dict.fromkeys(("frames", "workers", "per_machine", "cores"), 1) | dict.fromkeys(("cache", *_SECONDS), 0)
    for name, least in leasts.items():
        given = getattr(arguments, name)
        for value in given if isinstance(given, Sequence) else [given] if given is not None else []:
            if not value >= least:
                raise InputError(f"--{name.replace('_', '-')} {value}: expected {least} or more")


def found_in(arguments: argparse.Namespace) -> Measured:
    """What was measured, with what the command line puts in its place.

    Raises:
        InputError: it cannot be used.
        OSError: it cannot be read.
    """
    path = arguments.measured
    measured = measured_by(path) if path.is_dir() else read_measured(path)
    given = {f"{name}_seconds": getattr(arguments, name) for name in _SECONDS}
    return dataclasses.replace(measured, **{key: value for key, value in given.items() if value is not None})


def planned(measured: Measured, arguments: argparse.Namespace) -> Plan:
    """Simulate every number of frames on every number of workers, one worker among them.

    Raises:
        InputError: a task reads, and needs nothing that it could read.
    """
    plan: Plan = {}
    for frames in arguments.frames:
        graph = graph_of(measured, frames)
        plan[frames] = {
            workers: simulate(
                measured, graph, Cluster(workers, arguments.per_machine, arguments.cores, arguments.cache)
            )
            for workers in sorted({1, *arguments.workers})
        }
    return plan


def table(plan: Plan) -> str:
    """The table, in Markdown."""
    rows = [_HEAD, ("---",) * len(_HEAD)]
    rows += [
        (
            str(frames),
            str(workers),
            duration(found.seconds),
            f"{by_workers[1].seconds / found.seconds:.2f}",
            f"{found.idle:.0%}",
            amount(round(found.bytes_read)),
            amount(round(found.bytes_written)),
            f"{rate(found) / 1e6:.3g} MB/s",
            amount(round(found.store_bytes)),
            amount(round(found.result_bytes)),
        )
        for frames, by_workers in plan.items()
        for workers, found in by_workers.items()
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def rate(found: Prediction) -> float:
    """Bytes per second over the network, the mean over the run."""
    return (found.bytes_read + found.bytes_written) / found.seconds if found.seconds > 0 else 0.0


def duration(seconds: float) -> str:
    """A time, such as 42.0 s, 12:05 or 3:02:11."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def plotted(plan: Plan) -> bytes:
    """Speed-up and network over the number of workers, a line for each number of frames: a PNG."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    speed, network = figure.subplots(1, 2)
    most = max(max(by_workers) for by_workers in plan.values())
    speed.plot([1, most], [1, most], color="0.7", linestyle="--", label="workers")
    for frames, by_workers in plan.items():
        found = list(by_workers.values())
        speed.plot(
            list(by_workers), [found[0].seconds / one.seconds for one in found], marker="o", label=f"{frames} frames"
        )
        network.plot(list(by_workers), [rate(one) / 1e6 for one in found], marker="o", label=f"{frames} frames")
    speed.set(title="speed-up", xlabel="workers", xscale="log", yscale="log")
    network.set(title="network, MB/s", xlabel="workers", xscale="log", ylim=(0, None))
    ticks = sorted({workers for by_workers in plan.values() for workers in by_workers})
    for axes in (speed, network):
        axes.set_xticks(ticks, [str(workers) for workers in ticks])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend()
    speed.set_yticks(ticks, [str(workers) for workers in ticks])
    picture = io.BytesIO()
    FigureCanvasAgg(figure).print_png(picture)
    return picture.getvalue()


if __name__ == "__main__":
    raise SystemExit(main())
