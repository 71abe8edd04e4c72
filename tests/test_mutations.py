"""Damaged files of every format: an answer or one sentence, never a traceback, never a hang.

A seeded mutator edits sound files, as data (entries dropped, doubled, renamed, retyped, made huge, deep or too
long) and as bytes (flipped, cut, inserted). Where a format carries a digest, half of the mutants get a fresh
one, so that what lies behind the digest is tried too. Every mutant goes through the functions that the commands
call; only `OrbitfinderError` is allowed. A failure names its seed: `mutant(format, number)` makes it again.
"""

import contextlib
import io
import json
import shutil
import signal
import sqlite3
import time
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.hostile import edited, edited_toml, garbled, written
from orbitfinder.atlas.report import discovery, summarise
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.cli.jobs import check_consistent
from orbitfinder.errors import OrbitfinderError
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.start import curve_of
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.records.family import JOURNAL, assemble, load_family, read_journal, save_family
from orbitfinder.records.journal import SEAL, seal
from orbitfinder.records.orbit import digest
from orbitfinder.records.reading import content_digest
from orbitfinder.records.registry import load_orbit
from orbitfinder.site.gather import gather

ROOT = Path(__file__).parents[1]
FAMILIES = ("henon-heiles-loop", "five-bar-length")
SEED = 14
FORMATS = ("problem", "orbit", "family", "npz", "journal", "proof", "atlas")
MANY = {"problem": 2000, "orbit": 2000, "family": 1500, "npz": 1500, "journal": 1000, "proof": 1000, "atlas": 1000}
"""10,000 in all."""
FEW = 40
LIMIT = 10.0
"""Processor seconds that one file may take."""


class Hang(BaseException):
    """A file took longer than `LIMIT`."""


