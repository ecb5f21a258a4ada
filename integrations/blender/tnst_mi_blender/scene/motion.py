"""Whether what is in the scene may change from frame to frame: going through frames takes long in heavy scenes."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

#: Constraints that do the same in all frames if their target does; with bones and vertices as targets, it is not asked.
_OF_TARGETS = frozenset(
    "COPY_LOCATION COPY_ROTATION COPY_SCALE COPY_TRANSFORMS CHILD_OF DAMPED_TRACK LOCKED_TRACK TRACK_TO".split()
)

#: Constraints that do the same in all frames.
_ALONE = frozenset("LIMIT_LOCATION LIMIT_ROTATION LIMIT_SCALE MAINTAIN_VOLUME".split())


def may_move(items: Iterable[bpy.types.Object], scene: bpy.types.Scene) -> bool:
    """Whether the place of objects, or what they are, may differ between frames.

    Only what is known not to change is taken as still: no keyframes, strips or drivers of the objects, their data, the
    scene, or anything that they are attached to; no physics; and no script that is called in each frame.
    """
    handlers = bpy.app.handlers
    if handlers.frame_change_pre or handlers.frame_change_post or _is_animated(scene):
        return True
    seen: set[bpy.types.Object] = set()
    return any(_may_move(item, seen) for item in items)


def may_change_shape(item: bpy.types.Object) -> bool:
    """Whether the mesh of an object that stays where it is may differ between frames."""
    return len(item.modifiers) > 0 or (item.data is not None and item.data.shape_keys is not None)


def _may_move(item: bpy.types.Object, seen: set[bpy.types.Object]) -> bool:
    if item in seen:
        return False
    seen.add(item)
    if _is_animated(item) or _is_animated(item.data) or item.rigid_body is not None:
        return True
    attached = []
    if item.parent is not None:
        if item.parent_type != "OBJECT":
            return True
        attached.append(item.parent)
    for constraint in item.constraints:
        if constraint.mute:
            continue
        if constraint.space_object is not None:
            attached.append(constraint.space_object)
        if constraint.type in _ALONE:
            continue
        if constraint.type not in _OF_TARGETS or constraint.subtarget:
            return True
        if constraint.target is not None:
            attached.append(constraint.target)
    return any(_may_move(other, seen) for other in attached)


def _is_animated(owner: bpy.types.ID | None) -> bool:
    animation = None if owner is None else owner.animation_data
    if animation is None:
        return False
    # When an object is hidden does not matter.
    drivers = any(not driver.data_path.startswith("hide_") for driver in animation.drivers)
    return drivers or animation.action is not None or len(animation.nla_tracks) > 0
