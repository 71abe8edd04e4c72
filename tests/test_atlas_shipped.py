"""The shipped atlas: every orbit stands up to `orbitfinder verify`, and there are as many as promised."""

import json
import random
from pathlib import Path

import pytest

from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.jobs import verify_file

PLACE = Path(__file__).parents[1] / "results" / "atlas"
FILES = sorted(PLACE.glob("*.sqlite"))
LARGEST = 3_000_000
PARTS = 8


def all_orbits():
    found = []
    for file in FILES:
        with Atlas(file) as atlas:
            found += [(file, row.id) for row in atlas.rows()]
    return found


def verified(file, number, folder):
    """The checks that fail when the orbit's document is verified as a file."""
    path = folder / f"{file.stem}-{number}.json"
    with Atlas(file) as atlas:
        path.write_text(json.dumps(atlas.document(number)))
    return verify_file(path)[1].failures


def test_what_is_promised():
    """At least 500 orbits of the triple pendulum at three energies and of the quadruple at one, in small files."""
    assert [file.stem for file in FILES] == ["quadruple", "triple"] and len(all_orbits()) >= 500
    shells = {}
    for file in FILES:
        assert file.stat().st_size < LARGEST and not file.with_name(file.name + "-wal").exists()
        with Atlas(file) as atlas:
            assert atlas.connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            shells[file.stem] = {round(row.energy, 6) for row in atlas.rows()}
            text = (PLACE / "README.md").read_text()
            assert all(f"| {file.stem} | {energy:g} |" in text for energy in shells[file.stem])
    assert len(shells["triple"]) == 3 and len(shells["quadruple"]) == 1


def test_a_random_twenty_pass_verify(tmp_path):
    """Another twenty every time; a failure names its orbits."""
    chosen = random.SystemRandom().sample(all_orbits(), 20)
    failed = {(file.stem, number): found for file, number in chosen if (found := verified(file, number, tmp_path))}
    assert not failed


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_all_pass_verify(part, tmp_path):
    """In parts, none of which takes long."""
    orbits = all_orbits()[part::PARTS]
    assert orbits
    failed = {(file.stem, n): found for file, n in orbits if (found := verified(file, n, tmp_path))}
    assert not failed
