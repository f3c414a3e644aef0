"""What was computed last, remembered up to a number of bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """A value with a known size in memory."""

    @property
    def nbytes(self) -> int: ...


Kept = TypeVar("Kept", bound=Sized)


class LruCache(Generic[Kept]):
    """Values by key, the least recently used ones forgotten first. Threads may share it; two of them may
    compute the same value, which does not matter."""

    def __init__(self) -> None:
        self._values: OrderedDict[Hashable, Kept] = OrderedDict()  # the latest last
        self._bytes = 0
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], Kept], limit: float) -> Kept:
        """The value of a key, made where it is not remembered; at most `limit` bytes are kept."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        value = make()
        with self._lock:
            if key not in self._values:
                self._values[key] = value
                self._bytes += value.nbytes
            while self._bytes > limit and self._values:
                self._bytes -= self._values.popitem(last=False)[1].nbytes
        return value
