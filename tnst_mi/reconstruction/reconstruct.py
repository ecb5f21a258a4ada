"""`tnst_mi.reconstruct`: pictures and cameras in, densities out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.formats import FORMATS
from tnst_mi.machine.backend import activate, own_variant
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.interrupt import deferred_interrupt
from tnst_mi.machine.lock import locked
from tnst_mi.reconstruction.frame_by_frame import FrameByFrame
from tnst_mi.reconstruction.output.report import remarks_of_frames
from tnst_mi.reconstruction.preparation import ESTIMATE, prepare
from tnst_mi.reconstruction.resuming.earlier import remove_earlier
from tnst_mi.reconstruction.resuming.state import ReconstructionState
from tnst_mi.resources import expanded


@dataclass(frozen=True)
class Reconstruction:
    """What a reconstruction has come to.

    Attributes:
        densities: the files of the densities, frame by frame.
        records: of each frame, what is known of it: held-out views and their PSNR, brightness, noise, mass, seconds.
        remarks: what was assumed.
        interrupted: it was ended early; it can go on. The last density is then as far as it got.

    Example:
        >>> import pathlib, tnst_mi
        >>> found = tnst_mi.Reconstruction((pathlib.Path("out/density/smoke.npz"),), ({"psnr": 41.5},), (), False)
        >>> f"{found.records[0]['psnr']:.1f} dB"
        '41.5 dB'
    """

    densities: tuple[Path, ...]
    records: tuple[Mapping[str, Any], ...]
    remarks: tuple[str, ...]
    interrupted: bool


def reconstruct(
    cameras: str | Path,
    out: str | Path,
    settings: Mapping[str, Any] | None = None,
    *,
    frames: str | None = None,
    velocities: str | Path = ESTIMATE,
    format: str = "npz",
    resume: bool = False,
    overwrite: bool = False,
    progress: bool = True,
) -> Reconstruction:
    """Find the density whose renderings are the pictures that cameras with known places took.

    Grids go from coarse to fine. On each, Adam lowers the difference between views of the smoke and their pictures,
    with derivatives by the adjoint of the renderer (docs/reconstruction.md). The same call gives the same bits on the
    same machine, also if it was stopped and resumed; with prbvolpath nearly the same, since Mitsuba adds up what paths
    find in an order that changes.

    Args:
        cameras: our TOML, a NeRF's `transforms.json`, or a Mitsuba scene with sensors.
        out: folder for the results.
        settings: keys of `ReconstructionSettings`, which win over those of the file; `box` is needed.
        frames: "FIRST:LAST", numbers of the frames of a sequence, in whose place pictures have ####.
        velocities: what moves each frame to the next one, which starts from there, and is written beside its density:
            "estimate", found from the pictures of both; a folder of frames with the velocity of the simulation on the
            same grid; or "none", so that it starts from the one before as it is.
        format: of the densities: npz, vol, uni or vdb, of which vdb keeps their place in the scene.
        resume: go on where an earlier call stopped.
        overwrite: write into a folder that is not empty, and remove the frames of a reconstruction from there.
        progress: show a progress bar on stderr.

    Raises:
        InputError: something cannot be used.
        OSError: something cannot be written.

    Example:
        >>> import pathlib, tempfile
        >>> import numpy as np
        >>> import tnst_mi
        >>> density = np.zeros((8, 8, 8), np.float32)
        >>> density[2:6, 3:7, 2:5] = 1
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     folder = pathlib.Path(folder)
        ...     text = "up_axis = 'y'\\nheight = 12\\n"
        ...     for azimuth in (0, 45, 90, 135):
        ...         image = tnst_mi.render(density, view=(azimuth, 0), quadrature="exact", size=(12, 12))
        ...         tnst_mi.io.pictures.exr.write_exr(folder / f"{azimuth}.exr", image, {})
        ...         x, z = 20 * np.sin(np.radians(azimuth)), 20 * np.cos(np.radians(azimuth))
        ...         text += f"[views.at{azimuth}]\\nimage = '{azimuth}.exr'\\n"
        ...         text += f"position = [{x}, 0, {z}]\\ntarget = [0, 0, 0]\\n"
        ...     _ = (folder / "cameras.toml").write_text(text)
        ...     keys = {"box": [-4, -4, -4, 4, 4, 4], "cells": 8, "iterations": 60, "levels": 1}
        ...     found = tnst_mi.reconstruct(folder / "cameras.toml", folder / "out", keys, progress=False)
        ...     result = np.load(found.densities[0])["density"]
        >>> bool(np.abs(result - density).mean() < 0.02)
        True
    """
    out, cameras = expanded(Path(out)), expanded(Path(cameras))
    if f".{format}" not in FORMATS:
        raise InputError(f"format = {format!r}: expected one of {', '.join(name[1:] for name in FORMATS)}")
    if resume and overwrite:
        raise InputError("resume and overwrite: expected only one of them")
    if not resume:
        require_writable(
            out, remedy=None if overwrite else "give another folder, go on there with --resume, or --overwrite"
        )
    with own_variant():
        activate()
        prepared = prepare(cameras, settings or {}, frames, velocities, format)
        state = out / "state.safetensors"
        before = ReconstructionState.read(state, prepared) if resume else ReconstructionState(prepared.identity)
        prepared.require_pictures()
        out.mkdir(parents=True, exist_ok=True)
        with locked(out), deferred_interrupt() as interrupt:
            if not resume:
                remove_earlier(out, state)
            run = FrameByFrame(prepared, out, state, before, progress)
            run.go_on(interrupt)
        records = (*run.progress.records, *run.unfinished)
        files = tuple(out / record["density"] for record in records)
        remarks = (*prepared.remarks, *remarks_of_frames(records))
        return Reconstruction(files, records, remarks, run.interrupted)
