"""A search in shards that know nothing of each other: which starts are whose, by hand or by a Slurm array."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

from orbitfinder.errors import InputError

AUTO = "auto"
TASK, FIRST, COUNT, STEP = (f"SLURM_ARRAY_TASK_{name}" for name in ("ID", "MIN", "COUNT", "STEP"))
"""What Slurm tells each task of an array (Slurm documentation, "Job Array Support")."""
MOST_PARTS = 1_000_000


@dataclass(frozen=True)
class Shard:
    """Shard `part` (from 1) of `parts`: the starts part - 1, part - 1 + parts, part - 1 + 2 parts ..."""

    part: int = 1
    parts: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.part <= self.parts <= MOST_PARTS:
            raise InputError(
                f"shard: {self.part}/{self.parts} is none; give k/n with k from 1 to n, and n at most {MOST_PARTS}"
            )

    @property
    def first(self) -> int:
        """The number of its first start."""
        return self.part - 1

    def count(self, starts: int) -> int:
        """How many of the first `starts` starts are its."""
        return len(range(self.first, starts, self.parts))


WHOLE = Shard()


def shard_from(given: str | tuple[int, int] | None) -> Shard | None:
    """The shard that `k/n`, (k, n) or "auto" (a Slurm array's environment) means. Raises `InputError`."""
    if given is None:
        return None
    if given == AUTO:
        return _of_array()
    if isinstance(given, str):
        match = re.fullmatch(r"\s*(\d{1,9})\s*/\s*(\d{1,9})\s*", given)
        if not match:
            raise InputError(f"shard: {given!r} is none; give k/n such as 3/8, or {AUTO} in a Slurm array")
        return Shard(int(match[1]), int(match[2]))
    return Shard(*given)


def _of_array() -> Shard:
    """The shard of a task of a Slurm array."""
    values = {name: os.environ.get(name, "") for name in (TASK, FIRST, COUNT)}
    if not all(text.isdigit() for text in values.values()):
        said = ", ".join(f"{name}={text}" for name, text in values.items() if text) or "none of them is set"
        raise InputError(f"shard: {AUTO} needs {', '.join(values)} ({said}); run it by sbatch --array=1-8, or give k/n")
    task, first, count = (int(text) for text in values.values())
    step = int(text) if (text := os.environ.get(STEP, "")).isdigit() and int(text) else 1
    part, rest = divmod(task - first, step)
    if rest or not 0 <= part < count:
        raise InputError(
            f"shard: task {task} of an array of {count} from {first} in steps of {step} is none of equal steps; "
            "run it by sbatch --array=1-8, or give k/n"
        )
    return Shard(part + 1, count)
