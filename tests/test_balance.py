"""Families of driven motions by harmonic balance, against programs outside this project and the certificate's integrator."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

import orbitfinder as of
from orbitfinder.families.balance import balanced_family
from orbitfinder.loops.problem import Problem

ROAD = {entry["id"]: entry for entry in json.loads((Path(__file__).parent / "data" / "road.json").read_text())}


def masses(count, frequency, damping=0.02):
    """The forced chain of road.json."""
    rows = sparse.diags_array([-np.ones(count - 1), 2 * np.ones(count), -np.ones(count - 1)], offsets=[-1, 0, 1])
    springs = {f"s{i}": {"kind": "cubic", "at": f"q{i}", "to": f"q{i - 1}", "stiffness": "cubic"}
               for i in range(2, count + 1)}  # fmt: skip
    springs |= {name: {"kind": "cubic", "at": at, "stiffness": "cubic"}
                for name, at in (("s1", "q1"), ("wall", f"q{count}"))}  # fmt: skip
    one = sparse.eye_array(count)
    load = {"at": "q1", "amplitude": 0.3, "frequency": frequency}
    model = of.structure(one, damping * one, rows, springs, load, parameters={"cubic": 0.1})
    return Problem(model, of.guesses.linear_response(model))


def followed(problem, until, at=(), **settings):
    chosen = of.FamilySettings(parameter="frequency", **{"certify": False, **settings})
    return balanced_family(problem, chosen, until, at, "masses")


@pytest.mark.parametrize(("name", "count"), [("chain-20", 20), ("chain-100", 100)])
def test_amplitudes_are_those_of_another_program(name, count):
    """The first harmonic of the first mass to 14 digits, and the motion by the state that it passes."""
    first, *rest = ROAD[name]["values"]
    problem = masses(count, first["w"])
    family = followed(problem, rest[-1]["w"], [known["w"] for known in rest[:-1]])
    assert [end.kind for end in family.ends] == ["target"]
    for known in (first, *rest):
        (point,) = (point for point in family.points if point.value == known["w"])
        nodes = np.fft.rfft(point.shooting_nodes[:, 0]) / 4
        assert point.stability == "asymptotically stable"
        assert abs(nodes[1]) == pytest.approx(float(known["first_harmonic_x1_H15"]), rel=1e-3)  # of 8 states, aliased
