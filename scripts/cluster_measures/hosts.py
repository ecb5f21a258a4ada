"""Network namespaces as hosts: each has an address, a name and mounts of its own, and a bridge connects them."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

#: The network of the bridge; this machine is number 1.
_NETWORK = "10.213.77."


class NoHostsError(Exception):
    """There can be no namespaces here; the message says why."""


@dataclass(frozen=True)
class Host:
    """A host.

    Attributes:
        name: of the host.
        address: of it.
        within: the beginning of a command that is carried out there.
    """

    name: str
    address: str
    within: tuple[str, ...]


@dataclass(frozen=True)
class Network:
    """Hosts that reach each other.

    Attributes:
        address: of this machine.
        hosts: the others.
    """

    address: str
    hosts: list[Host]

    def traffic(self) -> int:
        """Bytes that the hosts have sent and received so far."""
        folders = [Path("/sys/class/net") / host.name / "statistics" for host in self.hosts]
        return sum(int((folder / f"{way}_bytes").read_text()) for folder in folders for way in ("rx", "tx"))


@contextlib.contextmanager
def hosts(count: int) -> Iterator[Network]:
    """So many hosts, removed in the end; what runs there must have ended.

    Raises:
        NoHostsError: without the rights, or the program.
    """
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        raise NoHostsError("network namespaces need root")
    for program in ("ip", "unshare"):
        if shutil.which(program) is None:
            raise NoHostsError(f"there is no program {program} (packages iproute2 and util-linux)")
    # Names of interfaces have at most 15 characters.
    bridge = f"tnst{os.getpid() % 10**6}"
    made: list[Host] = []
    try:
        _ip("link", "add", bridge, "type", "bridge")
        _ip("address", "add", f"{_NETWORK}1/24", "dev", bridge)
        _ip("link", "set", bridge, "up")
        for number in range(count):
            host = _host(f"{bridge}h{number}", f"{_NETWORK}{10 + number}")
            made.append(host)
            _ip("netns", "add", host.name)
            _ip("link", "add", host.name, "type", "veth", "peer", "name", "eth0", "netns", host.name)
            _ip("link", "set", host.name, "master", bridge, "up")
            _ip("-n", host.name, "address", "add", f"{host.address}/24", "dev", "eth0")
            for interface in ("lo", "eth0"):
                _ip("-n", host.name, "link", "set", interface, "up")
        yield Network(f"{_NETWORK}1", made)
    except subprocess.CalledProcessError as error:
        raise NoHostsError(f"{' '.join(error.cmd)}: {error.stderr.strip()}") from None
    finally:
        # A namespace takes its interfaces along, but not at once.
        links = [("link", "delete", name) for name in (*(host.name for host in made), bridge)]
        for command in (*links, *(("netns", "delete", host.name) for host in made)):
            with contextlib.suppress(subprocess.CalledProcessError):
                _ip(*command)


def _host(name: str, address: str) -> Host:
    named = ("unshare", "--uts", "sh", "-c", 'hostname "$0" && exec "$@"', name)
    return Host(name, address, ("ip", "netns", "exec", name, *named))


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)
