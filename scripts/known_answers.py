"""What every integrator finds in the scenes of scenes/known, as the table of docs/physics.md.

    python scripts/known_answers.py --spp 1048576 --out known.json [SCENE…]
    python scripts/known_answers.py --spp 262144 --out variants.json --variants

With --variants, the radiance in each of Mitsuba's variants that works here, in place of the one of a stylization.
Each integrator has a seed of its own. Each scene and integrator is kept in the JSON file as soon as it is done: the
same command continues where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from pathlib import Path
from typing import Any

import mitsuba as mi

import tnst_mi
from tnst_mi.compare.bench.bench_settings import BenchSettings
from tnst_mi.compare.bench.measurement import measure, prepare
from tnst_mi.compare.bench.renderers.known_answers import known_scenes
from tnst_mi.compare.bench.renderers.sides import ANSWER, OURS, PATH_TRACERS, side_of
from tnst_mi.compare.bench.renderers.variants import SPECTRAL_WHITE, variant_of
from tnst_mi.compare.bench.statistics.hypotheses import DIFFERENCED, DIFFERENTIATED
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole


def measured(path: Path, integrator: str, parameters: tuple[str, ...], spp: int) -> dict[str, Any]:
    """The radiance and its derivatives, each with its standard error."""
    sides = (side_of("left", integrator), side_of("right", ANSWER))
    # Integrators share no random numbers, so that they agree or not independently of each other.
    settings = BenchSettings(*sides, (), 0, 0, parameters, 1e-3, zlib.crc32(integrator.encode())).with_paths(spp)
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


def in_variants() -> list[str]:
    """Every integrator in every variant that works here, as sides of comparisons."""
    own, found = mi.variant(), []
    for variant in mi.variants():
        for integrator in (OURS, *PATH_TRACERS):
            text = f"{integrator}@{variant}"
            try:
                variant_of(side_of("left", text), False)
            except InputError:
                continue
            if variant != own:
                found.append(text)
    return found


def variants_markdown(records: dict[str, dict[str, Any]], integrators: list[str]) -> str:
    """A line for each integrator and variant: how far it is from each answer."""
    scenes = known_scenes()
    lines = [f"| variant | integrator | {' | '.join(path.stem for path in scenes)} |", "|---" * (2 + len(scenes)) + "|"]
    for text in integrators:
        integrator, _, variant = text.partition("@")
        white = SPECTRAL_WHITE if "spectral" in variant else 1.0
        cells = [
            _cell(records.get(f"{path.stem} {text}", {}).get("radiance"), white * answer.radiance)
            for path, answer in scenes.items()
        ]
        lines.append(f"| {variant} | {integrator} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="names of scenes; all by default")
    parser.add_argument("--spp", type=int, default=1 << 20)
    parser.add_argument("--out", type=Path, default=Path("known.json"))
    parser.add_argument("--variants", action="store_true", help="the radiance in every variant that works here")
    arguments = parser.parse_args()
    tnst_mi.activate()
    records = json.loads(arguments.out.read_text("utf-8")) if arguments.out.is_file() else {}
    integrators = in_variants() if arguments.variants else [OURS, *PATH_TRACERS]
    for path, answer in known_scenes().items():
        parameters = () if arguments.variants else tuple(answer.derivatives)
        for integrator in integrators:
            key = f"{path.stem} {integrator}"
            chosen = not arguments.scenes or path.stem in arguments.scenes
            ours = integrator.startswith(OURS)
            if chosen and key not in records and not (answer.scatters and ours):
                # Ours is the same for every ray of these scenes, but for wavelengths.
                spp = 32 if ours and "spectral" not in integrator else arguments.spp
                print(f"{key}, {spp} paths", file=sys.stderr, flush=True)
                records[key] = measured(path, integrator, parameters, spp)
                with written_whole(arguments.out) as temporary:
                    temporary.write_text(json.dumps(records, indent=1) + "\n", "utf-8")
    print(variants_markdown(records, integrators) if arguments.variants else markdown(records))


if __name__ == "__main__":
    main()
