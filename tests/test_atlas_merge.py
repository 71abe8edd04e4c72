"""Shards and merging: eight atlases that know nothing of each other are one search, byte for byte."""

import concurrent.futures
import itertools
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import database
from test_atlas_search import ENERGY, PERIODS, content
from test_search_command import run

import orbitfinder as of
from orbitfinder.atlas import merge, workers
from orbitfinder.atlas.export import exported
from orbitfinder.atlas.merge import merge_atlases
from orbitfinder.atlas.shard import Shard, shard_from
from orbitfinder.atlas.starts import Target
from orbitfinder.atlas.store import Atlas
from orbitfinder.atlas.workers import Pool, Request
from orbitfinder.errors import InputError, OrbitfinderError
from orbitfinder.mechanisms.chain import chain

PARTS, STARTS = 8, 40


@pytest.fixture(scope="module")
def triple():
    return chain(3)


@pytest.fixture(scope="module")
def whole(triple, lend):
    """One search of one process."""

    def make(folder):
        of.search(triple, ENERGY, PERIODS, folder / "one.sqlite", starts=STARTS, workers=0)

    return lend("one-search", make, __file__) / "one.sqlite"


@pytest.fixture(scope="module")
def shards(triple, lend):
    """The same by eight shards, each in an atlas of its own."""

    def make(folder):
        for k in range(1, PARTS + 1):
            path = folder / f"shard-{k}.sqlite"
            of.search(triple, ENERGY, PERIODS, path, starts=STARTS, workers=0, shard=f"{k}/{PARTS}")

    folder = lend("shards", make, __file__)
    return [folder / f"shard-{k}.sqlite" for k in range(1, PARTS + 1)]


def exports(path):
    with Atlas(path) as atlas:
        return exported(atlas, "json"), exported(atlas, "csv")


def copied(path, folder, name):
    return Path(shutil.copy(path, folder / name))


def test_eight_merged_shards_are_one_search(whole, shards, tmp_path):
    """Exports byte for byte, and all starts with their outcomes."""
    merged = merge_atlases(shards, tmp_path / "merged.sqlite")
    assert exports(tmp_path / "merged.sqlite") == exports(whole)
    assert content(tmp_path / "merged.sqlite") == content(whole)
    assert (merged.starts, merged.searches[0].missing) == (STARTS, 0) and merged.orbits >= 4
    assert sum(len(content(one)[0]) for one in shards) > merged.orbits  # there was something to recognise


pytestmark = pytest.mark.usefixtures("optimised")

KILLED = """
import os, signal, sys
from orbitfinder.atlas import merge
whole, calls = merge._starts, []
def starts(*given):
    calls.append(whole(*given))
    if len(calls) == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
merge._starts = starts
merge.merge_atlases(sys.argv[3:], sys.argv[2])
"""


@pytest.mark.slow
def test_a_killed_merge_takes_only_what_is_missing(whole, shards, tmp_path, monkeypatch):
    """kill -9 in the middle of the third atlas, and of the fourth of those that were left."""
    for turn in ("3", "4"):
        words = [sys.executable, "-c", KILLED, turn, tmp_path / "merged.sqlite", *shards]
        assert subprocess.run(words, check=False).returncode == -signal.SIGKILL
    joined, right = [], merge._joined
    monkeypatch.setattr(merge, "_joined", lambda out, books: (joined.append(len(books)), right(out, books)))
    merge_atlases(shards, tmp_path / "merged.sqlite")
    assert joined == [2] * 3 and exports(tmp_path / "merged.sqlite") == exports(whole)
    assert content(tmp_path / "merged.sqlite") == content(whole)


