"""orbit.json: exact round trip, refusal of everything unreadable, whole files only."""

import contextlib
import json
import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.orbits.certify import certify
from orbitfinder.records.certificate import Certificate, Check
from orbitfinder.records.orbit import Orbit, digest, orbit_to_document, save_orbit
from orbitfinder.records.reading import write_atomically
from orbitfinder.records.registry import load_orbit


def awkward_orbit(seed: int = 0) -> Orbit:
    """An orbit of numbers that decimal text likes to lose: thirds, denormals, huge and negative zero."""
    random = np.random.default_rng(seed)
    state = np.array([1 / 3, -0.0, 5e-324, 1e300])
    return Orbit(
        name="awkward", system={"kind": "chain", "links": 2, "length": [1 / 3, 0.1]}, state=state,
        period=np.nextafter(1.7, 2), energy=-0.1 - 0.2, action=1 / 7, closure=1e-17, symmetry="none",
        winding=(0, -2), floquet_multipliers=random.normal(size=2) + 1j * random.normal(size=2),
        pair_defect=2e-13, stability="elliptic", unfolding=(1e-17, -3e-16), nodes=random.normal(size=(3, 4)),
        times=np.sort(random.normal(size=5)), samples=random.normal(size=(5, 4)), tolerance=1e-12,
        expected={"period": (1.7, 1e-9)}, provenance={"wall_time": 0.1},
        certificate=Certificate((Check("closure", 1e-17, 1e-12, True, "a note"),), 1.5, 3e-17, 2e-13),
        title="Ungewöhnlich", source="test",
    )  # fmt: skip


def same(one, other) -> bool:
    """Equality to the last bit, sign of zero included."""
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    return one == other


@pytest.fixture
def written(tmp_path, pendulum_orbit) -> Path:
    """A certified orbit on disk."""
    return save_orbit(pendulum_orbit, tmp_path / "orbit.json")


def test_every_number_survives_the_file(tmp_path):
    """Saving and loading gives every field back bit by bit, dense samples and certificate included."""
    orbit = awkward_orbit()
    again = load_orbit(save_orbit(orbit, tmp_path / "deep" / "folder" / "orbit.json"))
    for field in fields(Orbit):
        if field.name != "record":
            assert same(getattr(again, field.name), getattr(orbit, field.name)), field.name
    assert again.record == digest(orbit_to_document(orbit))


def test_a_certificate_keeps_its_closure(written):
    """As it was certified; of a file of 0.1, which wrote it beside the certificate only, from there."""
    document = json.loads(written.read_text())
    for entry in ({}, {"closure": 2e-15}, {"closure": None}):
        about = {key: value for key, value in document["certificate"].items() if key != "closure"} | entry
        written.write_text(json.dumps(document | {"certificate": about}))
        found = load_orbit(written).certificate
        wanted = {0: document["closure"], 2e-15: 2e-15, None: np.nan}[entry.get("closure", 0)]
        assert np.array_equal(found.closure, wanted, equal_nan=True) and found.passed


def test_a_second_round_trip_writes_the_same_bytes(written, tmp_path):
    """Loading and saving again reproduces the file, so an orbit has one form."""
    again = save_orbit(load_orbit(written), tmp_path / "again.json")
    assert again.read_bytes() == written.read_bytes()


def test_the_document_keeps_its_contract(written):
    """All entries that design.md promises are there, and the file holds no NaN or infinity."""
    document = json.loads(written.read_text(), parse_constant=pytest.fail)
    promised = (
        "format version name system state period energy action closure symmetry floquet_multipliers "
        "stability certificate provenance"
    )
    assert set(promised.split()) <= set(document)
    assert document["format"] == "orbitfinder/orbit" and document["version"] == 1
    assert set(document["certificate"]) >= {"passed", "checks"}
    assert {"name", "value", "tolerance", "passed"} <= set(document["certificate"]["checks"][0])
    assert document["certificate"]["passed"] is True


def test_the_samples_are_optional(written):
    """Without orbit.npz the orbit still loads, with no samples, and certifies."""
    written.with_suffix(".npz").unlink()
    orbit = load_orbit(written)
    assert orbit.times.size == 0 and orbit.samples.shape == (0, 2)
    assert certify(orbit).passed


