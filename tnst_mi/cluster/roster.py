"""Which processes of a cluster take part in a run: who comes is asked to join, and may be refused.

A process joins before its first task. It is refused, once and for this run, if it would come to other bits or to none.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from distributed import Client, Future, fire_and_forget, wait

from tnst_mi.cluster import member
from tnst_mi.cluster.blame import MOST_DEATHS
from tnst_mi.cluster.member import RefusedError
from tnst_mi.cluster.shares import Shares
from tnst_mi.errors import InputError, StoppedError

#: Seconds between two looks at which processes are there, after which it is said that there are none, in which the
#: scheduler has to say who is there, and in which those that leave have to end the task that they are at.
_LOOK, _PATIENCE, _ANSWERS, _LEAVING = 1.0, 10.0, 2.0, 60.0


class Roster:
    """The processes that take part in a run.

    Args:
        client: of the cluster.
        run: names the run in the cluster.
        order: what the processes are told of it, pickled.
        shares: of what each has done.
        say: how to say something to the user.
        lacking: what to say when there are none, where others may come; None if none will.

    Attributes:
        members: addresses of those that may do tasks, in the order of their coming.
        refused: why others may not, by their addresses.
    """

    def __init__(
        self,
        client: Client,
        run: str,
        order: bytes,
        shares: Shares,
        say: Callable[[str], None],
        lacking: str | None,
    ) -> None:
        self._client, self._run, self._order, self._shares = client, run, order, shares
        self._say, self._lacking = say, lacking
        self.members: list[str] = []
        self.refused: dict[str, str] = {}
        #: Those that have been asked to join, the host of each, and how many have ended there before they had.
        self._joining: dict[str, Future] = {}
        self._hosts: dict[str, str] = {}
        self._stillborn: Counter[str] = Counter()
        self._looked, self._alone_since, self._silent = 0.0, time.monotonic(), False

    def look(self) -> list[str]:
        """Note who has joined and who has left, and ask those that are new to join; returns members that have left.

        Raises:
            InputError: nobody may take part.
            StoppedError: nobody is left, or the cluster is gone.
        """
        for address, future in list(self._joining.items()):
            if future.done():
                del self._joining[address]
                self._joined(address, future)
        if time.monotonic() - self._looked < _LOOK:
            return []
        self._looked = time.monotonic()
        there = self._there()
        if there is None:
            return []
        left = [address for address in self.members if address not in there]
        for address in left:
            self.missed(address)
        for address in [address for address in self._joining if address not in there]:
            self._joining.pop(address).cancel()
            self._died_joining(address)
        for address, about in there.items():
            known = address in self.members or address in self._joining or address in self.refused
            if not known and self._stillborn[about["host"]] < MOST_DEATHS:
                self._ask(address, about, [other["host"] for other in there.values()])
        self._require_somebody()
        return left

    def refuse(self, address: str, reason: str) -> None:
        """Say why a process cannot take part, once, and do without it."""
        if address not in self.refused:
            self.refused[address] = reason
            self._say(f"worker {address}: refused: {reason}")
            if address in self.members:
                self.members.remove(address)

    def missed(self, address: str) -> None:
        """A member is gone; another process may have its address."""
        if address in self.members:
            self.members.remove(address)
            self._shares.left(address)
            self._say(f"worker {address} has left; there are {len(self.members)}")
        self._looked = 0.0

    def dismiss(self, patient: bool) -> None:
        """Let all forget the run; if patient, wait until they are at none of its tasks, unless they are frozen."""
        leaving = []
        for address in self.members:
            key = f"leave-{self._run}-{address}"
            leaving.append(self._client.submit(member.leave, self._run, key=key, workers=[address], pure=False))
        if patient and leaving:
            try:
                wait(leaving, timeout=_LEAVING)
            except TimeoutError:
                self._say("some workers do not answer; going on without them")
        fire_and_forget(leaving)

    # ---------------------------------------------------------------- joining

    def _there(self) -> dict[str, dict[str, Any]] | None:
        """The processes of the cluster, by their addresses; None if the scheduler does not answer now."""
        if self._client.status != "running":
            raise gone(self._client)
        scheduler: Any = self._client.scheduler
        try:
            found: Any = self._client.sync(scheduler.identity, n_workers=-1, callback_timeout=_ANSWERS)
        except OSError:  # as one that it is too late for
            if self._client.status != "running":
                raise gone(self._client) from None
            if not self._silent:
                self._say("the scheduler does not answer: waiting for it (Ctrl-C ends the run, --resume goes on)")
            self._silent = True
            return None
        self._silent = False
        return found["workers"]

    def _ask(self, address: str, about: dict[str, Any], hosts: list[str]) -> None:
        self._shares.came(address, str(about["name"]), str(about["host"]))
        self._hosts[address] = about["host"]
        self._joining[address] = self._client.submit(
            member.join,
            self._run,
            hosts.count(about["host"]),
            member.decisive_versions(),
            self._order,
            key=f"join-{self._run}-{address}-{time.monotonic_ns()}",
            workers=[address],
            priority=1,
            pure=False,
        )

    def _joined(self, address: str, future: Future) -> None:
        if future.status == "finished":
            self.members.append(address)
            self._stillborn.pop(self._hosts[address], None)
            return
        error = error_of(future)
        if error is not None:
            self.refuse(address, str(error) if isinstance(error, RefusedError) else f"{type(error).__name__}: {error}")

    def _died_joining(self, address: str) -> None:
        host = self._hosts[address]
        self._stillborn[host] += 1
        self._say(f"worker {address} has ended while it joined; see what it has written on stderr")
        if self._stillborn[host] >= MOST_DEATHS:
            self._say(f"{host}: no more workers there are asked, since {MOST_DEATHS} in turn have ended so")

    def _require_somebody(self) -> None:
        """Say that there is nobody to do the tasks; without hope, end the run."""
        if self.members or self._joining:
            self._alone_since = time.monotonic()
        elif time.monotonic() - self._alone_since > _PATIENCE:
            if self._lacking is None:
                reasons = "; ".join(dict.fromkeys(self.refused.values()))
                if reasons:
                    raise InputError(f"no worker can take part: {reasons}")
                raise StoppedError("all workers have ended; see what they have written, and go on with --resume")
            self._say(self._lacking)
            self._alone_since = float("inf")


def error_of(future: Future) -> BaseException | None:
    """What a task raised; None if it was not done, since the scheduler is gone."""
    error: Any = future.exception() if future.status == "error" else None
    return error


def gone(client: Client) -> StoppedError:
    """The error that the scheduler is gone."""
    address = client.scheduler.address if client.scheduler is not None else "the scheduler"
    return StoppedError(f"{address}: the scheduler is gone; start it again, and go on with --resume, nothing is lost")
