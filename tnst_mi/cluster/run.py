"""A run whose tasks are carried out by the processes of a cluster: it says which are due, and keeps the books."""

from __future__ import annotations

import pickle
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tnst_mi.cluster.connecting import connected, lacking_workers
from tnst_mi.cluster.crew import Crew
from tnst_mi.cluster.member import Order
from tnst_mi.cluster.parcels import Parcel
from tnst_mi.cluster.progression import Progression
from tnst_mi.cluster.tasks import Task, Workplace
from tnst_mi.machine.interrupt import deferred_interrupt
from tnst_mi.machine.lock import LOCK
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.interface import Store
from tnst_mi.optimisation.items.store import FolderStore
from tnst_mi.run.cluster_address import Cluster
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.job import FinishedFrame, Run
from tnst_mi.run.live_pictures import LivePictures
from tnst_mi.run.prepare import Prepared
from tnst_mi.run.record import run_identity


class ClusterRun(Run):
    """A run on a cluster; iterated over like one in this process, with the same results.

    Args:
        prepared: the run, from `prepare`; it has a folder.
        cluster: that carries it out.
        progress: show a progress bar on stderr.
    """

    def __init__(self, prepared: Prepared, cluster: Cluster, progress: bool = True) -> None:
        super().__init__(prepared, progress)
        self._cluster = cluster

    def _computed(
        self, folder: RunFolder | None, store: Store, live: LivePictures | None, done: Sequence[int]
    ) -> Generator[FinishedFrame, None, None]:
        assert folder is not None and isinstance(store, FolderStore)
        store.share()
        prepared, plan = self.prepared, self.prepared.plan
        with deferred_interrupt() as interrupt, connected(self._cluster, self._bar.say, len(plan.alive)) as client:
            network, shared = prepared.network.model, self._cluster.shared

            def pack(task: Task) -> list[Parcel]:
                return progression.pack(task)

            def home(items: DeviceStore) -> Workplace:
                return Workplace(prepared.work, network, items, folder)

            lacking = lacking_workers(self._cluster)
            crew = Crew(client, self._order(folder), plan, self._bar.say, lacking, None if shared else pack)
            progression = Progression(
                plan, store, network, crew, interrupt, self._bar.advance, None if shared else home
            )
            try:
                for index, record, history in progression.results(done, self._octave_done):
                    if live is not None:
                        live.frame_done(prepared.names[index])
                    yield FinishedFrame(record, history)
            except KeyboardInterrupt:
                self._interrupted = True
            finally:
                crew.close()
                self.record["cluster"] = [*self.record.get("cluster", ()), crew.shares.record(self._cluster.address)]

    def _order(self, folder: RunFolder) -> bytes:
        """What the processes of the cluster are told, pickled."""
        prepared, record = self.prepared, self.record
        work, plan = prepared.work, prepared.plan
        if plan.start is not None:
            # Where its fields come from is read here.
            work = replace(work, plan=replace(plan, start=replace(plan.start, fields=_fields_elsewhere)))
        return pickle.dumps(
            Order(
                work,
                run_identity(prepared.recipe, record),
                (folder.out / LOCK).read_bytes(),
                str(record["weights"]["file"]),
                record["weights"]["sha256"],
                record["device"]["variant"],
                record["threads"],
                self._cluster.shared,
            )
        )


def _fields_elsewhere(name: str) -> Mapping[str, np.ndarray]:
    raise AssertionError(f"{name}: its fields are read by the process that has begun the run")
