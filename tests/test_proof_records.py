"""The committed proofs of atlas orbits (and of the report's), replayed one by one."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("flint")

from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.proof import branch
from orbitfinder.proof.bordered import BorderedRecord, events
from orbitfinder.proof.branch import RECORDS as BRANCHES
from orbitfinder.proof.connections import CODEC as CONNECTIONS
from orbitfinder.proof.connections import ConnectionRecord, ProvedEnd
from orbitfinder.proof.equilibria import CODEC as EQUILIBRIA
from orbitfinder.proof.equilibria import ProvedEquilibria
from orbitfinder.proof.record import bounding, read_entry, replay
from orbitfinder.proof.theorem import Options, Proof
from orbitfinder.records.orbit import digest
from orbitfinder.records.registry import load_orbit

pytestmark = pytest.mark.needs("proof")
RESULTS = Path(__file__).parents[1] / "results"
RECORDS = sorted((RESULTS / "proofs").glob("*.json"))
WANTED = 50


def mark(document):
    """Energy, period and action: the same for an orbit and its mirror images."""
    return tuple(round(document[name], 6) for name in ("energy", "period", "action"))


def test_fifty_orbits_of_the_shipped_atlas_are_proved():
    """Every record is whole and proved; at least fifty are distinct orbits of the shipped atlas."""
    documents = [json.loads(file.read_text()) for file in RECORDS]
    assert all(one["proof"]["proved"] and one["proof"]["box_radius"] < 1e-9 for one in documents)
    assert all(digest(one) == one["record"] for one in documents)
    marks = {mark(one) for one in documents}
    assert len(marks) == len(documents)
    shipped = set()
    for file in sorted((RESULTS / "atlas").glob("*.sqlite")):
        with Atlas(file) as atlas:
            shipped |= {mark(vars(row)) for row in atlas.rows()}
    assert len(marks & shipped) >= WANTED


def test_a_proof_is_recorded_in_the_atlas(tmp_path, monkeypatch):
    """`prove ATLAS.sqlite#K` writes row and document, which `verify --proof` replays; --no-record leaves it alone."""
    book = Path(shutil.copy(RESULTS / "atlas" / "lorenz.sqlite", tmp_path / "lorenz.sqlite"))
    with Atlas(book) as atlas:
        row = next(one for one in atlas.rows(order="period") if not one.proof)
    for options, verdict in ((["--no-record"], ""), ([], "unstable")):
        said = CliRunner().invoke(cli, ["prove", f"{book}#{row.id}", *options])
        assert said.exit_code == 0 and "proved in" in said.output, said.output
        with Atlas(book) as atlas:
            assert atlas.row(row.id).proof == verdict
    said = CliRunner().invoke(cli, ["verify", "--proof", f"{book}#{row.id}"])
    assert said.exit_code == 0 and "proof replayed" in said.output, said.output
    book.chmod(0o444)
    monkeypatch.setattr("orbitfinder.proof.theorem.prove", None)  # not begun where it cannot be recorded
    said = CliRunner().invoke(cli, ["prove", f"{book}#{row.id}"])
    assert said.exit_code == 2 and "read-only; make it writable" in said.stderr


def test_an_atlas_is_proved_in_shards_that_share_nothing(monkeypatch):
    """Every orbit that has no proof, in one shard or another and once."""
    book = RESULTS / "atlas" / "lorenz.sqlite"
    with Atlas(book) as atlas:
        wanted = {f"{book}#{row.id}" for row in atlas.rows() if not row.proof}
    proof = Proof(False, "not tried", "none", Options(), 0.0)
    monkeypatch.setattr("orbitfinder.proof.theorem.prove", lambda *_: proof)
    lists = []
    for part in ("1/3", "2/3", "3/3"):
        said = CliRunner().invoke(cli, ["prove", str(book), "--shard", part, "--no-record", "--json"])
        assert said.exit_code == 1
        lists.append([one["file"] for one in json.loads(said.stdout)["results"]])
    assert set().union(*lists) == wanted and sum(map(len, lists)) == len(wanted) > 30


def test_a_contraction_is_a_bound():
    """Not less than the one found, but for what other series leave out, and below 1."""
    for fresh in (1e-7, 0.12, 0.67):
        assert all(bounding(recorded, fresh) for recorded in (fresh, fresh * (1 - 1e-8), 1.4 * fresh, 0.999))
        assert not any(
            bounding(recorded, fresh) for recorded in (0.6 * fresh, 0.94 * fresh, 1.0, 1.34, 0.0, -1.0, None)
        )
    assert bounding(1e-16, 3e-16)  # of a linear system all of it is round-off


@pytest.mark.slow
def test_a_record_of_another_version_has_its_own_bound_of_the_contraction():
    """Within three tenths of the one found, for its series and steps are others; of this version a twentieth."""
    file = RESULTS / "proofs" / "gaits" / "rimless-wheel.json"
    orbit = load_orbit(file)
    recorded = read_entry(orbit, file)
    (found,) = replay(orbit, {**recorded, "contraction": 0.0})[1]
    most = float(found.rpartition(" ")[2])
    for share, version, passed in ((0.8, "0.1.0", True), (0.7, "0.1.0", False), (0.8, None, False), (0.97, None, True)):
        older = {} if version is None else {"versions": {"orbitfinder": version}}
        wrong = replay(orbit, {**recorded, **older, "contraction": share * most})[1]
        assert [one.partition(":")[0] for one in wrong] == ["contraction"] * (not passed), (share, version, wrong)


@pytest.mark.slow
def test_a_contraction_is_a_bound_of_the_one_found():
    """Of the wheel's proof: not a twentieth less, nothing of 1 or above, and more than is found up to there."""
    file = RESULTS / "proofs" / "gaits" / "rimless-wheel.json"
    orbit = load_orbit(file)
    recorded = read_entry(orbit, file)
    for changed in (0.6, 0.94, 1.34 / recorded["contraction"], 1 / recorded["contraction"], 0.0, -1.0):
        wrong = replay(orbit, {**recorded, "contraction": changed * recorded["contraction"]})[1]
        assert [one.partition(":")[0] for one in wrong] == ["contraction"], (changed, wrong)
    for kept in (1.0, 2.0, 0.99 / recorded["contraction"]):
        assert replay(orbit, {**recorded, "contraction": kept * recorded["contraction"]})[1] == []


