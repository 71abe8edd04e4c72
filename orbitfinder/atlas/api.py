"""`search(...)`: from a model, an energy and a range of periods to orbits in an atlas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.atlas.job import Task
from orbitfinder.atlas.report import Summary, summarise
from orbitfinder.atlas.search import Limits, Search, Tally
from orbitfinder.atlas.starts import Bench, Target, bench
from orbitfinder.atlas.store import Atlas
from orbitfinder.atlas.workers import Inline, Local, Workers
from orbitfinder.errors import InputError
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model

DEFAULT_BUDGET = 60.0
"""Seconds of a search that is given no limit."""
LARGEST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Found:
    """What one run of a search did: its tally by energy (J), and the summary of these searches from the atlas."""

    __repr__ = brief("atlas", "summary")

    atlas: Path
    tallies: tuple[tuple[float, Tally], ...]
    summary: Summary


def search(
    model: Model,
    energies: float | Sequence[float],
    periods: tuple[float, float],
    atlas: str | Path,
    *,
    starts: int | None = None,
    budget: float | None = None,
    seed: int = 0,
    workers: int = 2,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: Callable[[float, Tally], None] | None = None,
) -> Found:
    """Search for periodic orbits of a Model and keep the distinct certified ones in an atlas file.

    `energies` in J, `periods` the range of minimal periods in s. Ends at `starts` starts for each energy
    or after `budget` seconds (60 when neither is given), shared among the energies. The result depends on the
    seed, not on the workers: 0 is this process, n are n spawned ones, `scheduler` the address of a Dask cluster.
    A search that was stopped, however, goes on when the same is asked again. `folder`: see `Task`.
    Raises `InputError`.
    """
    shells = tuple(float(one) for one in (energies if isinstance(energies, Sequence) else [energies]))
    check_request(shells, starts, budget, seed, workers)
    budget = DEFAULT_BUDGET if starts is None and budget is None else budget
    limits = Limits(starts, None if budget is None else budget / len(shells))
    tallies, ids = [], []
    with Atlas(atlas, write=True, model=model) as book:
        for energy in shells:
            task = Task(dict(model.system), energy, (float(periods[0]), float(periods[1])), int(seed),
                        None if folder is None else str(folder))  # fmt: skip
            one = bench(model, Target(energy, task.periods))
            told = None if progress is None else (lambda tally, energy=energy: progress(energy, tally))
            hunt = Search(book, task, one, limits, told)
            crew = employed(one, task, workers, scheduler)
            try:
                tallies.append((energy, hunt.run(crew)))
            finally:
                crew.close()
            ids.append(hunt.id)
        return Found(Path(atlas), tuple(tallies), summarise(book, ids))


def employed(one: Bench, task: Task, workers: int, scheduler: str | None) -> Workers:
    """Whoever is to do the starts."""
    if scheduler is not None:
        rebuildable(one.model, task)
        from orbitfinder.atlas.cluster import Cluster

        return Cluster(task, scheduler)
    if workers == 0:
        return Inline(one, task)
    rebuildable(one.model, task)
    return Local(task, workers)


def rebuildable(model: Model, task: Task) -> None:
    """`InputError` when other processes would not make the same Model from its description."""
    try:
        built = build_model(task.system, None if task.folder is None else Path(task.folder))
    except InputError as error:
        raise InputError(f"workers: other processes cannot rebuild this system ({error}); use workers=0") from error
    same = built.parameter_values.shape == model.parameter_values.shape and np.allclose(
        built.parameter_values, model.parameter_values, rtol=1e-15
    )
    if built.state_names != model.state_names or not same:
        raise InputError("workers: the description of this system makes another one elsewhere; use workers=0")


def check_request(shells: Sequence[float], starts: int | None, budget: float | None, seed: int, workers: int) -> None:
    """`InputError` for limits that mean nothing."""
    if not shells:
        raise InputError("energy: missing; give at least one, in J")
    if starts is not None and starts < 0:
        raise InputError(f"starts: must not be negative, got {starts}; give a number of starts")
    if budget is not None and not 0 < budget < float("inf"):
        raise InputError(f"budget: must be positive and finite, got {budget}; give it in s")
    if not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"seed: must be between 0 and 2^63 - 1, got {seed}; give a whole number")
    if not 0 <= workers <= 256:
        raise InputError(f"workers: must be between 0 and 256, got {workers}; 0 searches in this process")
