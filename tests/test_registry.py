"""A toy record, known to this file alone, goes through every verb by the registry of records."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.records import registry
from orbitfinder.records.certificate import Certificate, Certified, Check
from orbitfinder.records.codec import Codec, Dense, outline
from orbitfinder.site.gather import Gathered, gather


@dataclass(frozen=True)
class Toy:
    name: str
    system: Mapping[str, Any]
    heights: np.ndarray
    samples: Dense
    certificate: Certified = None
    notes: Mapping[str, str] = field(default_factory=dict)

    @property
    def counts(self) -> str:
        return f"{len(self.heights)} heights"


CODEC = Codec(Toy, "toy", "`a test`", "make it again")


def verified(toy, model):
    least = float(toy.heights.min())
    return Certificate((Check("holds: heights", least, 0.0, least >= 0 and model.degrees_of_freedom == 1),))


def drawn(toy, folder, model):
    (folder / "toy.png").write_bytes(b"a picture")
    return [folder / "toy.png"]


def exported(toy, to, folder, model):
    (folder / f"{toy.name}.{to}").write_text("\n".join(map(repr, toy.heights.tolist())))
    return [folder / f"{toy.name}.{to}"]


def gathered(found, file, chosen):
    found.trusted.append(file)


@pytest.fixture
def file(tmp_path, monkeypatch):
    kind = registry.Kind("a toy", CODEC.load, verify=verified, plot=drawn, export=exported, page=gathered)
    monkeypatch.setitem(registry.KINDS, "toy", kind)
    return CODEC.save(Toy("ball", of.chain(1).system, np.array([1.0, 2.0]), np.zeros((30, 2))), tmp_path / "toy.json")


def run(*words, code=0):
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return result.stdout or result.stderr


def test_a_toy_goes_through_every_verb(file, tmp_path):
    assert registry.kind_of(file) == "toy" and registry.load(file).name == "ball"
    said = run("show", file)
    assert (
        "a toy" in said and "2 heights" in said and "30 x 2" in said and "for show, verify, plot, export, page" in said
    )
    (shown,) = json.loads(run("show", file, "--json"))["results"]
    assert shown["kind"] == "toy" and shown["heights"] == [1.0, 2.0] and "certificate" not in shown
    assert "(ball): certified" in run("verify", file)
    assert json.loads(run("verify", file, "--json"))["results"][0]["passed"]
    assert run("plot", file, "-o", tmp_path / "out").strip().endswith("toy.png")
    assert (tmp_path / "out" / "toy.png").read_bytes() == b"a picture"
    assert run("export", file, "--to", "csv", "-o", tmp_path).strip().endswith("ball.csv")
    assert isinstance(found := gather([file]), Gathered) and found.trusted == [file]


@pytest.mark.parametrize("verb", ["animate", "studio"])
def test_what_it_does_not_answer_is_a_sentence(file, verb):
    with pytest.raises(
        InputError, match=f"a toy, which `{verb}` does not take; give an orbit.*; this file is for show"
    ):
        registry.answer(verb, file)
    with pytest.raises(InputError, match=r"#0: not a family or an atlas, of which orbits have numbers; leave #0 out"):
        registry.load(f"{file}#0")


def test_a_record_that_does_not_hold_is_rejected(file, tmp_path):
    low = CODEC.save(Toy("low", of.chain(1).system, np.array([-1.0]), np.zeros((1, 2))), tmp_path / "low.json")
    assert "REJECTED by holds: heights" in run("verify", low, code=1)


def test_an_outline_is_short_and_says_what_is_left_out():
    parts = [Check(f"c{k}", 1.0, 2.0, True) for k in range(40)]
    found = outline({"checks": parts, "numbers": list(range(40)), "none": (), "unknown": float("nan"), "text": "a"})
    assert list(found) == ["checks", "numbers", "text"] and len(found["checks"]) == 40
    assert found["numbers"][-1] == "and 16 more" and len(found["numbers"]) == 25


def test_every_answer_that_is_named_is_there():
    for kind in registry.kinds().values():
        for verb in ("read", "one", "facts", "prove", "replay", *registry.VERBS):
            named = getattr(kind, verb)
            if isinstance(named, str) and ":" in named:
                assert callable(registry.loaded(named))
