"""Files that others made: only regular ones, within bounds, and edited ones are told from sound ones."""

import io
import json
import os
import shutil
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import database

from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.records.family import JOURNAL, load_family, read_journal
from orbitfinder.records.journal import SEAL
from orbitfinder.records.orbit import save_orbit
from orbitfinder.records.reading import inflated, json_document
from orbitfinder.records.registry import load_orbit

ROOT = Path(__file__).parents[1]
FORWARD = FamilySettings(directions="forward")


def refused(*arguments):
    """The one line on stderr of a command that must end with exit code 2."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("Error: ") and result.stderr.count("\n") == 1
    return result.stderr


@pytest.mark.parametrize(
    "command",
    [
        ("run",), ("simulate",), ("guess",), ("verify",), ("verify", "--proof"), ("plot",), ("export", "--to", "csv"),
        ("prove",), ("page", "-o", "site"), ("continue",), ("continue", "--switch", "0"), ("atlas", "list"),
    ],
    ids="-".join,
)  # fmt: skip
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_are_refused_by_every_command(command, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "file.json"
    if kind == "pipe":
        os.mkfifo(file)
    else:
        file.symlink_to("/dev/zero")
    said = refused(*command, file)
    assert "not a regular file" in said or "no such" in said


@pytest.mark.parametrize("name", ["orbit", "family"])
def test_a_pipe_beside_a_file_is_refused(name, tmp_path, pendulum_orbit):
    if name == "orbit":
        save_orbit(pendulum_orbit, tmp_path / "orbit.json")
    else:
        shutil.copy(ROOT / "results/families/henon-heiles-loop/family.json", tmp_path)
    (tmp_path / f"{name}.npz").unlink(missing_ok=True)
    os.mkfifo(tmp_path / f"{name}.npz")
    with pytest.raises(InputError, match="not a regular file"):
        (load_orbit if name == "orbit" else load_family)(tmp_path / f"{name}.json")


def npz_bomb(path, honest):
    """480 MB of zeros in 0.5 MB; or an array that says it is that large and holds a fifth."""
    shape = 60_000_000
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (shape,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("times.npy", "w") as stream:
        stream.write(header.getvalue())
        for _ in range(100 if honest else 20):
            stream.write(bytes(8 * shape // 100))


@pytest.mark.parametrize("honest", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_bomb_of_samples_is_refused_before_it_expands(honest, tmp_path, pendulum_orbit):
    save_orbit(pendulum_orbit, tmp_path / "orbit.json")
    npz_bomb(tmp_path / "orbit.npz", honest)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"orbit\.npz: damaged"):
            load_orbit(tmp_path / "orbit.json")
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_a_bomb_of_a_document_is_refused():
    packer = zlib.compressobj()
    data = b"".join(packer.compress(bytes(10_000_000)) for _ in range(30)) + packer.flush()
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="expands beyond"):
            inflated(data, "orbit 1", "restore a copy")
        assert tracemalloc.get_traced_memory()[1] < 250e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 70 + "]" * 70, "nested too deeply"),
        ('{"a": [0, 1' + "0" * 30 + "]}", r"a\[1\]: malformed number, beyond"),
        ('{"a": 1' + "0" * 5000 + "}", "corrupt JSON"),
        ('{"a": {"b": 1e999}}', "a.b: malformed number, inf"),
        ('{"a": "\\ud800"}', "a: malformed text"),
        ('{"a": NaN}', "NaN is not a number"),
        (b"\xff".decode("latin-1"), "cannot be read"),
    ],
)
def test_what_json_may_not_hold(text, said):
    with pytest.raises(InputError, match=said):
        json_document(text.encode("latin-1"), "file", "give another")


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A short family with its journal."""
    folder = tmp_path_factory.mktemp("walked")
    follow_family(mode_problem(chain(1), 1), points=6, out=folder, settings=FORWARD)
    return folder / "mode-1"


@pytest.fixture
def family(walked, tmp_path):
    """A copy of it to damage."""
    return Path(shutil.copytree(walked, tmp_path / "mode-1"))