def test_merging_is_idempotent_commutative_and_associative(whole, shards, tmp_path):
    merge_atlases([*shards, shards[0]], tmp_path / "all.sqlite")
    wanted = content(tmp_path / "all.sqlite")
    merge_atlases([tmp_path / "all.sqlite", shards[3], whole], tmp_path / "all.sqlite")
    assert content(tmp_path / "all.sqlite") == wanted
    merge_atlases(shards[5:] + shards[:5][::-1], tmp_path / "turned.sqlite")
    assert content(tmp_path / "turned.sqlite") == wanted
    merge_atlases(shards[:3], tmp_path / "left.sqlite")
    merge_atlases(shards[2:], tmp_path / "right.sqlite")
    merge_atlases([tmp_path / "right.sqlite", tmp_path / "left.sqlite"], tmp_path / "both.sqlite")
    assert content(tmp_path / "both.sqlite") == wanted
    for one in shards:
        merge_atlases([one], tmp_path / "grown.sqlite")
    assert content(tmp_path / "grown.sqlite") == wanted


def test_a_search_goes_on_from_merged_shards_and_fills_gaps(triple, whole, shards, tmp_path):
    """One shard is lost: its starts are the only ones made, also when a worker counts them from another end."""
    kept, path = [one for k, one in enumerate(shards) if k != 2], tmp_path / "a.sqlite"
    assert merge_atlases(kept, path).searches[0].missing == STARTS // PARTS
    found = of.search(triple, ENERGY, PERIODS, path, starts=STARTS, workers=0)
    ((_, statistics),) = found.tallies
    assert statistics.done == STARTS // PARTS and statistics.begun_at == 2
    merge_atlases([path, shards[2]], tmp_path / "again.sqlite")
    assert exports(tmp_path / "again.sqlite")[0].count(b'"state"') == exports(whole)[0].count(b'"state"')


def test_a_shard_goes_on_where_it_stopped(triple, shards, tmp_path):
    for starts in (9, STARTS, STARTS):
        found = of.search(triple, ENERGY, PERIODS, tmp_path / "a.sqlite", starts=starts, workers=0, shard=(2, PARTS))
    assert content(tmp_path / "a.sqlite") == content(shards[1]) and found.tallies[0][1].done == 0


def test_shards_of_two_energies_continue_from_nothing(triple, tmp_path):
    """They cannot know what others found at the other energy; 1/1 is the search that they add up to."""
    ask = {"energies": [ENERGY, -34.0], "periods": PERIODS, "starts": 4, "workers": 0}
    for k in (1, 2):
        of.search(triple, atlas=tmp_path / f"{k}.sqlite", shard=(k, 2), **ask)
    of.search(triple, atlas=tmp_path / "whole.sqlite", shard=(1, 1), **ask)
    merge_atlases([tmp_path / "2.sqlite", tmp_path / "1.sqlite"], tmp_path / "merged.sqlite")
    assert exports(tmp_path / "merged.sqlite") == exports(tmp_path / "whole.sqlite")
    assert content(tmp_path / "merged.sqlite") == content(tmp_path / "whole.sqlite")


def test_what_is_wrong_is_refused_and_nothing_is_written(triple, shards, tmp_path):
    foreign = tmp_path / "double.sqlite"
    of.search(chain(2), -15.0, (0.5, 3.0), foreign, starts=1, workers=0)
    other = tmp_path / "seed.sqlite"
    of.search(triple, ENERGY, PERIODS, other, starts=1, workers=0, seed=1)
    damaged, newer = copied(shards[3], tmp_path, "damaged.sqlite"), copied(shards[3], tmp_path, "newer.sqlite")
    lost, torn = copied(shards[3], tmp_path, "lost.sqlite"), tmp_path / "torn.sqlite"
    torn.write_bytes(shards[3].read_bytes()[:5000])
    for path, order in (
        (damaged, "UPDATE orbits SET document = substr(document, 1, 200) WHERE id = 1"),
        (newer, "PRAGMA user_version = 99"),
        (lost, "DELETE FROM orbits WHERE id = 1"),
    ):
        with database(path) as connection:
            connection.executescript(order)
        connection.close()
    out = tmp_path / "out.sqlite"
    merge_atlases(shards[:2], out)
    before = content(out)
    for path, said in (
        (foreign, r"double.sqlite: system: holds orbits of chain"),
        (other, r"seed.sqlite: searches: at -30 J.*seed 1.*leave it out, or give --union"),
        (damaged, r"damaged.sqlite: orbit 1: damaged"),
        (newer, r"newer.sqlite: version: an atlas of version 99"),
        (lost, r"lost.sqlite: starts: of searches or orbits that are not there"),
        (torn, r"torn.sqlite: (damaged|not an SQLite file)"),
        (tmp_path / "none.sqlite", r"none.sqlite: no such atlas"),
    ):
        for files in ([shards[2], path], [path, shards[2]]):
            with pytest.raises(InputError, match=said if path != foreign else r"system: holds orbits of chain"):
                merge_atlases(files, out)
    assert content(out) == before
    with pytest.raises(InputError, match="files: none given"):
        merge_atlases([], out)
    assert len(merge_atlases([shards[2], other], out, union=True).searches) == 2


