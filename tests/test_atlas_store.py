"""The atlas file: what goes in comes out, the same orbit goes in once, and no accident damages it."""

import csv
import gc
import json
import os
import sqlite3
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from conftest import database

from orbitfinder.atlas import store, tables
from orbitfinder.atlas.export import exported
from orbitfinder.atlas.merge import merge_atlases
from orbitfinder.atlas.signature import LOOP_SAMPLES, Signature, signature_of
from orbitfinder.atlas.store import Atlas, Filter
from orbitfinder.errors import InputError
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.certify import certify
from orbitfinder.records.orbit import orbit_to_document


@pytest.fixture(scope="module")
def triples(report_orbits):
    return [report_orbits["triple-1"], report_orbits["triple-2"]]


@pytest.fixture
def book(tmp_path, triples):
    """A closed atlas with the two triple pendulum orbits of the report."""
    path = tmp_path / "triple.sqlite"
    with Atlas(path, triples[0].system, write=True) as atlas:
        assert [atlas.add(one) for one in triples] == [(1, True), (2, True)]
    return path


def intact(path):
    with database(path) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        count = connection.execute("SELECT count(*) FROM orbits").fetchone()[0]
    connection.close()
    return count


def test_an_orbit_comes_out_as_it_went_in(book, triples):
    """The document is that of orbit.json, digest included, and the orbit passes its certificate."""
    with Atlas(book) as atlas:
        assert len(atlas) == 2
        assert atlas.document(1) == json.loads(json.dumps(orbit_to_document(triples[0])))
        found = atlas.orbit(2)
        assert found.period == triples[1].period and np.array_equal(found.nodes, triples[1].nodes)
        assert certify(found).passed
        row = atlas.rows(order="id")[0]
        assert (row.period, row.symmetry, row.stability) == (
            triples[0].period, triples[0].symmetry, triples[0].stability,
        )  # fmt: skip
        assert row.instability == np.abs(triples[0].floquet_multipliers).max()
        assert atlas.model.degrees_of_freedom == 3


def test_loops_in_memory_stay_within_their_bytes(book, triples, monkeypatch):
    """That which was used last stays; the other is made again where it is asked for."""
    with Atlas(book) as atlas:
        signatures = [signature_of(orbit, atlas.model) for orbit in triples]
        for number, signature in enumerate(signatures, 1):
            atlas.remember(number, signature)
        assert list(atlas._loops) == [1, 2] and atlas.look_up(signatures[0]) == 1 and list(atlas._loops) == [2, 1]
        monkeypatch.setattr(store, "LOOPS_KEPT", 1.5 * signatures[0].loop.nbytes)
        atlas.remember(1, signatures[0])
        assert list(atlas._loops) == [1]
        assert [atlas.look_up(one) for one in signatures] == [1, 2] and list(atlas._loops) == [2]


def test_the_same_orbit_goes_in_once(book, triples):
    """From any node, mirrored or run backwards it is known; after reopening too, when loops are integrated anew."""
    one = triples[0]
    backwards = np.concatenate([np.ones(3), -np.ones(3)])
    variants = [
        replace(one, state=one.nodes[3], nodes=np.roll(one.nodes, -3, axis=0)),
        replace(one, state=-one.state, nodes=-one.nodes),
        replace(one, state=one.state * backwards, nodes=np.roll(one.nodes[::-1], 1, axis=0) * backwards),
    ]
    with Atlas(book, one.system, write=True) as atlas:
        for variant in variants:
            bare = replace(variant, times=np.zeros(0), samples=np.zeros((0, 6)))
            assert atlas.add(bare) == (1, False)
        assert len(atlas) == 2


def test_only_certified_orbits_go_in(book, triples):
    with Atlas(book, triples[0].system, write=True) as atlas, pytest.raises(InputError, match=r"orbit: not certified"):
        atlas.insert(replace(triples[0], certificate=None), signature_of(triples[0], chain(3)))
    assert intact(book) == 2


