"""The shipped atlas: what the data sheet says of the files, and that every orbit stands up to `orbitfinder verify`."""

import json
import random
import re
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from orbitfinder.atlas.export import FIELDS
from orbitfinder.atlas.signature import in_words, same_orbit, signature_of
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.jobs import orbit_and_model
from orbitfinder.mechanics.hybrid import as_recorded
from orbitfinder.orbits.certify import certify

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "results" / "atlas"
FILES = sorted(PLACE.glob("*.sqlite"))
LARGEST, LARGEST_FOLDER = 3_000_000, 12_000_000
PARTS = 24
SHEET = (PLACE / "DATASHEET.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def maker():
    """benchmarks/shipped_atlas.py, which made the files and pages."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import shipped_atlas

    return shipped_atlas


def all_rows():
    found = []
    for file in FILES:
        with Atlas(file) as atlas:
            found += [(file, row) for row in atlas.rows()]
    return found


ROWS = all_rows()


def verified(file, number, folder):
    """The checks that fail when the orbit's document is verified as a file."""
    path = folder / f"{file.stem}-{number}.json"
    with Atlas(file) as atlas:
        path.write_text(json.dumps(atlas.document(number)))
    return certify(*orbit_and_model(path)).failures


def again(atlas, number):
    """Orbit and signature, the loop integrated again."""
    orbit = atlas.orbit(number)
    return orbit, signature_of(orbit, as_recorded(atlas.model, orbit.system))


def alike(atlas):
    """Pairs of rows that agree in energy, period and action: the only ones that can be one orbit."""
    rows = sorted(atlas.rows(), key=lambda row: row.period)
    for k, one in enumerate(rows):
        for other in rows[k + 1 :]:
            if other.period > one.period * (1 + 1e-6):
                break
            if abs(abs(one.action) - abs(other.action)) < 1e-6 * abs(one.action) and np.isclose(
                one.energy, other.energy
            ):
                yield one.id, other.id


def test_what_is_promised(maker):
    """At least 3,000 orbits of at least ten systems; whole files of this version, small; a problem file for each."""
    assert len(ROWS) >= 3000 and len(maker.kinds([row for _, row in ROWS])) > 2500
    assert [file.stem for file in FILES] == sorted(one.name for one in maker.ENTRIES) and len(FILES) >= 10
    assert sum(path.stat().st_size for path in PLACE.rglob("*") if path.is_file()) < LARGEST_FOLDER
    for file in FILES:
        assert file.stat().st_size < LARGEST and not file.with_name(file.name + "-wal").exists()
        with Atlas(file) as atlas:
            assert atlas.connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert min(len(atlas), atlas.connection.execute("SELECT count(*) FROM starts").fetchone()[0]) > 0
    assert all((ROOT / "problems" / f"{one.file}.toml").is_file() for one in maker.ENTRIES)
    assert all(row.signature and np.isfinite([row.action, row.period, row.instability]).all() for _, row in ROWS)
    assert sum(bool(row.proof) for _, row in ROWS) >= 100


def test_published_ids_keep_their_orbits():
    """Rows of the first two atlases, as they were published before the data set had this form."""
    for name, number, period in (
        ("triple", 57, 5.740240459),
        ("triple", 3, 2.663396326),
        ("quadruple", 30, 0.723634407),
    ):
        with Atlas(PLACE / f"{name}.sqlite") as atlas:
            assert atlas.row(number).period == pytest.approx(period, abs=1e-9)


def test_the_pages_count_what_is_in_the_files(maker):
    """The tables of README and data sheet, made again."""
    atlases = {one.name: Atlas(PLACE / f"{one.name}.sqlite") for one in maker.ENTRIES}
    parts = maker.tables(atlases)
    for page, names in maker.PAGES.items():
        text = (PLACE / page).read_text(encoding="utf-8")
        assert maker.filled(text, {name: parts[name] for name in names if name in parts}) == text, page
    for atlas in atlases.values():
        atlas.close()
    assert f"| all | {len(FILES)} systems |" in SHEET and all(f"`{name}`" in SHEET for name in FIELDS)
    assert re.search(r"lorenz, 5 letters: 6 words, 6 orbits in the atlas with 6 of them", SHEET)


@pytest.mark.needs("parquet")
def test_parquet_says_what_sqlite_says():
    """Every number of every row, units and system in the metadata."""
    from pyarrow import parquet

    assert sorted(path.stem for path in PLACE.glob("*.parquet")) == [file.stem for file in FILES]
    for file in FILES:
        table = parquet.read_table(file.with_suffix(".parquet"))
        with Atlas(file) as atlas:
            rows = atlas.rows()
            for name in ("id", "period", "action", "symmetry", "stability", "instability", "signature", "proof"):
                assert table.column(name).to_pylist() == [getattr(row, name) for row in rows], (file.stem, name)
            assert json.loads(table.schema.metadata[b"system"]) == atlas.system
            states = np.array([table.column(name).to_pylist() for name in atlas.model.state_names])
            for k in range(0, len(rows), 40):
                assert np.array_equal(states[:, k], atlas.orbit(rows[k].id).state)
        assert table.schema.field("period").metadata == {b"unit": b"s", b"meaning": b"minimal period"}


@pytest.mark.parametrize("count", [2, pytest.param(None, marks=pytest.mark.slow)])
def test_no_two_rows_are_one_orbit(count):
    """Rows that agree in all numbers are laid over each other: images under a mirror that counts, never the same."""
    for file in FILES:
        with Atlas(file) as atlas:
            pairs = list(alike(atlas))
            for one, other in pairs if count is None else random.SystemRandom().sample(pairs, min(count, len(pairs))):
                assert not same_orbit(again(atlas, one)[1], again(atlas, other)[1]), (file.stem, one, other)


def test_a_random_sample_is_as_recorded(tmp_path):
    """Two of each system, others every time: certified again, signature counted again."""
    chosen = [random.SystemRandom().choice([one for one in ROWS if one[0] == file]) for file in [*FILES, *FILES]]
    failed = {(file.stem, row.id): found for file, row in chosen if (found := verified(file, row.id, tmp_path))}
    assert not failed
    for file, row in chosen:
        with Atlas(file) as atlas:
            assert in_words(*again(atlas, row.id)) == row.signature, (file.stem, row.id)


def test_energies_are_those_that_were_searched():
    """Every row of a conservative system lies on one of the levels of `searches`."""
    for file in FILES:
        with Atlas(file) as atlas:
            levels = np.array([one for (one,) in atlas.select([float], "SELECT DISTINCT energy FROM searches")])
            assert all(np.abs(levels - row.energy).min() < 1e-9 * max(1.0, abs(row.energy)) for row in atlas.rows())


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_all_pass_verify(part, tmp_path):
    """In parts, none of which takes long."""
    orbits = ROWS[part::PARTS]
    assert orbits
    failed = {(file.stem, row.id): found for file, row in orbits if (found := verified(file, row.id, tmp_path))}
    assert not failed


QUICK = ("henon-heiles", "rossler")
"""Systems whose proofs are done again in seconds"""


@pytest.mark.needs("proof")
@pytest.mark.parametrize(
    "file",
    [pytest.param(file, marks=() if file.stem in QUICK else pytest.mark.slow, id=file.stem) for file in FILES],
)
def test_proofs_are_replayed(file):
    """Every one that is recorded."""
    from orbitfinder.proof.record import read_entry, replay

    with Atlas(file) as atlas:
        for number in [row.id for row in atlas.rows() if row.proof]:
            orbit = atlas.orbit(number)
            assert replay(orbit, read_entry(orbit, file), atlas.model)[1] == [], number


@pytest.mark.needs("proof")
def test_the_straight_orbits_proof_holds_its_elliptic_integral():
    """x = 0 and y'^2 = (2/3) (y - a) (b - y) (c - y): T = 4 K((b - a) / (c - a)) / sqrt(2/3 (c - a))."""
    from flint import acb, arb

    from orbitfinder.proof.balls import precision

    with Atlas(PLACE / "henon-heiles.sqlite") as atlas:
        (proof,) = [atlas.orbit(row.id).proof for row in atlas.rows() if row.proof and abs(row.period - 7.106) < 1e-3]
    with precision(200):
        triple = (arb(-1) / 5).acos()  # of E = 1/10: the roots are 1/2 + cos u with cos 3 u = -1/5
        a, b, c = sorted((arb(1) / 2 + ((triple + 2 * k * arb.pi()) / 3).cos() for k in range(3)), key=float)
        exact = 4 * acb((b - a) / (c - a)).elliptic_k().real / (arb(2) / 3 * (c - a)).sqrt()
        assert abs(exact - arb(proof["period"]["value"])) < proof["period"]["radius"] < 1e-15


@pytest.mark.slow
def test_the_search_finds_what_enumerations_find(maker):
    """Every orbit of a scan of the section, up to images, and every word of up to seven letters."""
    import atlas_checks

    for name, plane, longest in atlas_checks.PLANES:
        both, missed, unseen = atlas_checks.compared(PLACE / f"{name}.sqlite", plane, longest, 100)
        assert both >= 3 and not missed and len(unseen) <= 1, name  # the one in the section's plane is not seen
    words = atlas_checks.lorenz(PLACE / "lorenz.sqlite", 7)
    assert all(known == orbits == met for known, orbits, met in words.values())


def test_necklaces_are_counted():
    """(2^n - ...) / n by Moebius, as printed by Viswanath; and each list is sorted out of its rotations."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import atlas_checks

    assert [len(atlas_checks.necklaces(n)) for n in range(2, 9)] == [1, 2, 3, 6, 9, 18, 30]
    assert all(a < b for a, b in pairwise(sorted(atlas_checks.necklaces(6))))