def test_a_merge_that_is_killed_leaves_the_atlas_as_it_was(shards, tmp_path, monkeypatch):
    out = tmp_path / "out.sqlite"
    merge_atlases(shards[:2], out)
    before = content(out)
    monkeypatch.setattr("orbitfinder.atlas.merge._starts", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        merge_atlases(shards, out)
    assert content(out) == before


def test_orbits_without_a_start_are_merged_too(whole, shards, tmp_path):
    """Those that somebody added by hand; added to both, they are there once."""
    with Atlas(whole) as atlas:
        orbits = [atlas.orbit(number) for number in (1, 2, 3)]
    for name, chosen in (("a", orbits[:2]), ("b", orbits[1:])):
        with Atlas(tmp_path / f"{name}.sqlite", write=True, system=orbits[0].system) as atlas:
            for one in chosen:
                atlas.add(one)
    for turn, names in enumerate(itertools.permutations("ab")):
        merge_atlases([tmp_path / f"{name}.sqlite" for name in names], tmp_path / f"{turn}.sqlite")
    assert (
        content(tmp_path / "0.sqlite") == content(tmp_path / "1.sqlite") and len(content(tmp_path / "0.sqlite")[0]) == 3
    )


@pytest.mark.parametrize("text", ["0/8", "9/8", "1/0", "three", "-1/8", "1/8/2", ""])
def test_a_shard_that_is_none(text, tmp_path):
    with pytest.raises(InputError, match=r"shard: .* none; give k/n"):
        of.search(chain(3), ENERGY, PERIODS, tmp_path / "a.sqlite", starts=1, workers=0, shard=text)
    assert not (tmp_path / "a.sqlite").exists()


def test_shards_share_out_all_starts():
    for parts in (1, 3, 8):
        found = sorted(n for k in range(parts) for n in range(Shard(k + 1, parts).first, 50, parts))
        assert found == list(range(50))
        assert sum(Shard(k + 1, parts).count(50) for k in range(parts)) == 50


def test_the_shard_of_a_slurm_array(monkeypatch):
    for name in ("ID", "MIN", "COUNT", "STEP"):
        monkeypatch.delenv(f"SLURM_ARRAY_TASK_{name}", raising=False)
    with pytest.raises(InputError, match=r"shard: auto needs SLURM_ARRAY_TASK_ID, .*none of them is set"):
        shard_from("auto")

    def array(**values):
        for name, value in values.items():
            monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", str(value))
        return shard_from("auto")

    assert array(ID=5, MIN=5, COUNT=8) == Shard(1, 8)
    assert array(ID=12, MIN=5, COUNT=8) == Shard(8, 8)
    assert array(ID=20, MIN=0, COUNT=4, STEP=10) == Shard(3, 4)
    for wrong in ({"ID": 7, "MIN": 1, "COUNT": 3, "STEP": 1}, {"ID": 25, "MIN": 0, "COUNT": 4, "STEP": 10}):
        with pytest.raises(InputError, match=r"shard: task .* is none of equal steps"):
            array(**wrong)


def test_by_the_commands(whole, tmp_path, monkeypatch):
    """`search --shard` and `atlas merge`, as eight lines of a Slurm script give them."""
    monkeypatch.setenv("SLURM_ARRAY_TASK_MIN", "1")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    text = f'name = "t"\n[system]\nkind = "chain"\nlinks = 3\n[search]\nenergy = {ENERGY}\nperiod = [0.5, 6.0]\n'
    (tmp_path / "t.toml").write_text(text)
    for task in ("1", "2"):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", task)
        book = ["--atlas", str(tmp_path / f"t-{task}.sqlite")]
        run("search", tmp_path / "t.toml", "--starts", STARTS, "--workers", 0, "--shard", "auto", *book)
    files, out = [tmp_path / f"t-{task}.sqlite" for task in "21"], tmp_path / "t.sqlite"
    said = json.loads(run("atlas", "merge", *files, "--atlas", out, "--json")[0])
    assert said["searches"][0]["missing"] == 0 and said["starts"] == STARTS
    assert exports(out) == exports(whole)
    said = run("search", tmp_path / "t.toml", "--shard", "9/8", "--atlas", tmp_path / "x.sqlite", code=2)
    assert "shard: 9/8 is none" in said[1]


def test_an_executor_does_the_starts(triple, shards, tmp_path):
    """Threads (one start at a time in a process) find what one process finds."""
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        path, shard = tmp_path / "t.sqlite", (2, PARTS)
        of.search(triple, ENERGY, PERIODS, path, starts=STARTS, executor=threads, shard=shard)
    assert content(path) == content(shards[1])


@pytest.mark.slow
def test_an_executor_of_processes(triple, whole, tmp_path):
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(2, mp_context=spawn) as processes:
        of.search(triple, ENERGY, PERIODS, tmp_path / "p.sqlite", starts=STARTS, executor=processes)
    assert content(tmp_path / "p.sqlite") == content(whole)


def test_executors_that_cannot_work(triple, tmp_path, monkeypatch):
    ask = (triple, ENERGY, PERIODS, tmp_path / "a.sqlite")
    with pytest.raises(InputError, match=r"executor: int has no submit\(\)"):
        of.search(*ask, starts=1, executor=3)
    with pytest.raises(InputError, match="executor: goes without scheduler"):
        of.search(*ask, starts=1, executor=3, scheduler="tcp://127.0.0.1:9")
    closed = concurrent.futures.ThreadPoolExecutor(1)
    closed.shutdown()
    with pytest.raises(OrbitfinderError, match="search: the executor takes no more starts"):
        of.search(*ask, starts=1, executor=closed)
    monkeypatch.setattr(workers, "perform", lambda *_: os.strerror(None))
    with concurrent.futures.ThreadPoolExecutor(1) as threads:
        crew = Pool(Request(dict(triple.system), Target(ENERGY, PERIODS), 0), threads, 1)
        crew.submit([workers.Job(0)])
        with pytest.raises(OrbitfinderError, match="search: a worker of the executor failed with TypeError"):
            crew.results(20.0)
        crew.close()


class Ends:
    """An executor whose starts all end in one way."""

    def __init__(self, error):
        self.error = error

    def submit(self, *_):
        ended = concurrent.futures.Future()
        ended.set_exception(self.error)
        return ended


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (concurrent.futures.CancelledError("Failed to reconnect"), "is gone or took its work back .*start it again"),
        (
            InputError("system.module: 'mine' cannot be imported"),
            "cannot read the problem: .*must be where its workers run",
        ),
    ],
)
def test_what_workers_lack_is_named_rightly(triple, error, said):
    """Neither a scheduler that was killed nor a module of the problem is mended by installing orbitfinder there."""
    crew = Pool(Request(dict(triple.system), Target(ENERGY, PERIODS), 0), Ends(error), 1)
    crew.submit([workers.Job(0)])
    with pytest.raises(OrbitfinderError, match=said) as caught:
        crew.results(20.0)
    assert "orbitfinder there" not in str(caught.value) and "with the same orbitfinder" not in str(caught.value)
