"""What every integrator finds in the scenes of scenes/known, as the table of docs/physics.md.

    python scripts/known_answers.py --spp 1048576 --out known.json [SCENE…]

Each scene and integrator is kept in the JSON file as soon as it is done: the same command continues where it stopped.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import tnst_mi
from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.hypotheses import DIFFERENCED, DIFFERENTIATED
from tnst_mi.compare.bench.known_answers import Answer, known_scenes
from tnst_mi.compare.bench.measurement import measure, prepare
from tnst_mi.compare.bench.sides import ANSWER, OURS, PATH_TRACERS, side_of
from tnst_mi.io.atomic import written_whole


def measured(path: Path, integrator: str, answer: Answer, spp: int) -> dict[str, Any]:
    """The radiance and its derivatives, each with its standard error."""
    parameters = tuple(answer.derivatives)
    settings = BenchSettings(
        side_of("left", integrator), side_of("right", ANSWER), (), spp, max(32, spp // 4), parameters, 1e-3, 0
    )
    found = measure(prepare(path, settings), ("0",), settings, lambda name, share: None)
    (images,) = found.images
    rows = {"radiance": _estimate(images.left)}
    for derivative in found.derivatives:
        for way, estimate in derivative.left.items():
            rows[f"{derivative.parameter}, {way}"] = _estimate(estimate)
    return rows


def _estimate(batches: Any) -> list[float]:
    return [float(batches.mean.squeeze()), float(batches.standard_error.squeeze())]


def markdown(records: dict[str, dict[str, Any]]) -> str:
    """A line for each scene and quantity: how far each integrator is from the answer, in standard errors."""
    integrators = (OURS, *PATH_TRACERS)
    lines = [f"| scene | | answer | {' | '.join(integrators)} |", "|---" * (3 + len(integrators)) + "|"]
    for path, answer in known_scenes().items():
        quantities = {"radiance": answer.radiance}
        for parameter, value in answer.derivatives.items():
            quantities |= {f"{parameter}, {way}": value for way in (DIFFERENTIATED, DIFFERENCED)}
        for quantity, value in quantities.items():
            cells = [_cell(records.get(f"{path.stem} {name}", {}).get(quantity), value) for name in integrators]
            if any(cell != "–" for cell in cells):
                lines.append(f"| {path.stem} | {quantity} | {value:.6g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(found: list[float] | None, answer: float) -> str:
    if found is None:
        return "–"
    value, error = found
    # What has no noise but rounding is told by its relative error.
    if error <= 1e-5 * max(abs(value), abs(answer), 1e-2):
        return f"{value:.6g} ({value - answer:+.1e})"
    return f"{value:.5g} ({(value - answer) / error:+.1f} SE)"


def main() -> None:
    """Measure what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="names of scenes; all by default")
    parser.add_argument("--spp", type=int, default=1 << 20)
    parser.add_argument("--out", type=Path, default=Path("known.json"))
    arguments = parser.parse_args()
    tnst_mi.activate()
    records = json.loads(arguments.out.read_text("utf-8")) if arguments.out.is_file() else {}
    for path, answer in known_scenes().items():
        for integrator in (OURS, *PATH_TRACERS):
            key = f"{path.stem} {integrator}"
            chosen = not arguments.scenes or path.stem in arguments.scenes
            if chosen and key not in records and not (answer.scatters and integrator == OURS):
                # Ours is the same for every ray of these scenes.
                records[key] = measured(path, integrator, answer, 32 if integrator == OURS else arguments.spp)
                with written_whole(arguments.out) as temporary:
                    temporary.write_text(json.dumps(records, indent=1) + "\n", "utf-8")
    print(markdown(records))


if __name__ == "__main__":
    main()