def test_filters_and_order(book, triples):
    with Atlas(book) as atlas:
        assert [row.id for row in atlas.rows(Filter(period=(2, 3)))] == [2]
        assert [row.id for row in atlas.rows(Filter(energy=(-38.4, -38.3)))] == [1]
        assert (
            len(atlas.rows(Filter(stability=triples[0].stability)))
            == len(atlas.rows(Filter(stability=(triples[0].stability,))))
            >= 1
        )
        assert {row.id for row in atlas.rows(Filter(symmetry=(triples[0].symmetry, triples[1].symmetry)))} == {1, 2}
        assert [row.id for row in atlas.rows(order="period DESC")] == [2, 1]
        with pytest.raises(InputError, match=r"order: unknown 'period; drop'; use columns among id, energy"):
            atlas.rows(order="period; drop")
        with pytest.raises(InputError, match=r"id: no orbit 7"):
            atlas.orbit(7)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("stability", "eliptic", r"stability: unknown 'eliptic', did you mean 'elliptic'\?; use elliptic, unstable"),
        ("stability", ("elliptic", "no such"), r"stability: unknown 'no such'; use elliptic, unstable, marginal"),
        ("stability", "stable", r"stability: unknown 'stable', stable orbits are elliptic where .*; use elliptic"),
        ("symmetry", ("brakes",), r"symmetry: unknown 'brakes', did you mean 'brake'\?; use none, reflection, brake"),
        ("period", (3.0, 2.0), r"period: must be two increasing numbers, got \(3.0, 2.0\)"),
        ("energy", (float("nan"), 2.0), r"energy: must be two increasing numbers"),
        ("energy", 1.0, r"energy: must be two increasing numbers, got 1.0"),
    ],
)
def test_a_filter_that_nothing_passes_is_refused(field, value, message):
    with pytest.raises(InputError, match=message):
        Filter(**{field: value})


def undescribed(model):
    """The same Model as `of.lagrange` would make it."""
    return replace(model, system={"kind": "custom"})


def test_a_model_without_a_description_reads(book, triples):
    """Its energy is that of the recorded orbits; another one's is not, and it cannot write."""
    with Atlas(book, model=undescribed(chain(3))) as atlas:
        assert certify(atlas.orbit(1), atlas.model).passed
    for other in (chain(3, gravity=9.81), chain(4)):
        with pytest.raises(InputError, match=r"holds orbits of chain .* not of custom .* it may read the orbits whose"):
            Atlas(book, model=undescribed(other))
    with pytest.raises(InputError, match=r"to write, search the problem file"):
        Atlas(book, model=undescribed(chain(3)), write=True)
    assert intact(book) == 2


def test_exports(book, triples):
    with Atlas(book) as atlas:
        documents = json.loads(exported(atlas, "json"))
        assert [one["period"] for one in documents] == [triples[0].period, triples[1].period]
        lines = exported(atlas, "csv", Filter(period=(2, 3))).decode().splitlines()
        assert len(lines) == 2 and lines[0].startswith("id,energy,period,action,symmetry,stability,instability")
        assert repr(triples[1].period) in lines[1] and repr(float(triples[1].state[0])) in lines[1]
        assert exported(atlas, "csv", Filter(period=(9, 9))).decode().count("\n") == 1


@pytest.mark.needs("parquet")
def test_parquet(book, triples):
    import pyarrow
    from pyarrow import parquet

    with Atlas(book) as atlas:
        found = parquet.read_table(pyarrow.BufferReader(exported(atlas, "parquet"))).to_pydict()
    assert found["period"] == [triples[0].period, triples[1].period]
    assert found["theta2dot"][1] == triples[1].state[4]


def test_another_system_is_refused(book):
    """By name; all formulations and spellings of one system are the same."""
    with pytest.raises(InputError, match=r"system: holds orbits of chain \(links = 3, .*, not of chain \(links = 4"):
        Atlas(book, chain(4).system, write=True)
    with pytest.raises(InputError, match=r"of chain \(gravity = 9.8\), not of chain \(gravity = 9.81\); give another"):
        Atlas(book, chain(3, gravity=9.81).system)
    Atlas(book, chain(3, gravity=9.8, formulation="lagrange").system, write=True).close()
    assert intact(book) == 2


