"""What is kept is found again by the same key alone, and only so much is kept."""

import numpy as np

from orbitfinder._runtime.caches import Kept, Same


def test_the_last_used_are_kept():
    """Against a list in the order of use, over random uses."""
    random, kept, known, made = np.random.default_rng(0), Kept[int](4), list[int](), list[int]()
    for key in random.integers(0, 8, 400).tolist():
        made.clear()
        assert kept(key, lambda key=key: made.append(key) or 10 * key) == 10 * key
        assert bool(made) == (key not in known)
        known = [*(one for one in known if one != key), key][-4:]
        assert len(kept) == len(known)


def test_things_are_told_apart_by_identity():
    """Equal arrays are two keys, one array is one; what is put there replaces what was."""
    kept, one, other = Kept[str](4), np.zeros(2), np.zeros(2)
    assert kept(Same(one), lambda: "first") == "first"
    assert kept(Same(one), lambda: "again") == "first" and kept(Same(other), lambda: "other") == "other"
    kept[Same(one)] = "put"
    assert kept(Same(one), lambda: "again") == "put" and len(kept) == 2
    kept.clear()
    assert len(kept) == 0
