"""Every problem file in problems/ converges, certifies and lands on the period it announces."""

from pathlib import Path

import pytest

from orbitfinder.atlas.choose import solve
from orbitfinder.problemfile.read import load_problem, load_problem_file

FOLDER = Path(__file__).parents[1] / "problems"
FILES = sorted(path for room in ("report", "examples", "gallery", "hybrid") for path in (FOLDER / room).glob("*.toml"))
REPORT = {
    "triple-1": 1.65533898831464,
    "triple-2": 2.92523733309107,
    "quadruple-1": 1.41124966707868,
    "quadruple-2": 0.79801111165891,
}


LONG = {"double-least-unstable", "five-link-walker", "kneed-walker", "simplest-walker-period-4",
        "double-stablest-swing", "slip-runner-stable", "simplest-walker-period-2", "slip-walker",
        "gravity-wedge", "vertical-hopper", "simplest-walker-long", "double-gentlest-length",
        "wall-pendulum", "forced-duffing-middle", "quintuple-mode-2", "impact-oscillator-near-grazing",
        "figure-eight-turning", "fermi-pasta-ulam", "double-widest-swing", "compass-gait-without-hip",
        "figure-eight-reduced", "van-der-pol-relaxation", "cart-chain-three"}  # fmt: skip
"""Files that take longest, or are like others in what they ask for"""


@pytest.mark.parametrize(
    "path", [pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem in LONG)) for path in FILES]
)
def test_problem_file_certifies(path):
    """[expected] is part of the certificate, so a wrong orbit does not pass."""
    loaded = load_problem_file(path)
    problem = loaded.wanted
    assert problem.name == path.stem and problem.title and problem.source
    assert "period" in problem.expected, "every shipped problem announces its period"
    orbit = solve(problem, loaded.starts, loaded.seed)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.closure <= 1e-12 * orbit.certificate.scale
    if path.stem in REPORT:
        assert orbit.closure <= 1e-12
        assert orbit.period == pytest.approx(REPORT[path.stem], abs=1e-10)
        assert orbit.pair_defect <= 1e-8


def test_the_files_cover_what_they_should():
    """n = 1 to 5, unequal links, a brake orbit, a running orbit, a freed parameter, a choice."""
    problems = [load_problem(path) for path in FILES]
    assert {one.model.degrees_of_freedom for one in problems} >= {1, 2, 3, 4, 5}
    assert any(len(set(one.model.system["length"])) > 1 for one in problems)
    assert any(one.symmetry == "brake" for one in problems)
    assert any(one.turns.any() for one in problems)
    assert any(one.free for one in problems)
    assert {one.objective for one in problems} >= {"nearest", "min_instability", "max_amplitude", "min_peak_rate"}
    assert REPORT.keys() <= {one.name for one in problems}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_problem_file_says_why(path):
    """Each begins with a comment paragraph that names the expected period."""
    comment = path.read_text(encoding="utf-8").split("\nname = ")[0]
    assert comment.startswith("# ") and "Expected period" in comment.replace("\n# ", " ")