def test_the_digest_is_of_the_numbers_not_of_the_layout(written):
    """Reordering keys, indentation and 2 for 2.0 keep the digest; any number's last bit changes it."""
    document = json.loads(written.read_text())
    shuffled = dict(reversed(document.items()))
    assert digest(json.loads(json.dumps(shuffled, indent=7))) == document["record"]
    document["tolerance"] = 1.0
    assert digest({**document, "tolerance": 1}) == digest(document)
    for name in ("period", "energy", "action", "closure", "pair_defect"):
        changed = {**document, name: float(np.nextafter(document[name], 1e9))}
        assert digest(changed) != digest(document), name
    assert digest({**document, "title": "other"}) == digest(document)


@pytest.mark.parametrize("kept", [0, 1, 2, 10, 100, 500, 1000, -3])
def test_a_truncated_file_is_refused(written, kept):
    """An orbit.json cut anywhere is an InputError that names the file."""
    data = written.read_bytes()
    written.write_bytes(data[:kept])
    with pytest.raises(InputError, match=r"orbit.json: truncated or corrupt JSON"):
        load_orbit(written)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x00\x01\x02", "corrupt"),
        (b"\xff\xfe\xfa", "cannot be read"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"a":' * 100_000, "nested too deeply"),
        (b"[]", "format: expected an object, got list"),
        (b"3", "format: expected an object, got int"),
        (b"null", "format: expected an object, got NoneType"),
        (b"{}", "format: expected 'orbitfinder/orbit', got None"),
    ],
)
def test_a_corrupt_file_is_refused(tmp_path, data, message):
    """Bytes that are no orbit document are an InputError, however they fail."""
    path = tmp_path / "orbit.json"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        load_orbit(path)


REQUIRED = (
    "name", "system", "state", "period", "energy", "action", "closure", "symmetry", "stability", "floquet_multipliers",
)  # fmt: skip


def edit(path: Path, **changes) -> Path:
    """Change entries of an orbit.json by hand; None deletes."""
    document = json.loads(path.read_text())
    for name, value in changes.items():
        if value is None:
            del document[name]
        else:
            document[name] = value
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("name", REQUIRED)
def test_a_missing_entry_is_named(written, name):
    """A required entry that is not there is an InputError with its name."""
    with pytest.raises(InputError, match=f"{name}: missing"):
        load_orbit(edit(written, **{name: None}))


@pytest.mark.parametrize("name", REQUIRED)
def test_an_entry_of_the_wrong_kind_is_named(written, name):
    """true instead of a number, text, list or object is an InputError with the entry's name."""
    with pytest.raises(InputError, match=f"{name}: expected .+, got True"):
        load_orbit(edit(written, **{name: True}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(format="orbitfinder/family"), "format: expected 'orbitfinder/orbit', got 'orbitfinder/family'"),
        (dict(version=2), "version: this orbitfinder reads 1, got 2"),
        (dict(version="1"), "version: this orbitfinder reads 1, got '1'"),
        (dict(state=["a", 0.0]), "malformed"),
        (dict(state=[[1.0], 0.0]), "malformed"),
        (dict(state=[{}, 0.0]), "malformed"),
        (dict(floquet_multipliers=[1.0]), "malformed"),
        (dict(floquet_multipliers=[[1.0, 0.0, 0.0]]), "malformed"),
        (dict(winding=["once"]), "malformed"),
        (dict(winding=7), "malformed"),
        (dict(nodes=[[1.0, 2.0], [1.0]]), "malformed"),
        (dict(expected={"period": 1.0}), "malformed"),
        (dict(expected=[1]), "malformed"),
        (dict(certificate={"checks": [{"colour": 1}]}), "malformed"),
        (dict(certificate="yes"), "malformed"),
        (dict(tolerance="tight"), "malformed"),
        (dict(tolerance=-1.0), "tolerance"),
        (dict(tolerance=1.5), "tolerance"),
        (dict(period=10**400), "malformed"),
        (dict(state=[10**400, 0.0]), "malformed"),
        (dict(provenance=3), "malformed"),
        (dict(unfolding=["none"]), "malformed"),
        (dict(unfolding=3), "malformed"),
        (dict(expected={"colour": {"value": 1.0, "tolerance": 1.0}}), "expected"),
    ],
)
def test_a_malformed_entry_is_refused(written, changes, message):
    """Entries that parse as JSON but mean nothing are an InputError, not another exception."""
    with pytest.raises(InputError, match=message):
        load_orbit(edit(written, **changes))


