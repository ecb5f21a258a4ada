"""Keys and flags by other names: what is meant by a name that is not known."""

from __future__ import annotations

import difflib
from collections.abc import Collection

#: By a known key or flag, without dashes, the names under which people look for it.
_OTHER_NAMES: dict[str, str] = {
    "input": "file files in i source src path in_dir input_dir input_file input_folder smoke_file",
    "files": "file input in i source src path folder input_file input_folder",
    "output": "out output_dir outdir out_dir dest destination output_file target o",
    "camera": "shot shot_camera camera_file camera_path usd",
    "azimuth": "camera_angle angle angles view_angle rotation yaw orbit",
    "elevation": "pitch tilt camera_height",
    "views": "cameras num_views n_views view viewpoints",
    "strength": "amount intensity effect influence",
    "reach": "max_displacement largest_displacement displacement max_velocity limit",
    "keep_silhouette": "silhouette outline keep_outline keep_shape",
    "motif_size": "motif pattern_size feature_size motif_scale style_scale",
    "eta": "learning_rate lr step_size stepsize rate",
    "gamma": "extinction absorption thickness opacity transmit density_factor sigma_t",
    "lam": "lambda lamda divergence_free",
    "style": "style_image image picture texture style_img style_picture",
    "content": "content_image content_picture",
    "style_layers": "layers style_layer",
    "semantic": "channel channels neuron feature semantic_layer",
    "tag": "class label prompt text category class_name",
    "octaves": "levels scales resolutions multiscale",
    "scale_factor": "octave_scale octave_factor",
    "iterations": "iters iter num_iterations n_iter epochs passes max_iter num_steps",
    "window": "temporal smoothing coherence_window window_size temporal_window",
    "weights": "network model net checkpoint pretrained model_path",
    "variant": "device gpu cuda cpu backend",
    "frames": "range frame start end first last frame_range from to",
    "fps": "framerate frame_rate",
    "recipe": "config configuration settings params parameters toml",
    "out": "output output_dir outdir out_dir dest destination folder o",
    "overwrite": "force replace clobber yes",
    "resume": "continue restart",
    "debug": "verbose traceback",
    "seed": "random_seed random_state",
    "blend": "mix opacity_mix amount_of_style",
    "density_scale": "density_multiplier scale_density multiply",
    "dt": "timestep time_step delta_t",
    "up": "up_axis axis z_up y_up",
    "flip": "mirror",
    "voxel_size": "cell_size dx spacing",
    "units": "velocity_units velocity_unit",
    "format": "type extension ext file_format output_format",
    "spp": "samples samples_per_pixel",
    "resolution": "size width height image_size",
    "turntable": "spin video turn",
    "steps": "substeps sub_steps",
    "download": "get fetch",
}

#: How alike two spellings must be, from 0 to 1: below it, a guess would mislead more often than help.
_LIKENESS = 0.7

_BY_OTHER_NAME: dict[str, list[str]] = {}
for _name, _others in _OTHER_NAMES.items():
    for _other in _others.split():
        _BY_OTHER_NAME.setdefault(_other, []).append(_name)

_QUICK = "a single octave gives a quick preview (octaves = 1, --octaves 1)"

#: What people look for that is no key by itself.
_ADVICE = {
    "preview": _QUICK,
    "draft": _QUICK,
    "quick": _QUICK,
    "fast": _QUICK,
    "low_res": _QUICK,
    "quality": "octaves and iterations decide the quality",
}


def meant(name: str, known: Collection[str]) -> str | None:
    """The known name that an unknown one probably means: by meaning, else by spelling; None if there is none.

    Args:
        name: a key or a flag; dashes inside count as underscores.
        known: the names to choose from.

    Example:
        >>> meant("--angle", ["azimuth", "gamma"]), meant("gama", ["azimuth", "gamma"]), meant("bogus", ["fog"])
        ('azimuth', 'gamma', None)
    """
    plain = _plain(name)
    if plain in known:
        return plain
    if plain in _BY_OTHER_NAME or plain in _ADVICE:
        return next((other for other in _BY_OTHER_NAME.get(plain, ()) if other in known), None)
    nearest = difflib.get_close_matches(plain, known, n=1, cutoff=_LIKENESS)
    return nearest[0] if nearest else None


def advice(name: str, known: Collection[str]) -> str | None:
    """What does what an unknown name asks for, where no single known name does; None if nothing is known."""
    return _ADVICE.get(_plain(name)) if "octaves" in known else None


def _plain(name: str) -> str:
    return name.lower().replace("-", "_").lstrip("_")
