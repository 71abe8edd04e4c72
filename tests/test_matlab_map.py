"""The documentation's map from the report's MATLAB functions to ours: every one-line call works."""

import re
from pathlib import Path

import numpy as np
import pytest

SECTION = (Path(__file__).parents[1] / "docs" / "reference" / "matlab.md").read_text(encoding="utf-8")
CALLS = re.findall(r"`((?:of|np)\..+?)`", SECTION)


@pytest.fixture(scope="module")
def names() -> dict[str, object]:
    """What the calls of the table refer to."""
    import orbitfinder as of

    model = of.chain(3)
    state = np.array([0.21, 0.23, -1.45, -0.32, 0.15, 1.66])
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, 1.65), of.pin(energy=-38.35)))
    points = of.positions(model, orbit.samples)
    return {
        "of": of, "np": np, "model": model, "n": 5, "states": orbit.samples, "orbit": orbit,
        "x": orbit.state, "T": orbit.period, "times": orbit.times, "points": points,
    }  # fmt: skip


def test_every_function_of_the_report_has_its_row() -> None:
    """All ten MATLAB functions are named."""
    rows = set(re.findall(r"^\| `(\w+)`", SECTION, flags=re.MULTILINE))
    assert rows == {
        "animatePendulum", "animatePendulumDAE", "createFunction4BarLinkage", "createFunctionPendulum3_DAE",
        "createFunctionPendulum3_NE", "createFunctionPendulumN_Lagrange", "energyPendulum", "errorNorm",
        "MAE5730_Final_Project", "thetas2pos",
    }  # fmt: skip


@pytest.mark.parametrize("call", CALLS)
def test_the_call_works(call: str, names, tmp_path, monkeypatch) -> None:
    """Each one-line call of the table runs and returns something."""
    monkeypatch.chdir(tmp_path)
    assert eval(call, dict(names)) is not None


def test_the_error_norm_of_an_orbit_is_small(names) -> None:
    """`errorNorm` of a certified orbit is CVODES' own error."""
    call = next(call for call in CALLS if "norm" in call)
    assert eval(call, dict(names)) < 1e-9