def test_a_newer_atlas_is_refused_untouched(book):
    with database(book) as connection:
        connection.execute(f"PRAGMA user_version = {tables.VERSION + 1}")
    connection.close()
    before = book.read_bytes()
    for write in (False, True):
        with pytest.raises(InputError, match=rf"version: an atlas of version {tables.VERSION + 1}.*update orbitfinder"):
            Atlas(book, chain(3).system, write=write)
    assert book.read_bytes() == before


def older(book, version):
    """The file as it was in a version: without what later migrations added."""
    with database(book) as connection:
        for column in ("cost", "parameters", *("signature", "proof")[: 2 * (version < 3)]):
            connection.execute(f"ALTER TABLE orbits DROP COLUMN {column}")
        for index in ("orbits_by_energy", "starts_by_orbit")[: 2 * (version < 2)]:
            connection.execute(f"DROP INDEX {index}")
        connection.execute(f"PRAGMA user_version = {version}")
    connection.close()
    return book.read_bytes()


@pytest.mark.parametrize("version", [1, 2])
def test_an_older_atlas_is_read_as_it_is_and_migrated_by_a_writer(book, triples, version):
    """Reading leaves the file alone; its signatures are empty in rows, counted for a table, written by `describe`."""
    with Atlas(book) as atlas:
        wanted = [row.signature for row in atlas.rows(order="id")]
    before = older(book, version)
    with Atlas(book) as atlas:
        assert [(row.signature, row.proof) for row in atlas.rows()] == [("", "")] * 2
        assert [one["signature"] for one in csv.DictReader(exported(atlas, "csv").decode().splitlines())] == wanted
    assert book.read_bytes() == before
    with Atlas(book, triples[0].system, write=True) as atlas:
        assert atlas.connection.execute("PRAGMA user_version").fetchone()[0] == tables.VERSION
        assert atlas.add(triples[0]) == (1, False)
        for row in atlas.rows():
            atlas.describe(row.id)
        assert [row.signature for row in atlas.rows(order="id")] == wanted
    assert intact(book) == 2


def test_a_table_that_was_tampered_with_is_refused(book):
    """A view in place of a column, a table that lacks one."""
    with database(book) as connection:
        connection.execute("ALTER TABLE orbits DROP COLUMN proof")
    connection.close()
    with pytest.raises(InputError, match="table 'orbits' is not as orbitfinder makes it; restore a copy"):
        Atlas(book)


def claimed(orbit):
    """The entry of a proof as far as it says of which orbit it is and what it decides."""
    period, energy = ({"value": repr(one), "radius": 0.0} for one in (orbit.period, orbit.energy))
    return {"proved": True, "stability": "unstable", "period": period, "period_distance": 0.0, "energy": energy}


@pytest.mark.parametrize(
    "wrong",
    [{"stability": "\x1b[32mstable"}, {"stability": {"a": 1}}, {"period": {"value": "2.5"}}, {"proved": 1},
     {"energy": {"value": "-3"}}, {"energy": 4}, {"period": None}],
)  # fmt: skip
def test_a_doctored_proof_is_none(triples, tmp_path, wrong):
    """A proof of other numbers, or of what no proof says, is not in the rows, nor in the table, nor on a page."""
    planted = [replace(triples[0], proof=claimed(triples[0]) | wrong), replace(triples[1], proof=claimed(triples[1]))]
    with Atlas(tmp_path / "planted.sqlite", triples[0].system, write=True) as atlas:
        for orbit in planted:
            atlas.add(orbit)
        assert [row.proof for row in atlas.rows(order="id")] == ["", "unstable"]
        atlas.connection.execute("UPDATE orbits SET proof = 'linearly stable'")  # what no document says
        told = csv.DictReader(exported(atlas, "csv").decode().splitlines())
        assert sorted(one["proof"] for one in told) == ["", "unstable"]


