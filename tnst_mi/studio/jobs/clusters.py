"""The cluster on which the page renders: the addresses of `stylize --cluster`, checked as soon as they are typed."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.run.cluster_address import BATCH, cluster_of, require_reachable
from tnst_mi.studio.places import Places

#: Characters of an address, at most.
_LONGEST = 500


def checked_address(text: str, places: Places | None) -> str | None:
    """The address of a cluster, with the absolute path of its file if it has one; None for no cluster.

    Args:
        text: as it was typed; empty for no cluster.
        places: below which a file has to be; None if it may be anywhere.

    Raises:
        InputError: it means none, its file is not below the started folder, or no scheduler answers there.
    """
    address = text.strip()
    if not address:
        return None
    if len(address) > _LONGEST:
        raise InputError(f"--cluster: {len(address)} characters, expected at most {_LONGEST}")
    kind, _, file = address.partition(":")
    if kind in BATCH and file:
        path = Path(file).expanduser().absolute() if places is None else places.within(file)
        address = f"{kind}:{path}"
    try:
        require_reachable(cluster_of(address))
    except InputError as error:
        raise InputError(one_line(str(error))) from None
    return address
