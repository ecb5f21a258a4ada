"""Export the camera of a Blender scene as a file of cameras that recipes and commands take (`camera = "shot.json"`).

    python scripts/export_camera.py scene.blend --out shot.json [--camera NAME] [--frames A:B] [--relative-to DOMAIN]
    blender --background scene.blend --python scripts/export_camera.py -- --out shot.json

Of every frame, that is the scene's active camera, also where markers change it, or the one of a name: where it stands,
perspective or orthographic, its field of view as the sensor's fit and the resolution make it, its aspect with that of
the pixels, its shift. Lens effects are left out. Frames are those of the scene unless --frames says otherwise.

A fluid's cache lies along the axes of its domain object, whatever the object's rotation. --relative-to DOMAIN writes
the camera in that object's axes and from its origin, for frames read with the --origin that `tnst-mi info` names.

Started by Python, it starts Blender (`apt-get install blender`, or --blender PROGRAM). Exit codes: 0 done, 1 Blender
failed, 2 bad input.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

try:
    import bpy
    import mathutils
except ImportError:
    bpy = mathutils = None

#: Precision of what is written: numbers of a scene have no more.
DIGITS = 9

#: What the volume of a camera's three axes may lack of 1, where a scale that is not even makes them oblique.
UNEVEN = 1e-6


class UnusableCameraError(Exception):
    """A camera that cannot be exported; the message is one line with the remedy."""


def refuse(message: str) -> NoReturn:
    """End with a line that says what cannot be used, and exit code 2."""
    print(f"export_camera.py: {message}", file=sys.stderr, flush=True)
    raise SystemExit(2)


def object_named(flag: str, name: str) -> bpy.types.Object:
    """An object of the scene by its name."""
    if name not in bpy.data.objects:
        refuse(f"{flag} {name}: no such object, the scene has {', '.join(bpy.data.objects.keys()[:10])}")
    return bpy.data.objects[name]


def frames_of(text: str | None) -> range:
    """The frames that A:B means, both included; those of the scene without it."""
    scene = bpy.context.scene
    if text is None:
        return range(scene.frame_start, scene.frame_end + 1)
    match = re.fullmatch(r"(-?\d{1,6})(?::(-?\d{1,6}))?", text)
    first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
    if first > last:
        refuse(f"--frames {text}: expected a first and a last frame, such as 1:120")
    return range(first, last + 1)


def camera_at(frame: int, name: str | None, domain: bpy.types.Object | None) -> dict[str, Any]:
    """The table of the camera at a frame, in the axes of a domain if there is one."""
    scene = bpy.context.scene
    scene.frame_set(frame)
    camera = scene.camera if name is None else object_named("--camera", name)
    if camera is None:
        refuse(f"frame {frame}: the scene has no active camera; name one with --camera")
    graph = bpy.context.evaluated_depsgraph_get()
    space = None if domain is None else domain.evaluated_get(graph).matrix_world.normalized()
    try:
        return camera_table(camera, scene, graph, space)
    except UnusableCameraError as error:
        refuse(str(error))


def camera_table(
    camera: bpy.types.Object, scene: bpy.types.Scene, graph: bpy.types.Depsgraph, space: mathutils.Matrix | None
) -> dict[str, Any]:
    """The table of a camera as it is in the scene's current frame.

    Args:
        camera: the object.
        scene: whose pictures it takes.
        graph: the evaluated scene.
        space: from the space in which the camera is written to the world, of one scale along all axes; None for the
            world.

    Raises:
        UnusableCameraError: it is of a kind that files of cameras do not have, or an uneven scale distorts it.
    """
    if camera.type != "CAMERA":
        raise UnusableCameraError(f"{camera.name}: is no camera, but {camera.type.lower()}")
    if camera.data.type not in ("PERSP", "ORTHO"):
        raise UnusableCameraError(
            f"{camera.name}: is {camera.data.type.lower()}, expected a perspective or an orthographic camera"
        )
    evaluated = camera.evaluated_get(graph)
    # Cameras see the same whatever scale they inherit, as long as it is the same along all axes.
    matrix, scale = evaluated.matrix_world.normalized(), 1.0
    require_even(camera.name, matrix)
    if space is not None:
        matrix, scale = (space.inverted() @ matrix).normalized(), abs(space.to_3x3().determinant()) ** (1 / 3)
        require_even(camera.name, matrix)
    # The corners of the picture in the camera's own space: sensor fit, resolution, pixel aspect and shift are in them.
    corners = evaluated.data.view_frame(scene=scene)
    across, above = [corner.x for corner in corners], [corner.y for corner in corners]
    left, right, bottom, top = min(across), max(across), min(above), max(above)
    width, height = right - left, top - bottom
    table: dict[str, Any] = {"matrix": [[round(value, DIGITS) for value in row] for row in matrix]}
    if camera.data.type == "PERSP":
        table["fov"] = round(math.degrees(2 * math.atan(height / (2 * -corners[0].z))), DIGITS)
    else:
        table["height"] = round(height / scale, DIGITS)
    table["aspect"] = round(width / height, DIGITS)
    # Where the axis meets the picture, from its middle.
    table["shift"] = [round(-(low + high) / (2 * height), DIGITS) for low, high in ((left, right), (bottom, top))]
    return table


def require_even(name: str, matrix: mathutils.Matrix) -> None:
    """Require that the axes of a camera are those of a rotation.

    Raises:
        UnusableCameraError: they are not.
    """
    axes = [matrix.col[i].to_3d() for i in range(3)]
    if axes[0].cross(axes[1]).dot(axes[2]) < 1 - UNEVEN:
        raise UnusableCameraError(
            f"{name}: is mirrored, or scaled unevenly by what it is attached to; apply that scale in Blender"
        )


def cameras_of(tables: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The content of a file of cameras from the tables of frames: one for all of them where these are the same."""
    first, *others = tables.values()
    return {"up_axis": "z"} | (first if all(table == first for table in others) else {"frames": tables})


