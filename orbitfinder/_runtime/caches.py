"""Results that are kept for as long as they are likely to be asked for again."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")


class Same:
    """Something as a part of a key, equal to nothing but itself; while the key is kept its identity is not reused."""

    def __init__(self, thing: Any) -> None:
        self.thing = thing

    def __hash__(self) -> int:
        return id(self.thing)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.thing is self.thing


class Kept(Generic[Value]):
    """The results of the last `most` keys that were used; that unused for longest leaves first."""

    def __init__(self, most: int) -> None:
        self.most, self._found, self._lock = most, dict[Hashable, Value](), Lock()

    def __len__(self) -> int:
        return len(self._found)

    def __call__(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """What is kept under a key, made now where there is nothing."""
        with self._lock:
            if key in self._found:
                self._found[key] = kept = self._found.pop(key)  # the latest used is the last to go
                return kept
        self[key] = kept = make()
        return kept

    def __setitem__(self, key: Hashable, value: Value) -> None:
        with self._lock:
            self._found.pop(key, None)
            while len(self._found) >= self.most:
                self._found.pop(next(iter(self._found)))
            self._found[key] = value

    def clear(self) -> None:
        """Forget everything."""
        self._found.clear()