def test_a_proof_goes_into_the_row_and_the_document(book, triples):
    """`describe` keeps the record's digest; a proof that failed is no proof; merging prefers the proved copy."""
    with Atlas(book, triples[0].system, write=True) as atlas:
        record = atlas.document(1)["record"]
        atlas.describe(1, {"proved": False, "reason": "planted"})
        assert atlas.row(1).proof == ""
        atlas.describe(1, claimed(atlas.orbit(1)))
        with pytest.raises(InputError, match="orbit 2: proof: it is of another orbit; prove this one again"):
            atlas.describe(2, claimed(atlas.orbit(1)))
        assert atlas.row(1).proof == "unstable" and atlas.row(2).proof == ""
        assert atlas.document(1)["record"] == record and atlas.orbit(1).proof["stability"] == "unstable"
        with pytest.raises(InputError, match="id: no orbit 7"):
            atlas.describe(7)
    other = book.with_name("other.sqlite")
    with Atlas(other, triples[0].system, write=True) as atlas:
        atlas.add(triples[0])
    for name, pair in (("a.sqlite", (book, other)), ("b.sqlite", (other, book))):
        merge_atlases(pair, book.with_name(name))
        with Atlas(book.with_name(name)) as atlas:
            assert sorted(row.proof for row in atlas.rows()) == ["", "unstable"]


def test_a_look_leaves_nothing_beside_the_atlas(book):
    """The files of SQLite's log go with the last connection, also of one that only asked, which changes nothing."""
    before = book.read_bytes()
    with Atlas(book) as one, Atlas(book) as two:
        assert len(one) == len(two) > 0
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            one.connection.execute("DELETE FROM orbits")
    assert [file.name for file in book.parent.glob(f"{book.name}*")] == [book.name] and book.read_bytes() == before


def test_a_read_only_atlas_can_be_read_only(book, triples):
    os.chmod(book, 0o444)
    with Atlas(book) as atlas:
        assert len(atlas) == 2
    with pytest.raises(InputError, match=r"triple.sqlite: read-only; make it writable, or work on a copy"):
        Atlas(book, triples[0].system, write=True)
    os.chmod(book, 0o644)
    with Atlas(book, triples[0].system, write=True) as atlas:  # the file system turns read-only under way
        atlas.connection.execute("PRAGMA query_only = ON")
        with pytest.raises(InputError, match="read-only"):
            atlas.add(replace(triples[0], period=9.0))
    assert intact(book) == 2


def test_a_full_disk_loses_nothing(book, triples):
    """SQLite is told that no page is left: a clear message, the atlas as before, and space makes it go on."""
    other = replace(triples[0], period=1.0, nodes=np.tile(triples[0].nodes, (40, 1)) + np.random.default_rng(0).normal(
        size=(40 * len(triples[0].nodes), 6)))  # fmt: skip
    with Atlas(book, triples[0].system, write=True) as atlas:
        pages = atlas.connection.execute("PRAGMA page_count").fetchone()[0]
        atlas.connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(InputError, match=r"triple.sqlite: the disk is full; free some space .* goes on from here"):
            atlas.add(other)
        assert len(atlas) == 2
        atlas.connection.execute(f"PRAGMA max_page_count = {pages + 1000}")
        assert atlas.add(other) == (3, True)
    assert intact(book) == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty, not an atlas yet"),
        (b"not a database at all, just text" * 100, "not an SQLite file"),
        (None, "a database of another program"),
    ],
)
def test_other_files_are_refused(tmp_path, content, message):
    path = tmp_path / "other.sqlite"
    if content is None:
        with database(path) as connection:
            connection.execute("CREATE TABLE songs (title TEXT)")
        connection.close()
    else:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        Atlas(path)
    if content != b"":
        with pytest.raises(InputError, match=message):
            Atlas(path, chain(3).system, write=True)


