"""The items of a store as tensors on the device: kept there as long as they fit, and written behind the work.

With a window, the step and the velocity of a frame are needed by all 2w + 1 frames in whose windows it is. Kept on the
device, in the precision in which they are stored, each is read once or not at all. What is written goes to the
store in a thread, in the order of writing, up to the first item that cannot be written: at any moment, the store has
what a run that was killed a little earlier would have left, so that it stays the truth for resuming.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.machine.host_copy import HostCopy
from tnst_mi.optimisation.items.interface import Arrays, Store


class Request(NamedTuple):
    """What to read: group, frame, the names of the arrays, and which generation, None for the newest."""

    group: str
    frame: int
    names: Collection[str]
    generation: int | None = None


#: An array of an item: group, frame, generation, name.
_Key = tuple[str, int, int, str]

#: Tensors by name.
_Tensors = dict[str, "mi.TensorXf"]

#: Number of items that may wait to be written; their arrays are in host memory.
_WAITING = 2


class DeviceStore:
    """Items on the device, backed by a store.

    Args:
        backing: where the items are written, and read from when they are not on the device.
        budget: bytes of device memory for items; those that have not been used for longest make room, and one that
            is larger is not kept.
    """

    def __init__(self, backing: Store, budget: int) -> None:
        self.backing, self._budget = backing, budget
        self._kept: OrderedDict[_Key, mi.TensorXf | mi.TensorXf16] = OrderedDict()
        self._size = 0
        #: Generations of the items written here, which the store may not have yet.
        self._written: dict[tuple[str, int], int] = {}
        self._writes: deque[tuple[tuple[str, int, int], Future[None]]] = deque()
        #: Why an item could not be written; none is written after it.
        self._failure: BaseException | None = None
        self._writer = ThreadPoolExecutor(1, "item writer")
        self._reader = ThreadPoolExecutor(1, "item reader")

    def generation(self, group: str, frame: int) -> int:
        """The newest generation of an item; −1 if it does not exist."""
        # The store may not have it yet, or have a later one from elsewhere.
        return max(self._written.get((group, frame), -1), self.backing.generation(group, frame))

    def has(self, group: str, frame: int, generation: int) -> bool:
        """Whether an item is there in this generation."""
        return self._written.get((group, frame)) == generation or self.backing.has(group, frame, generation)

    # ---------------------------------------------------------------- reading

    def read(self, group: str, frame: int, names: Collection[str], generation: int | None = None) -> _Tensors:
        """The named tensors of an item, in single precision, of a generation, or of the newest one.

        Raises:
            DamagedItemError: the item is not what was written.
        """
        return next(self.read_each([[Request(group, frame, names, generation)]]))[0]

    def read_each(self, requests: Iterable[Sequence[Request]]) -> Iterator[list[_Tensors]]:
        """The results of one group of requests after the other; what the next ones need is loaded meanwhile."""
        waiting: tuple[Sequence[Request], list[Future[Arrays] | None]] | None = None
        for group in requests:
            group = [self._settled(request) for request in group]
            loading = [
                self._reader.submit(self._load, request) if self._missing(request) else None for request in group
            ]
            if waiting is not None:
                yield self._taken(*waiting)
            waiting = group, loading
        if waiting is not None:
            yield self._taken(*waiting)

    def _settled(self, request: Request) -> Request:
        """A request that says which generation it means."""
        newest = self.generation(request.group, request.frame) if request.generation is None else request.generation
        return request._replace(generation=newest)

    def _missing(self, request: Request) -> list[str]:
        """The names of the arrays that are not on the device."""
        return [name for name in request.names if _key(request, name) not in self._kept]

    def _load(self, request: Request) -> Arrays:
        """The arrays that are not on the device, from the store."""
        return self._stored(request, self._missing(request))

    def _stored(self, request: Request, names: Collection[str]) -> Arrays:
        """Some arrays from the store, once it has what was written."""
        for key, write in list(self._writes):
            if key == (request.group, request.frame, request.generation):
                write.result()
        return self.backing.read(request.group, request.frame, names, request.generation)

    def _taken(self, requests: Sequence[Request], loading: Sequence[Future[Arrays] | None]) -> list[_Tensors]:
        """The requested tensors; those that were not on the device are being loaded."""
        results = []
        for request, future in zip(requests, loading, strict=True):
            loaded = {} if future is None else future.result()
            # Taken before any is kept, since keeping one may make others go.
            tensors = {name: self._kept.get(_key(request, name)) for name in request.names}
            evicted = [name for name, tensor in tensors.items() if tensor is None and name not in loaded]
            if evicted:
                loaded = loaded | self._stored(request, evicted)
            found: _Tensors = {}
            for name, tensor in tensors.items():
                if tensor is None:
                    tensor = _on_device(loaded[name])
                self._keep(_key(request, name), tensor)
                found[name] = mi.TensorXf(tensor)
            self._forget_before(request)
            results.append(found)
        return results

    # ---------------------------------------------------------------- writing

    def write(
        self,
        group: str,
        frame: int,
        generation: int,
        arrays: Mapping[str, mi.TensorXf | mi.TensorXf16],
        durable: bool = False,
    ) -> None:
        """Write an item, replacing its earlier generations.

        Args:
            group, frame, generation, durable: see `Store`.
            arrays: by name, in the precision in which they are to be stored.

        Raises:
            OSError: the store failed to write an earlier item.
        """
        self._forget(lambda key: key[:2] == (group, frame))
        for name, array in arrays.items():
            self._keep((group, frame, generation, name), array)
        host = {name: HostCopy(array.torch()) for name, array in arrays.items()}
        while len(self._writes) >= _WAITING:
            self._finish_oldest()
        write = self._writer.submit(self._write, group, frame, generation, host, durable)
        self._writes.append(((group, frame, generation), write))
        self._written[group, frame] = generation

    def _write(self, group: str, frame: int, generation: int, arrays: Mapping[str, HostCopy], durable: bool) -> None:
        if self._failure is not None:
            # What follows an item must not be there without it.
            raise self._failure
        try:
            on_host = {name: copy.numpy() for name, copy in arrays.items()}
            self.backing.write(group, frame, generation, on_host, durable)
        except BaseException as error:
            self._failure = error
            raise

    def _finish_oldest(self) -> None:
        # Only then is it no longer waited for by those who want to read it.
        self._writes[0][1].result()
        self._writes.popleft()

    def finish(self) -> None:
        """Wait until the store has everything.

        Raises:
            OSError: the store failed to write an item.
        """
        while self._writes:
            self._finish_oldest()

    def discard(self, group: str, frame: int, generation: int | None = None) -> None:
        """Remove an item, or only one generation of it, once the store has everything that was written."""
        self.finish()
        self._forget(lambda key: key[:2] == (group, frame))
        self._written.pop((group, frame), None)
        self.backing.discard(group, frame, generation)

    def clear(self) -> None:
        """Remove all items and numbers, once the store has everything that was written."""
        self.finish()
        self._forget(lambda _: True)
        self._written = {}
        self.backing.clear()

    def remove(self, group: str) -> None:
        """Remove all items of a group, if there are any, once the store has everything that was written."""
        self.finish()
        self._forget(lambda key: key[0] == group)
        self._written = {key: written for key, written in self._written.items() if key[0] != group}
        self.backing.remove(group)

    def close(self) -> None:
        """Give the device memory back, and end the threads once the store has everything."""
        try:
            self.finish()
        finally:
            self._forget(lambda _: True)
            self._writer.shutdown()
            self._reader.shutdown()

    # ---------------------------------------------------------------- what is kept

    def _keep(self, key: _Key, tensor: mi.TensorXf | mi.TensorXf16) -> None:
        """Keep a tensor as the one used last, if it fits at all."""
        if _bytes(tensor) > self._budget:
            return
        if key not in self._kept:
            self._size += _bytes(tensor)
        self._kept[key] = tensor
        self._kept.move_to_end(key)
        while self._size > self._budget:
            self._size -= _bytes(self._kept.popitem(last=False)[1])

    def _forget_before(self, request: Request) -> None:
        """Make room of generations that nobody asks for again, where another process replaces an item: frames of a
        window are at most one iteration apart.
        """
        assert request.generation is not None
        item, oldest = (request.group, request.frame), request.generation - 1
        self._forget(lambda key: key[:2] == item and key[2] < oldest)

    def _forget(self, chosen: Callable[[_Key], bool]) -> None:
        for key in [key for key in self._kept if chosen(key)]:
            self._size -= _bytes(self._kept.pop(key))


def _key(request: Request, name: str) -> _Key:
    """The key of an array of a request that says which generation it means."""
    assert request.generation is not None
    return request.group, request.frame, request.generation, name


def _on_device(array: np.ndarray) -> mi.TensorXf | mi.TensorXf16:
    return mi.TensorXf16(array) if array.dtype == np.float16 else mi.TensorXf(array)


def _bytes(tensor: mi.TensorXf | mi.TensorXf16) -> int:
    """What a tensor takes on the device: Dr.Jit allocates powers of two."""
    size = dr.width(tensor.array) * (2 if isinstance(tensor, mi.TensorXf16) else 4)
    return 1 << (size - 1).bit_length()
