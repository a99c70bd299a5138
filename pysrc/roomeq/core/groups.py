"""Groups of items with equal keys."""

from collections.abc import Hashable, Iterable
from typing import TypeVar

Key = TypeVar("Key", bound=Hashable)


def numbers_by(keys: Iterable[Key | None]) -> dict[Key, list[int]]:
    """Return the numbers of the items with each key, in the order of its first item; items of None are left out."""
    groups: dict[Key, list[int]] = {}
    for n, key in enumerate(keys):
        if key is not None:
            groups.setdefault(key, []).append(n)
    return groups
