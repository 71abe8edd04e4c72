"""A kind of [system] is one entry of one table: with it files, commands' words and changed parameters know it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import KINDS, SystemKind, build_model, system_kind, with_parameters

GUESS = "[guess]\nstate = [0.3, 0.0]\nperiod = 3.0\n[find]\npin = { energy = 0.09 }\n"


def spring(stiffness: float = 1.0, mass: float = 1.0) -> of.Model:
    """A mass on a spring.

    Args:
        stiffness: of the spring in N/m.
        mass: in kg.

    Returns:
        A Model.
    """
    if stiffness <= 0:
        raise InputError(f"stiffness: must be positive, got {stiffness}; check the sign")
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    k, m = ca.SX.sym("k"), ca.SX.sym("m")
    symbols = of.Symbols(q, v, ca.vertcat(k, m), ("stiffness", "mass"), (stiffness, mass))
    system = {"kind": "spring", "stiffness": stiffness, "mass": mass}
    return of.lagrange(m * v**2 / 2, k * q**2 / 2, symbols, names=["x"], system=system)


def built(system: Mapping[str, Any], _: Path | None) -> of.Model:
    return spring(**{key: value for key, value in system.items() if key != "kind"})


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        KINDS, "spring", SystemKind(built, lambda system: "mass on a spring", takes=spring, reread=True)
    )


def test_a_kind_is_one_entry(known: None, tmp_path: Path) -> None:
    """Its file is read by its function's arguments, its orbit found, rebuilt from the record and verified."""
    file = tmp_path / "p.toml"
    file.write_text('[system]\nkind = "spring"\nstiffness = 4.0\n' + GUESS.replace("0.09", "0.18"))
    orbit = of.find_orbit(of.load_problem(file))
    assert orbit.certificate.passed and orbit.period == pytest.approx(np.pi, rel=1e-12)
    assert of.certify(orbit).passed and system_kind(orbit.system).words(orbit.system) == "mass on a spring"
    stiff = with_parameters(build_model(orbit.system), {"stiffness": 9.0})
    assert stiff.system["stiffness"] == 9.0 and stiff.parameter_values[0] == 9.0


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("stifness = 1.0", "system.stifness: unknown key, did you mean 'stiffness'?; use one of kind, stiffness, mass"),
        ("stiffness = true", "system.stiffness: must be a valid number, got True; expected of the spring in N/m"),
        ("stiffness = -1.0", "system.stiffness: must be positive, got -1.0"),
    ],
)
def test_its_mistakes_are_told_like_others(known: None, tmp_path: Path, line: str, said: str) -> None:
    file = tmp_path / "p.toml"
    file.write_text(f'[system]\nkind = "spring"\n{line}\n' + GUESS)
    with pytest.raises(InputError) as caught:
        of.load_problem(file)
    assert said in str(caught.value)


def test_a_kind_without_an_entry_is_told(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text('[system]\nkind = "spring"\n' + GUESS)
    with pytest.raises(InputError, match="system.kind: unknown 'spring'"):
        of.load_problem(file)