@contextlib.contextmanager
def limited():
    """Raise `Hang` in the block after `LIMIT` seconds of processor time."""

    def stop(*_):
        raise Hang

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A folder with sound files of every format."""
    folder = tmp_path_factory.mktemp("sound")
    shutil.copytree(ROOT / "problems" / "gallery", folder / "problems")
    settings = FamilySettings(directions="forward")
    follow_family(mode_problem(chain(1), 1), points=6, out=folder, settings=settings)
    for name in FAMILIES:
        save_family(load_family(ROOT / "results" / "families" / name / "family.json"), folder / name)
    for name in ("duffing", "henon-heiles-loop", "four-bar-rotating", "spring-pendulum-swing"):
        shutil.copytree(ROOT / "results" / "gallery" / name, folder / "orbits" / name)
    shutil.copy(ROOT / "results" / "proofs" / "triple-7.json", folder / "proof.json")
    shutil.copy(ROOT / "results" / "atlas" / "triple.sqlite", folder / "atlas.sqlite")
    with contextlib.closing(sqlite3.connect(folder / "atlas.sqlite", isolation_level=None)) as book:
        book.execute("PRAGMA journal_mode = DELETE")
        book.execute("DELETE FROM starts WHERE number > 40 OR orbit > 6")
        book.execute("DELETE FROM orbits WHERE id > 6")
        book.execute("VACUUM")
    return folder


def mutant(kind, number, sound, folder):
    """The path of a damaged file of one format, and whatever lies beside it."""
    random = np.random.default_rng([SEED, FORMATS.index(kind), number])
    as_bytes = random.random() < 0.3
    return MAKERS[kind](sound, folder, random, as_bytes)


def problem(sound, folder, random, as_bytes):
    """A problem file, beside the files that it may name."""
    files = sorted((sound / "problems").glob("*.toml"))
    data = files[random.integers(len(files))].read_bytes()
    path = folder / "problem.toml"
    path.write_bytes(garbled(data, random) if as_bytes else edited_toml(data.decode(), random).encode())
    return path


def orbit(sound, folder, random, as_bytes):
    """An orbit.json beside its orbit.npz."""
    source = sorted((sound / "orbits").iterdir())[random.integers(4)]
    path = shutil.copytree(source, folder / "o") / "orbit.json"
    data = path.read_bytes()
    document = edited(json.loads(data), random)
    if random.random() < 0.5:
        with contextlib.suppress(Exception):
            document["record"] = digest(document)
    path.write_bytes(garbled(data, random) if as_bytes else written(document))
    return path


def family(sound, folder, random, as_bytes):
    """A family.json, with or without its family.npz; half of them with a fresh digest, some with none."""
    source = sound / (*FAMILIES, "mode-1")[random.integers(3)]
    path = shutil.copytree(source, folder / "f") / "family.json"
    data = path.read_bytes()
    document = edited(json.loads(data), random)
    if random.random() < 0.3:
        path.with_suffix(".npz").unlink()
    if random.random() < 0.8:
        document.pop("record", None)
        if random.random() < 0.5:
            document.pop("dense", None)
        else:
            with contextlib.suppress(Exception):
                document["record"] = content_digest(document)
    path.write_bytes(garbled(data, random) if as_bytes else written(document))
    return path


def npz(sound, folder, random, as_bytes):
    """An orbit.npz or family.npz beside its sound document, of which the digests are left out."""
    if random.random() < 0.5:
        path = shutil.copytree(sound / "orbits" / "duffing", folder / "o") / "orbit.json"
    else:
        path = shutil.copytree(sound / "henon-heiles-loop", folder / "f") / "family.json"
        if random.random() < 0.7:
            document = json.loads(path.read_text())
            path.write_text(json.dumps({key: one for key, one in document.items() if key not in ("record", "dense")}))
    beside = path.with_suffix(".npz")
    if as_bytes:
        beside.write_bytes(garbled(beside.read_bytes(), random))
        return path
    with np.load(beside) as data:
        made = dict(data)
    name = sorted(made)[random.integers(len(made))]
    one = made[name]
    other = (one[:-1], one[..., None], one.astype("f4"), one.astype(complex), one.astype(str), one * np.nan, -one,
             one[::-1], np.zeros(0), np.array(3.0), one.astype(">f8"), np.full(one.shape, 2**62), one.astype(bool),
             np.asfortranarray(one), one + 1e12, np.zeros(3, "datetime64[s]"), None)[random.integers(17)]  # fmt: skip
    del made[name]
    if other is not None:
        made[name] = other
    buffer = io.BytesIO()
    (np.savez if random.random() < 0.5 else np.savez_compressed)(buffer, **made)
    beside.write_bytes(buffer.getvalue())
    return path


def journal(sound, folder, random, as_bytes):
    """A folder with a family.jsonl; two in three of the edited lines have a fresh digest or none."""
    (folder / "j").mkdir()
    data = (sound / "mode-1" / JOURNAL).read_bytes()
    lines = data.splitlines(keepends=True)
    at = int(random.integers(len(lines)))
    document, way = edited(json.loads(lines[at]), random), random.integers(3)
    if way:
        document.pop(SEAL, None)
        if way == 2:
            bare = [{key: entry for key, entry in json.loads(line).items() if key != SEAL} for line in lines]
            lines = [json.dumps(one).encode() + b"\n" for one in bare]
        with contextlib.suppress(Exception):
            document |= {SEAL: seal(document)} if way == 1 else {}
    lines[at] = written(document) + b"\n"
    if random.random() < 0.1:
        del lines[: int(random.integers(len(lines)))]
    (folder / "j" / JOURNAL).write_bytes(garbled(data, random) if as_bytes else b"".join(lines))
    return folder / "j"


def proof(sound, folder, random, as_bytes):
    """An orbit with a damaged `proof` entry."""
    data, path = (sound / "proof.json").read_bytes(), folder / "orbit.json"
    document = json.loads(data)
    path.write_bytes(
        garbled(data, random) if as_bytes else written(document | {"proof": edited(document["proof"], random)})
    )
    return path


def atlas(sound, folder, random, as_bytes):
    """A database with damaged pages, entries, documents or tables."""
    path = shutil.copy(sound / "atlas.sqlite", folder / "atlas.sqlite")
    if as_bytes:
        path.write_bytes(garbled(path.read_bytes(), random))
        return path
    with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(path, isolation_level=None)) as book:
        book.execute("PRAGMA ignore_check_constraints = 1")
        table = ("about", "orbits", "searches", "starts")[random.integers(4)]
        columns = [one[1] for one in book.execute(f"PRAGMA table_info({table})")]
        column, key = columns[random.integers(len(columns))], columns[0]
        act = random.choice(["value", "value", "document", "system", "table", "drop", "pragma"])
        if act == "document":
            known = json.loads(zlib.decompress(book.execute("SELECT document FROM orbits WHERE id = 1").fetchone()[0]))
            data = zlib.compress(written(edited(known, random)))
            book.execute("UPDATE orbits SET document = ? WHERE id = 1", [data[: len(data) - random.integers(2)]])
        elif act == "system":
            known = json.loads(book.execute("SELECT value FROM about WHERE key = 'system'").fetchone()[0])
            book.execute("UPDATE about SET value = ? WHERE key = 'system'", [written(edited(known, random)).decode()])
        elif act == "value":
            value = ("text", b"\xff\xfe", None, -1, 2**62, 1e308, float("inf"), "", "\x00")[random.integers(9)]
            book.execute(f"UPDATE {table} SET {column} = ? WHERE {key} = (SELECT min({key}) FROM {table})", [value])
        elif act == "table":
            book.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO other")
        elif act == "drop":
            book.execute(random.choice([f"DROP TABLE {table}", f"DELETE FROM {table}"]))
        else:
            book.execute(f"PRAGMA {random.choice(['user_version', 'application_id'])} = {random.integers(-3, 4)}")
    return path


MAKERS = dict(zip(FORMATS, (problem, orbit, family, npz, journal, proof, atlas), strict=True))


def use_problem(path):
    load_problem_file(path)


def use_result(path):
    """What page, verify, plot, export and continue read first of an orbit or a family."""
    with contextlib.suppress(OrbitfinderError):
        gather([path])
    if path.name == "family.json":
        found = load_family(path)
        settings = FamilySettings(parameter=found.parameter)
        curve_of(found.curve, build_model(found.system), settings)
    else:
        found = load_orbit(path)
        check_consistent(found, build_model(found.system))


def use_journal(path):
    found = read_journal(path)
    if found is not None:
        assemble(found)
        curve_of(found.header["curve"], build_model(found.header["system"]), FamilySettings())


def use_proof(path):
    """What `verify --proof` does before and after the replay itself, which is that of the sound file."""
    from orbitfinder.proof.record import contradictions, options_of, read_entry

    found = read_entry(load_orbit(path), path)
    options_of(found)
    contradictions(found, json.loads((ROOT / "results" / "proofs" / "triple-7.json").read_text())["proof"])


def use_atlas(path):
    with contextlib.suppress(OrbitfinderError):
        gather([path])
    for words in (["list"], ["report"], ["export", "--to", "csv"], ["show"]):
        number = ["1"] if words == ["show"] else []
        result = CliRunner().invoke(cli, ["atlas", words[0], str(path), *words[1:], *number])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code in (0, 2), result.output
    with Atlas(path) as opened:
        summarise(opened)
        discovery(opened, 1)


USES = {"problem": use_problem, "orbit": use_result, "family": use_result, "npz": use_result, "journal": use_journal,
        "proof": use_proof, "atlas": use_atlas}  # fmt: skip
KINDS = [pytest.param(kind, marks=pytest.mark.needs("proof")) if kind == "proof" else kind for kind in FORMATS]


def tried(kind, number, sound, folder):
    """How one mutant ended: read, refused, or what went wrong."""
    path = mutant(kind, number, sound, folder)
    try:
        with warnings.catch_warnings(), limited():
            warnings.simplefilter("ignore")
            USES[kind](path)
    except OrbitfinderError as error:
        return "refused" if str(error) else f"{number}: {error!r}"
    except Hang:
        return f"{number}: over {LIMIT} s"
    except Exception as error:
        trace = error.__traceback__
        while trace.tb_next:
            trace = trace.tb_next
        return f"{number}: {error!r:.200} at {trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
    return "read"


def all_tried(kind, count, sound, tmp_path):
    """Every mutant's end, counted; the ends that should not be are returned."""
    began, ends = time.perf_counter(), []
    for number in range(count):
        folder = tmp_path / "one"
        folder.mkdir()
        ends.append(tried(kind, number, sound, folder))
        shutil.rmtree(folder)
    counts = {word: ends.count(word) for word in ("read", "refused")}
    print(f"{kind}: {count} mutants, {counts}, {time.perf_counter() - began:.0f} s")
    return [end for end in ends if end not in counts]


@pytest.mark.parametrize("kind", KINDS)
def test_some_damaged_files(kind, sound, tmp_path):
    """The first mutants of every format."""
    assert not all_tried(kind, FEW, sound, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_damaged_files(kind, sound, tmp_path):
    """All of them."""
    assert not all_tried(kind, MANY[kind], sound, tmp_path)


def test_sound_files_are_read(sound):
    """The mutator starts from files that every reader takes."""
    for path in [*sound.glob("orbits/*/orbit.json"), *sound.glob("*/family.json")]:
        use_result(path)
    use_journal(sound / "mode-1")
    use_atlas(sound / "atlas.sqlite")


@pytest.mark.needs("proof")
def test_a_sound_proof_is_read(sound):
    """The same of proofs."""
    use_proof(sound / "proof.json")