def edit_line(path, number, change, seal=True):
    """Change a journal's line as data; without its digest, if so wished, all lines lose theirs."""
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    change(lines[number])
    if not seal:
        lines = [{key: value for key, value in line.items() if key != SEAL} for line in lines]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def test_a_damaged_last_line_loses_only_itself(family, caplog):
    whole = read_journal(family)
    data = (family / JOURNAL).read_bytes()
    (family / JOURNAL).write_bytes(data[:-60] + b"#" + data[-59:])
    kept = read_journal(family)
    assert len(kept.batches) == len(whole.batches) - 1
    assert "line 8" in caplog.text and "computed again" in caplog.text
    assert (family / JOURNAL).read_bytes() == data[: len((family / JOURNAL).read_bytes())]
    again = follow_family(mode_problem(chain(1), 1), points=6, out=family.parent, settings=FORWARD)
    assert len(again.points) == 7


@pytest.mark.parametrize("number", [0, 3])
def test_a_damaged_line_in_the_middle_is_named(family, number):
    lines = (family / JOURNAL).read_bytes().splitlines(keepends=True)
    lines[number] = lines[number][:50] + b"#" + lines[number][51:]
    (family / JOURNAL).write_bytes(b"".join(lines))
    with pytest.raises(InputError, match=rf"line {number + 1}: .*restore a copy"):
        read_journal(family)
    assert (family / JOURNAL).read_bytes() == b"".join(lines)


@pytest.mark.parametrize("seal", [True, False])
def test_an_edited_number_of_a_journal_is_no_certified_orbit(family, seal):
    """By its digest; where the journal has none (0.1.0), because the orbit does not close."""
    edit_line(family / JOURNAL, 3, lambda line: line["points"][0].update(period=1.9), seal)
    said = "line 4: .*digest" if seal else "closes only to"
    with pytest.raises(InputError, match=said):
        follow_family(mode_problem(chain(1), 1), points=6, out=family.parent, settings=FORWARD)


def test_a_journal_without_digests_still_resumes(family):
    edit_line(family / JOURNAL, 1, lambda line: None, seal=False)
    assert not read_journal(family).sealed
    again = follow_family(mode_problem(chain(1), 1), points=8, out=family.parent, settings=FORWARD)
    assert len(again.points) == 9


def test_an_edited_family_is_refused(family):
    document = json.loads((family / "family.json").read_text())
    document["points"][2]["period"] *= 1 + 1e-12
    (family / "family.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="edited or damaged"):
        load_family(family / "family.json")
    assert "edited or damaged" in refused("page", family / "family.json", "-o", family / "site")


def test_arrays_of_another_family_are_refused(family):
    with np.load(family / "family.npz") as data:
        made = dict(data)
    made["point_nodes"] = made["point_nodes"] + 1e-9
    np.savez(family / "family.npz", **made)
    with pytest.raises(InputError, match=r"family\.npz: its digest"):
        load_family(family / "family.json")


@pytest.fixture
def book(tmp_path):
    return Path(shutil.copy(ROOT / "results/atlas/quadruple.sqlite", tmp_path / "a.sqlite"))


ENDLESS = """DROP TABLE orbits; CREATE VIEW orbits AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)
SELECT id, 0 energy, 1 period, 0 action, '' symmetry, '' stability, 1 instability, 0 closure, x'' document FROM n"""


@pytest.mark.parametrize(
    ("script", "said"),
    [
        (ENDLESS, "view 'orbits' is not as orbitfinder makes it"),
        ("CREATE TRIGGER t AFTER INSERT ON starts BEGIN DELETE FROM orbits; END", "trigger 't'"),
        ("DROP TABLE starts", "misses"),
        ("UPDATE orbits SET energy = 'much' WHERE id = 1", "expected a finite number, got 'much'"),
        ("UPDATE orbits SET stability = x'ff' WHERE id = 1", "expected text, got"),
        ("UPDATE about SET value = '[' WHERE key = 'system'", "system: truncated or corrupt JSON"),
        ("UPDATE about SET value = x'ff' WHERE key = 'system'", "expected text"),
        ("UPDATE about SET value = '7' WHERE key = 'system'", "expected a table, got 7"),
    ],
)
def test_a_tampered_atlas_is_one_sentence(book, script, said):
    with database(book) as connection:
        connection.executescript(script)
    connection.close()
    assert said in refused("atlas", "list", book)


def test_an_id_beyond_64_bits_is_not_in_the_atlas(book):
    assert "no orbit 99999999999999999999" in refused("atlas", "show", book, "99999999999999999999")