def export(given: argparse.Namespace) -> None:
    """Write the cameras of all frames, or the one that all of them have."""
    domain = None if given.relative_to is None else object_named("--relative-to", given.relative_to)
    tables = {str(frame): camera_at(frame, given.camera, domain) for frame in frames_of(given.frames)}
    cameras = cameras_of(tables)
    try:
        given.out.write_text(json.dumps(cameras, indent=1) + "\n", "utf-8")
    except OSError as error:
        refuse(f"{given.out}: cannot be written ({error.strerror}); give another --out")
    print(f"cameras   {given.out}: {'one for all frames' if 'frames' not in cameras else f'{len(tables)} frames'}")


def main() -> int:
    """Read the arguments, those after `--` in Blender, and export here or in Blender."""
    parser = argparse.ArgumentParser(
        prog="export_camera.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", nargs="?", type=Path, metavar="SCENE.blend", help="a scene; in Blender, the open one")
    parser.add_argument("--out", type=Path, required=True, metavar="SHOT.json", help="the file of cameras to write")
    parser.add_argument("--camera", metavar="NAME", help="the camera (default: the active one of each frame)")
    parser.add_argument("--frames", metavar="A:B", help="first and last frame (default: those of the scene)")
    parser.add_argument("--relative-to", metavar="DOMAIN", help="object in whose axes the cameras are written")
    parser.add_argument("--blender", default="blender", help="the program (default: the one on the path)")
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    given = parser.parse_args(arguments)
    if bpy is not None:
        export(given)
        return 0
    if given.scene is None or not given.scene.is_file():
        refuse(f"{given.scene or 'SCENE.blend'}: no such file, expected a scene of Blender")
    if shutil.which(given.blender) is None:
        refuse(f"no program {given.blender}: install Blender (apt-get install blender), or name it with --blender")
    # Scenes may be anybody's: what they would run on being opened is not run.
    command = [given.blender, "--background", "--factory-startup", "--disable-autoexec", str(given.scene)]
    command += ["--python-exit-code", "1", "--python", str(Path(__file__).resolve()), "--", *arguments]
    ran = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    own = [line for line in ran.stdout.splitlines() if line.startswith("cameras   ")]
    said = [line for line in ran.stderr.splitlines() if line.startswith("export_camera.py: ")]
    if ran.returncode == 0 and own:
        print(own[0])
        return 0
    print(said[0] if said else f"export_camera.py: Blender failed: {ran.stderr[-500:]}", file=sys.stderr)
    return 2 if said else 1


if __name__ == "__main__":
    # Blender goes on after a script, unless that ends it.
    sys.exit(main())