@pytest.mark.parametrize(
    "changes",
    [
        dict(state=[]),
        dict(state=[1.0, 0.0, 0.0]),
        dict(state=[1.0, 0.0, 0.0, 0.0]),
        dict(winding=[0, 0]),
        dict(system={"kind": "chain", "links": 2}),
        dict(system={"kind": "chain", "links": 1, "length": "long"}),
        dict(system={"kind": "linkage"}),
    ],
)
def test_entries_that_contradict_each_other_never_certify(written, changes):
    """A state, winding or system of the wrong size ends in an InputError or in a failed certificate."""
    try:
        certificate = certify(load_orbit(edit(written, **changes)))
    except InputError as error:
        assert len(str(error)) > 20
    else:
        assert not certificate.passed


@pytest.mark.parametrize("constant", ["NaN", "Infinity", "-Infinity"])
def test_constants_that_are_no_numbers_are_refused(written, constant):
    """JSON's illegal constants are refused by name."""
    text = written.read_text()
    period = json.loads(text)["period"]
    written.write_text(text.replace(f'"period": {period!r}', f'"period": {constant}'))
    with pytest.raises(InputError, match=f"{constant} is not a number"):
        load_orbit(written)


@pytest.mark.parametrize("name", ["period", "energy", "action", "closure", "pair_defect", "tolerance"])
def test_a_number_that_overflows_to_infinity_never_certifies(written, name):
    """1e999 reads as infinity in Python's JSON; no certificate passes with it."""
    document = json.loads(written.read_text())
    text = json.dumps({**document, name: "PLACE"}).replace('"PLACE"', "1e999")
    written.write_text(text)
    with contextlib.suppress(InputError):
        assert not certify(load_orbit(written)).passed


def test_missing_files_and_folders_are_refused(tmp_path):
    """No file, a folder, an unreadable sample file: each one sentence naming the path."""
    with pytest.raises(InputError, match="nothing.json: no such file"):
        load_orbit(tmp_path / "nothing.json")
    with pytest.raises(InputError, match="a folder, not a file"):
        load_orbit(tmp_path)


@pytest.mark.parametrize("damage", [b"", b"not a zip", b"PK\x03\x04 damaged"])
def test_damaged_samples_are_refused(written, damage):
    """A broken orbit.npz beside a good orbit.json is an InputError that names it."""
    written.with_suffix(".npz").write_bytes(damage)
    with pytest.raises(InputError, match=r"orbit\.npz"):
        load_orbit(written)


def test_writing_leaves_the_two_files_and_nothing_else(tmp_path, pendulum_orbit):
    """Saving, and saving over what is there, leaves no temporary file and ordinary permissions."""
    for _ in range(2):
        save_orbit(pendulum_orbit, tmp_path / "orbit.json")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["orbit.json", "orbit.npz"]
    umask = os.umask(0)
    os.umask(umask)
    assert (tmp_path / "orbit.json").stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("failure", [OSError("disk full"), KeyboardInterrupt()])
def test_an_interrupted_write_keeps_the_old_file(tmp_path, monkeypatch, failure):
    """When the last step fails or Ctrl-C comes, the old file is whole and no temporary one is left."""
    target = tmp_path / "orbit.json"
    target.write_bytes(b"old")

    def fail(*_):
        raise failure

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(type(failure)):
        write_atomically(target, b"new")
    assert target.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["orbit.json"]


def test_an_orbit_with_a_number_missing_is_not_written(tmp_path, pendulum_orbit):
    """NaN in an orbit is refused before anything is written."""
    with pytest.raises(ValueError, match="(?i)nan|JSON"):
        save_orbit(replace(pendulum_orbit, energy=float("nan")), tmp_path / "orbit.json")
    assert list(tmp_path.iterdir()) == []