def test_paths_that_are_no_files(tmp_path):
    with pytest.raises(InputError, match="no such atlas"):
        Atlas(tmp_path / "absent.sqlite")
    with pytest.raises(InputError, match="a folder, not an atlas"):
        Atlas(tmp_path, chain(3).system, write=True)
    with pytest.raises(InputError, match="does not exist; make it first"):
        Atlas(tmp_path / "no" / "a.sqlite", chain(3).system, write=True)


def test_a_damaged_document_is_named(book):
    with database(book) as connection:
        connection.execute("UPDATE orbits SET document = x'00' WHERE id = 2")
    connection.close()
    with Atlas(book) as atlas, pytest.raises(InputError, match=r"orbit 2: damaged .*; restore a copy"):
        atlas.orbit(2)


def test_a_damaged_file_is_named(book):
    data = bytearray(book.read_bytes())
    data[4096:] = b"\xff" * (len(data) - 4096)
    book.write_bytes(data)
    with pytest.raises(InputError, match="damaged"), Atlas(book) as atlas:
        atlas.rows()


def test_several_writers(tmp_path, triples):
    """Four writers put the same two orbits in at once: each orbit is there once, every writer gets its id."""
    path, found = tmp_path / "shared.sqlite", []

    def write(turn):
        with Atlas(path, triples[0].system, write=True) as atlas:
            found.extend(atlas.add(one) for one in triples[:: 1 if turn % 2 else -1])

    threads = [threading.Thread(target=write, args=(turn,)) for turn in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert intact(path) == 2
    assert len(found) == 8 and sum(new for _, new in found) == 2 and {number for number, _ in found} == {1, 2}


def test_several_makers(tmp_path):
    """Six connections make the tables of one new file at the same moment: each finds a whole atlas."""
    for turn in range(20):
        path, together, failed = tmp_path / f"{turn}.sqlite", threading.Barrier(6), []

        def make(path=path, together=together, failed=failed):
            together.wait()
            try:
                tables.connect(path, write=True).close()
            except InputError as error:
                failed.append(error)

        threads = [threading.Thread(target=make) for _ in range(6)]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        assert not failed and intact(path) == 0


def synthetic(random):
    """The signature of a loop that no other is like."""
    loop = random.normal(size=(LOOP_SAMPLES, 6))
    return Signature(-30.0, float(random.uniform(0.5, 6)), float(random.uniform(5, 60)), loop, (True,) * 3)


@pytest.mark.slow
def test_the_cost_of_an_insertion_stays_flat(tmp_path, triples, monkeypatch):
    """The 100,000th orbit costs at most 1.5 times the 1,000th (medians of 1,000 look-ups with insertion).

    The document is compressed beforehand, which would hide the rest.
    """
    data = store.compressed(orbit_to_document(triples[0]))
    monkeypatch.setattr(store, "compressed", lambda document: data)
    random, times = np.random.default_rng(0), []
    with Atlas(tmp_path / "large.sqlite", triples[0].system, write=True) as atlas:
        for _ in range(100_500):
            signature = synthetic(random)
            began = time.perf_counter()
            with tables.transaction(atlas.connection):
                assert atlas.look_up(signature) is None
                atlas.insert(triples[0], signature)
            times.append(time.perf_counter() - began)
    early, late = np.median(times[500:1500]), np.median(times[99_500:100_500])
    assert late < 1.5 * early, f"{early * 1e6:.0f} and {late * 1e6:.0f} microseconds"


def test_an_atlas_that_another_thread_collects_is_none_of_its_business(book):
    kept = []

    def opened():
        with Atlas(book) as atlas:
            kept.append(atlas)

    thread = threading.Thread(target=opened)
    thread.start()
    thread.join()
    kept.clear()
    gc.collect()


def test_an_atlas_that_nobody_closed_is_closed_with_its_last_name(book):
    """Python warns of an open connection since 3.13: `of.Atlas(path).orbit(1)` is what the reference shows."""
    atlas = Atlas(book)
    connection = atlas.connection
    del atlas
    gc.collect()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        connection.execute("SELECT 1")
