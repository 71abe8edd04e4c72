"""A toy record, written and read by its annotations: what stands in its file, and one sentence for every fault."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.records.certificate import Certificate, Certified, Check
from orbitfinder.records.codec import Codec, Complexes, Dense, Endless, Unknown, entries_of


@dataclass(frozen=True)
class Part:
    _called = {"mark": "label"}  # noqa: RUF012
    size: int
    mark: str


@dataclass(frozen=True)
class Toy:
    _entries = ("double", ..., "part")
    _sparse = ("more",)

    name: str
    part: Part
    energy: Unknown
    error: Endless
    multipliers: Complexes
    table: np.ndarray
    states: Dense
    more: Mapping[str, Any] = field(default_factory=dict)
    certificate: Certified = None

    @property
    def double(self):
        return 2 * self.part.size

    def _check(self):
        if len(self.states) != self.part.size:
            raise ValueError(f"states: {len(self.states)} where {self.part.size} belong")


CODEC = Codec(Toy, "toy", "`a test`", "make it again")
NAN = float("nan")


def toy(**changes):
    given = {"name": "a", "part": Part(2, "b"), "energy": NAN, "error": np.inf, "multipliers": np.array([1 + 2j, -0.5]),
             "table": np.eye(2), "states": np.arange(4.0).reshape(2, 2)}  # fmt: skip
    return Toy(**given | changes)


def test_a_record_stands_in_its_file_as_its_annotations_say(tmp_path):
    path = CODEC.save(toy(), tmp_path / "deep" / "toy.json")
    document = json.loads(path.read_text())
    assert list(document) == ["format", "version", "double", "name", "energy", "error", "multipliers", "table",
                              "certificate", "part"]  # fmt: skip
    assert document["format"] == "orbitfinder/toy" and document["double"] == 4
    assert document["energy"] is None and document["error"] is None
    assert document["multipliers"] == [[1.0, 2.0], [-0.5, 0.0]] and document["part"] == {"size": 2, "label": "b"}
    assert set(np.load(path.with_suffix(".npz"))) == {"states"}


@pytest.mark.parametrize("energy", [NAN, 0.1 + 0.2, np.float64(-3.0)])
@pytest.mark.parametrize("more", [{}, {"b": [1, {"c": None}]}])
def test_it_comes_back_to_the_last_bit(energy, more, tmp_path):
    checks = (Check("closure", 1e-17, 1e-12, True, "a note"), Check("growth", NAN, 1.0, False))
    one = toy(energy=energy, more=more, certificate=Certificate(checks, 2.0, 1e-13))
    path = CODEC.save(one, tmp_path / "toy.json")
    again = CODEC.load(path)
    assert (
        entries_of(again) == entries_of(one)
        and again.more == more
        and repr(again) == repr(replace(one, energy=float(energy)))
    )
    assert again.multipliers.tobytes() == one.multipliers.tobytes() and again.states.tobytes() == one.states.tobytes()
    assert CODEC.save(again, tmp_path / "again.json").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"format": "orbitfinder/other"},
            "format: expected 'orbitfinder/toy', got 'orbitfinder/other'; give a toy",
        ),
        ({"version": 2}, "version: this orbitfinder reads 1, got 2; use the orbitfinder that wrote it, or make it"),
        ({"name": None}, "name: expected text, got None"),
        ({"energy": "x"}, "energy: expected a finite number, got 'x'"),
        ({"part": {"size": 2}}, r"part\.label: missing"),
        ({"part": {"size": 2.0, "label": "b"}}, r"part\.size: expected a whole number, got 2\.0"),
        ({"part": {"size": 3, "label": "b"}}, "states: 2 where 3 belong"),
        ({"multipliers": [1.0]}, r"multipliers: expected a list of \[re, im\]"),
        ({"table": [[1.0], [1.0, 2.0]]}, "table: expected numbers in rows of one length"),
        ({"certificate": {"checks": [{"name": "a"}]}}, r"certificate\.checks\[0\]\.value: missing"),
    ],
)
def test_a_fault_is_one_sentence(change, said, tmp_path):
    path = CODEC.save(toy(), tmp_path / "toy.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=said) as caught:
        CODEC.load(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert "make it again" in str(caught.value) or "toy.json" in str(caught.value)


def test_what_is_beside_a_file_is_asked_for(tmp_path):
    path = CODEC.save(toy(), tmp_path / "toy.json")
    path.with_suffix(".npz").unlink()
    with pytest.raises(InputError, match=r"toy\.npz: no such file"):
        CODEC.load(path)


def test_a_number_that_no_file_can_say_is_named_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match=r"toy\.json: table\[1\]\[0\]: malformed number, inf is not finite"):
        CODEC.save(toy(table=np.array([[0.0], [np.inf]])), tmp_path / "toy.json")
    assert list(tmp_path.iterdir()) == []


@dataclass(frozen=True)
class Bare:
    name: str
    notes: dict


def test_a_bare_table_is_one_of_anything(tmp_path):
    codec = Codec(Bare, "bare", "`a test`", "make it again")
    bare = Bare("a", {"x": 1.5, "y": [1, "b"]})
    assert codec.load(codec.save(bare, tmp_path / "bare.json")) == bare