@pytest.mark.parametrize("name", ["branch-proof", "event-proof", "equilibria-proof", "connection-proof"])
def test_the_files_of_proofs_have_a_digest(name, tmp_path):
    """Of all that they say, the units of the system among it; files of before have none and load."""
    ball = {"value": "1", "radius": 0.1}
    end = ProvedEnd(1, (1,), (1.0,), (1.0,), 1.0, period=ball)
    about = "spring", {"kind": "custom", "units": {"time": "ms"}}
    codec, record = {
        "branch-proof": (BRANCHES, branch.Record(*about, "none", 1, (), (), None, 0.0, 1.0)),
        "event-proof": (events, BorderedRecord(*about, "k", "fold", "none", 1, (), (), 1, (1, 1), (1.0,), (1.0,), 0.1,
                                               contraction=0.1)),
        "equilibria-proof": (EQUILIBRIA, ProvedEquilibria(*about, "k")),
        "connection-proof": (CONNECTIONS, ConnectionRecord("spring", True, about[1], ("x",), 0, 0.0, 1.0, 1, 1, (0,),
                                                           end, end, contraction=0.1)),
    }[name]  # fmt: skip
    file = codec.save(record, tmp_path / f"{name}.json")
    text = file.read_text()
    assert codec.load(file).system == about[1]
    file.write_text(text.replace('"ms"', '"msx"'))
    with pytest.raises(InputError, match="record: its digest is another, so the file was edited or damaged"):
        codec.load(file)
    document = json.loads(text)
    del document["record"]
    file.write_text(json.dumps(document))
    assert codec.load(file).name == "spring"


@pytest.mark.slow
def test_an_atlas_is_proved_by_processes(tmp_path):
    """What they prove is recorded in the atlas, as it is by this process."""
    book = Path(shutil.copy(RESULTS / "atlas" / "lorenz.sqlite", tmp_path / "lorenz.sqlite"))
    said = CliRunner().invoke(cli, ["prove", str(book), "--shard", "1/40", "--workers", "2", "--json"])
    assert said.exit_code == 0
    results = json.loads(said.stdout)["results"]
    with Atlas(book) as atlas:
        assert results and all(atlas.row(int(one["file"].rpartition("#")[2])).proof for one in results)


@pytest.mark.slow
@pytest.mark.parametrize("file", RECORDS, ids=lambda file: file.stem)
def test_record_replays(file):
    """The proof done again contradicts nothing that is recorded."""
    proof, wrong = replay(load_orbit(file), read_entry(load_orbit(file), file))
    assert proof.proved and not wrong
