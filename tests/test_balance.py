"""Harmonic balance: against exact solutions, shooting, other programs and the certificates' integrators."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq, linear_sum_assignment, root
from scipy.special import ellipk

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError, OrbitfinderError
from orbitfinder.families import balance
from orbitfinder.families.branches import left_at
from orbitfinder.families.curves import curves_through
from orbitfinder.families.happening import facts
from orbitfinder.families.members import extents
from orbitfinder.families.verified import verified
from orbitfinder.integrate.residual import Residual
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.orbits import harmonics, hill, implicit
from orbitfinder.orbits.balance import begun, freed, states_of
from orbitfinder.orbits.decay import decay
from orbitfinder.orbits.hill import exponents
from orbitfinder.orbits.implicit import gathered
from orbitfinder.orbits.method import method_of

ROAD = {entry["id"]: entry for entry in json.loads((Path(__file__).parent / "data" / "road.json").read_text())}
BALANCE = of.SolveSettings(method="balance")


def masses(count, frequency, damping=0.02, cubic=0.1):
    """The forced chain of road.json."""
    rows = sparse.diags([-np.ones(count - 1), 2 * np.ones(count), -np.ones(count - 1)], offsets=[-1, 0, 1])
    springs = {f"s{i}": {"kind": "cubic", "at": f"q{i}", "to": f"q{i - 1}", "stiffness": "cubic"}
               for i in range(2, count + 1)}  # fmt: skip
    springs |= {name: {"kind": "cubic", "at": at, "stiffness": "cubic"}
                for name, at in (("s1", "q1"), ("wall", f"q{count}"))}  # fmt: skip
    one = sparse.eye(count)
    load = {"at": "q1", "amplitude": 0.3, "frequency": frequency}
    model = of.structure(one, damping * one, rows, springs, load, parameters={"cubic": cubic})
    return of.Problem(model, of.guesses.linear_response(model), name="masses")


def duffing(frequency=0.6, **numbers):
    model = of.systems.forced_duffing(frequency=frequency, **numbers)
    return of.Problem(model, of.guesses.linear_response(model), name="duffing")


def test_a_linear_motion_is_its_linear_response():
    """Exact: x = Re (1 - w^2 + i c w)^-1 e^(i w t), and multipliers exp of the eigenvalues times the period."""
    orbit = of.find_orbit(duffing(1.3, cubic=0.0, force=0.2, damping=0.05), BALANCE)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.provenance["method"] == "balance"
    answer = 0.2 / (1 - 1.3**2 + 0.05j * 1.3)
    assert orbit.state == pytest.approx([answer.real, -1.3 * answer.imag], rel=1e-13)
    moduli = np.exp(-0.025 * orbit.period)
    assert np.abs(orbit.floquet_multipliers) == pytest.approx([moduli, moduli], rel=1e-9)


def test_products_of_many_orders_are_made_when_they_are_wanted(monkeypatch):
    """A table of them took 8 GB of two masses at a stop; without it the slopes are the same."""
    point = begun(duffing(), "frequency")
    balanced, w = point.problem, point.w
    _, varying, *_ = balanced.sampled(w)
    monkeypatch.setattr(harmonics, "TABLED", 0)
    fixed, made = balanced.equations.fixed(balanced.values(w)), harmonics.Pattern(balanced.equations, balanced.basis)
    assert made.products == [None] * 3 and balanced.pattern.products[0] is not None
    theirs, ours = (pattern.matrix(fixed, varying).toarray() for pattern in (balanced.pattern, made))
    assert np.abs(ours - theirs).max() < 1e-13 * np.abs(theirs).max()


def test_shooting_finds_the_same_motion():
    """Two discretisations agree to 1e-9, state and multipliers."""
    problem = duffing(1.5, force=0.3)
    one = of.find_orbit(problem, BALANCE)
    other = of.find_orbit(replace(problem, guess=of.Guess(one.state, one.period)))
    assert one.certificate.passed
    assert one.state == pytest.approx(other.state, abs=1e-9)
    assert np.sort_complex(one.floquet_multipliers) == pytest.approx(
        np.sort_complex(other.floquet_multipliers), abs=1e-8
    )


@pytest.fixture(scope="module")
def resonance(tmp_path_factory):
    """Duffing's resonance curve from a problem file by commands, with where it is."""
    folder = tmp_path_factory.mktemp("balance")
    file = folder / "duffing.toml"
    file.write_text('name = "duffing"\n[system]\nkind = "python"\nfunction = "forced_duffing"\n'
                    "arguments = { force = 0.3, frequency = 1.2 }\n[guess]\nlinear = true\n"
                    '[find]\nmethod = "balance"\n')  # fmt: skip
    command = ["continue", str(file), "--parameter", "frequency", "--until", "2.0", "--at", "1.7", "--out", str(folder),
               "--no-figures"]  # fmt: skip
    answer = CliRunner().invoke(cli, command)
    assert answer.exit_code == 0, answer.output
    return folder, command, answer.output


def test_a_resonance_curve_is_that_of_shooting(resonance):
    """Both folds to 1e-10 and their error bars; orbits asked for, certified; stability changes at folds."""
    family = of.load_family(resonance[0] / "duffing" / "family.json")
    first = of.Guess(family.points[0].state, family.points[0].period)
    shot = of.follow_family(replace(duffing(1.2, force=0.3), guess=first), "frequency", until=2.0)
    folds, others = ([each for each in one.events if each.kind == "fold"] for one in (family, shot))
    assert len(folds) == len(others) == 2
    for one, other in zip(folds, others, strict=True):
        assert one.parameter == pytest.approx(other.parameter, abs=1e-10)
        assert abs(one.parameter - other.parameter) <= 3 * (one.error + other.error)
        assert one.certified
    changes = [event for event in family.events if event.kind == "stability_change"]
    assert [event.parameter for event in changes] == [event.parameter for event in folds]
    assert len([point for point in family.points if point.value == 1.7 and point.certified]) == 3
    assert family.curve["method"] == "balance"
    assert max(point.closure for point in family.points) < 1e-11


def test_it_is_read_again_verified_and_drawn(resonance):
    """The command again reads; more points go on; `verify` of the family and a point, `show` and `plot` take it."""
    folder, command, _ = resonance
    file = folder / "duffing" / "family.json"
    before = file.read_bytes()
    again = CliRunner().invoke(cli, command)
    assert again.exit_code == 0
    assert file.read_bytes() == before
    drawn = ["plot", str(file), "-o", str(folder / "p")]
    for told in (["verify", str(file), f"{file}#4"], ["show", str(file)], drawn):
        answer = CliRunner().invoke(cli, told)
        assert answer.exit_code == 0, answer.output
    assert list((folder / "p").glob("*.png"))


def test_a_run_that_was_cut_goes_on_where_it_stopped(tmp_path):
    """The journal's last line cut off gives the same family, and what was done is not done again."""
    given = {"until": 1.5, "settings": of.FamilySettings(method="balance", events=False, certify=False)}
    whole = of.follow_family(duffing(), "frequency", out=tmp_path, **given)
    journal = tmp_path / "duffing" / "balance.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[: len(lines) // 2]) + lines[len(lines) // 2][:40])
    again = of.follow_family(duffing(), "frequency", out=tmp_path, **given)
    assert np.array_equal(again.values("value"), whole.values("value"))
    assert np.array_equal(again.values("closure"), whole.values("closure"))


def test_a_journal_of_a_large_family_keeps_its_series(tmp_path):
    """States of 41 masses that the series tells are not written down, and are the same when they are read."""
    given = {"until": 0.0802, "settings": of.FamilySettings(method="balance", events=False, certify=False)}
    whole = of.follow_family(masses(41, 0.08, damping=0.002), "frequency", out=tmp_path, **given)
    (journal,) = tmp_path.rglob("balance.jsonl")
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    orbits = [line["step"]["orbit"] for line in lines if "step" in line]
    assert len(orbits) > 1 and all(len(orbit["nodes"]) == 1 for orbit in orbits)
    again = of.follow_family(masses(41, 0.08, damping=0.002), "frequency", out=tmp_path, **given)
    assert len(again.points) == len(whole.points) > 1
    for first, second in zip(whole.points, again.points, strict=True):
        assert len(first.shooting_nodes) > 1
        assert np.array_equal(first.shooting_nodes, second.shooting_nodes)


def test_more_orders_converge_geometrically():
    """What the next orders add falls by the same factor again and again, and no more are taken than tell it."""
    point = begun(duffing(0.6, force=0.5), "frequency")
    highest = max(point.problem.basis.orders)
    assert point.problem.left(point.w)[0] < 3e-14
    coefficients = np.hypot(*point.problem.coefficients(point.w)[0].reshape(-1, 2).T)
    assert coefficients[-1] < 1e-12 * coefficients[0]
    assert 9 < highest < 40


@pytest.fixture(scope="module")
def chain():
    """The chain of 100 masses from road.json's first frequency to its last, each in between exactly."""
    first, *rest = ROAD["chain-100"]["values"]
    settings = of.FamilySettings(method="balance")
    at = [known["w"] for known in rest[:-1]]
    return of.follow_family(masses(100, first["w"]), "frequency", until=rest[-1]["w"], at=at, settings=settings)


@pytest.mark.slow
def test_amplitudes_of_100_masses_are_those_of_another_program(chain):
    """The first harmonic of the first mass to 13 digits; orbits asked for are certified by implicit steps."""
    assert [end.kind for end in chain.ends] == ["target"]
    for known in ROAD["chain-100"]["values"]:
        (point,) = (point for point in chain.points if point.value == known["w"])
        first = np.abs(np.fft.rfft(point.shooting_nodes[:, 0])[1]) * 2 / len(point.shooting_nodes)
        assert first == pytest.approx(float(known["first_harmonic_x1_H15"]), rel=1e-13)
        assert point.stability == "asymptotically stable"
    assert chain.points[0].certified
    assert chain.points[-1].certified


@pytest.mark.slow
def test_planted_errors_of_a_large_family_are_rejected(chain):
    """A state, a parameter, a verdict and an end that are wrong, each by a check of its name."""
    point, model = chain.points[-1], masses(100, 0.03).model
    there = with_parameters(model, point.free)
    assert of.certify(point, there).passed
    moved = replace(point, state=point.state * (1 + 1e-6), nodes=point.nodes * (1 + 1e-6))
    assert "closure" in of.certify(moved, there).failures
    assert "stability" in of.certify(replace(point, stability="unstable"), there).failures
    assert "energy" in of.certify(replace(point, energy=1.01 * point.energy), there).failures
    assert all(check.passed for _, check in verified(chain, model))
    assert extents(chain, model)[-1, 1, 0] == pytest.approx(
        float(ROAD["chain-100"]["values"][-1]["amp_x1_H15"]), rel=1e-4
    )
    wrong = replace(chain, ends=(replace(chain.ends[0], reason="reached frequency = 0.0331"),))
    assert [check.name for _, check in verified(wrong, model) if not check.passed] == ["target"]


@pytest.mark.slow
def test_a_torus_of_many_coordinates_is_not_missed():
    """41 lightly damped masses past a torus bifurcation: the few exponents that Hill's matrix finds are among all that
    the certificate's integrator does, the one that grows first."""
    problem = masses(41, 0.225, damping=0.0005)
    point = begun(problem, "frequency")
    about = exponents(point.problem, point.w)
    assert about.stability == "unstable"
    assert abs(about.values[0].imag) > 0.01
    assert decay(point.problem, point.w).rate == 0
    seen = gathered(problem.model, states_of(point, np.zeros(1))[0], 2 * np.pi / 0.225)[0]
    assert seen.floquet.stability == "unstable"
    growing = about.multipliers[np.abs(about.multipliers) > 1]
    assert np.sort_complex(growing) == pytest.approx(
        np.sort_complex(seen.floquet.multipliers[np.abs(seen.floquet.multipliers) > 1]), abs=1e-6
    )


def test_what_does_not_grow_is_bounded(monkeypatch):
    """All 82 multipliers of 41 masses at rest from resonances are within the bound, and the verdict needs no other."""
    problem = masses(41, 0.08, damping=0.002)
    point = begun(problem, "frequency")
    monkeypatch.setattr(hill, "ALL", 40)
    about = exponents(point.problem, point.w)
    assert (about.values.size, about.stability) == (0, "asymptotically stable")
    seen = gathered(problem.model, states_of(point, np.zeros(1))[0], 2 * np.pi / 0.08)[0]
    assert np.log(np.abs(seen.floquet.multipliers)).max() / (2 * np.pi) <= about.rest + 1e-9


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(
    ("stiffness", "damping", "stable"),
    [
        ([3.6, 3.8], [[0.1, 0.5], [0.5, 0.1]], False),  # each mode alone is damped, both together grow
        ([3.6, 3.6], [[0.1, -0.1], [-0.1, 0.1]], False),  # a damper between twins leaves their common motion alone
        ([3.6, 4.6], [[0.1, -0.1], [-0.1, 0.1]], True),
    ],
)
def test_dampers_that_couple_modes_are_not_taken_for_each_modes_own(stiffness, damping, stable, many, monkeypatch):
    """As large structures are judged; of linear oscillators the truth is an eigenvalue problem."""
    monkeypatch.setattr(hill, "ALL", 0)
    monkeypatch.setattr(hill, "MOST_MODES", 1 if many else 400)
    monkeypatch.setattr(hill, "MODES", 1)
    load = {"at": "q1", "amplitude": 0.1, "frequency": 0.5}
    model = of.structure(np.eye(2), damping, np.diag(stiffness), {}, load)
    whole = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(stiffness), -np.array(damping)]])
    assert (np.linalg.eigvals(whole).real.max() < -1e-9) == stable
    point = begun(of.Problem(model, of.guesses.linear_response(model), name="two"), "frequency")
    verdict = exponents(point.problem, point.w).stability
    assert verdict == "asymptotically stable" if stable and not many else verdict != "asymptotically stable"


@pytest.mark.parametrize("frequency", [0.2, 1.1])
def test_an_energy_bounds_all_exponents(frequency):
    """Of six masses, the rate that an energy proves is below that of all exponents, and near it where damped well."""
    for damping in (0.004, 0.05, 0.4):
        point = begun(masses(6, frequency, damping), "frequency")
        about, proof = exponents(point.problem, point.w), decay(point.problem, point.w)
        rate, why = proof.rate, proof.why
        assert bool(rate > 0) == (why == "")
        assert rate <= -about.values.real.max()
        if damping == 0.4:
            assert rate > -0.4 * about.values.real.max()


def test_what_is_linear_is_summed_and_carried_once(monkeypatch):
    """A rod of 40 masses with a cubic spring at its end: the residual is that of its matrices, its slope by the drive's
    frequency too; multipliers are those of variations that are solved for in every step, and as many as damping says.
    """
    rod = 2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    spring, load = {"at": "q40", "kind": "cubic", "stiffness": 5.0}, {"at": "q40", "amplitude": 0.3, "frequency": 0.4}
    model = of.structure(np.eye(40), 0.02 * np.eye(40), rod, {"end": spring}, load)
    residual, random = Residual(model, ("frequency",)), np.random.default_rng(0)
    times, (q, v, a), w = random.uniform(0, 6, 5), random.normal(size=(3, 40, 5)), 0.07
    rows, _, change = residual.over(times, [q, v, a], np.array([w]))
    expected = w**2 * a + 0.02 * w * v + rod @ q
    expected[-1] += 5 * q[-1] ** 3 - 0.3 * np.cos(times)
    assert rows == pytest.approx(expected, abs=1e-13) == residual.rows(times, [q, v, a], np.array([w]))
    assert change == pytest.approx(2 * w * a + 0.02 * v, abs=1e-13)
    point = begun(of.Problem(model, of.guesses.linear_response(model)), "frequency")
    given = model, states_of(point, np.zeros(1))[0], 2 * np.pi / 0.4
    once = gathered(*given)[0].floquet.multipliers
    monkeypatch.setattr(implicit, "FEW", 0.0)
    whole = gathered(*given)[0].floquet.multipliers
    assert np.abs(once[:, None] - whole).min(axis=0).max() < 1e-12
    assert np.log(np.abs(once)).sum() == pytest.approx(-40 * 0.02 * given[2], rel=1e-9)


def test_an_energy_bounds_how_far_the_true_orbit_is():
    """Of six masses off their orbit by 1e-7 the bound holds and is of use; all variations say the same."""
    problem = masses(6, 0.2, 0.4)
    state, period = states_of(begun(problem, "frequency"), np.zeros(1))[0], 2 * np.pi / 0.2
    moved = state + 1e-7 * np.abs(state).max() * np.cos(np.arange(12.0))
    (few, second), (whole, same) = (gathered(problem.model, moved, period, damped) for damped in (True, False))
    assert (few.floquet.multipliers.size, whole.floquet.multipliers.size, second) == (0, 12, same)
    assert few.floquet.stability == whole.floquet.stability == "asymptotically stable"
    assert few.closes.gap == whole.closes.gap > 1e-9
    assert few.closes.amplification <= whole.closes.amplification
    assert whole.closes.distance <= few.closes.distance < 30 * whole.closes.distance


@pytest.mark.slow
def test_a_thousand_masses_are_followed_and_certified_from_the_command_line(tmp_path):
    """By the proof of their verdict no variation is carried; a verdict, a state and a closure that are wrong fail."""
    system = masses(1000, 0.03).model.system
    for name in ("mass", "damping", "stiffness"):
        (tmp_path / f"{name}.mtx").write_text(system[name])
    tables = {"forcing": system["forcing"]} | {f"elements.{name}": each for name, each in system["elements"].items()}
    lines = ["[system]", 'kind = "structure"', "parameters = { cubic = 0.1 }"]
    lines += [f'{name} = "{name}.mtx"' for name in ("mass", "damping", "stiffness")]
    for name, table in tables.items():
        lines += [f"[system.{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    text = "\n".join(['name = "masses"', *lines, "[guess]", "linear = true", "[find]", 'method = "balance"'])
    (tmp_path / "masses.toml").write_text(text)
    command = ["continue", str(tmp_path / "masses.toml"), "--parameter", "frequency", "--until", "0.0301"]
    answer = CliRunner().invoke(cli, [*command, "--no-figures", "--out", str(tmp_path)])
    assert answer.exit_code == 0, answer.output
    family = of.load_family(tmp_path / "masses" / "family.json")
    assert [end.kind for end in family.ends] == ["target"]
    assert family.points[0].certified and family.points[-1].certified
    last = family.points[-1]
    wrong = replace(last, stability="unstable", state=last.state * (1 + 1e-7), nodes=last.nodes * (1 + 1e-7))
    assert {"stability", "closure", "distance", "energy"} <= set(of.certify(wrong).failures)


def test_an_energy_takes_gyroscopic_forces():
    """Exact: exponents of a linear rotor."""
    stiffness, turn = np.diag([1.0, 2.0, 3.0]), np.array([[0.0, 1, 0], [-1, 0, 1], [0, -1, 0]])
    damping, load = 0.2 * np.eye(3) + 0.5 * turn, {"at": "q1", "amplitude": 0.1, "frequency": 0.5}
    model = of.structure(np.eye(3), damping, stiffness, {}, load)
    point = begun(of.Problem(model, of.guesses.linear_response(model), name="rotor"), "frequency")
    whole = np.block([[np.zeros((3, 3)), np.eye(3)], [-stiffness, -damping]])
    slowest = -np.linalg.eigvals(whole).real.max() / 0.5
    assert 0.5 * slowest < decay(point.problem, point.w).rate < slowest


@pytest.mark.slow
def test_slow_modes_of_many_coordinates_tell_as_all_do(monkeypatch):
    """What may grow of 41 masses is found from 30 slow modes as from all; where averaging does not tell it says why."""
    point = begun(masses(41, 0.225, damping=0.001), "frequency")
    monkeypatch.setattr(hill, "ALL", 40)
    known = exponents(point.problem, point.w)
    monkeypatch.setattr(hill, "MOST_MODES", 40)
    for modes in (30, 10):
        monkeypatch.setattr(hill, "MODES", modes)
        point.w.known.pop("exponents")
        few = exponents(point.problem, point.w)
        assert few.values[0] == pytest.approx(known.values[0], abs=1e-9)
        assert few.stability == "undecided"
        assert ("the next order of averaging is 1.1 of the first" if modes == 30 else "modes than 10 may") in few.why


def test_a_verdict_of_450_masses_is_proved():
    """Overdamped slow modes: the rate is below that of the slowest, c / 2 - sqrt(c^2 / 4 - k), and near it."""
    point = begun(masses(450, 0.03), "frequency")
    about = exponents(point.problem, point.w)
    assert about.stability == "asymptotically stable"
    slowest = (np.sqrt(1e-4 - 4 * np.sin(np.pi / 902) ** 2) - 0.01) / 0.03
    assert slowest < about.rest < 0.5 * slowest


def test_a_march_of_order_twelve_finds_all_exponents():
    """Of a linear oscillator: -c / 2 +- i sqrt(1 - c^2 / 4), in units of the frequency."""
    point = begun(duffing(1.3, cubic=0.0, damping=0.1), "frequency")
    exact = np.exp((-0.05 + 1j * np.sqrt(1 - 0.05**2) * np.array([1, -1])) * 2 * np.pi / 1.3)
    multipliers = exponents(point.problem, point.w).multipliers
    assert np.sort_complex(multipliers) == pytest.approx(np.sort_complex(exact), abs=1e-9)


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (lambda: of.Problem(of.systems.van_der_pol(), of.Guess([2.0, 0.0], 6.6)), "keeps no energy"),
        (lambda: replace(duffing(), free=("force",)), "frees force and pins nothing"),
    ],
)
def test_what_it_is_not_for_is_said(problem, words):
    with pytest.raises(OrbitfinderError, match=words):
        of.find_orbit(problem(), BALANCE)


def test_messages_of_families():
    settings = of.FamilySettings(method="balance")
    with pytest.raises(InputError, match="stop, between, beside: not by balance"):
        of.follow_family(duffing(), "frequency", settings=settings, between=(0.1, 0.2))
    with pytest.raises(InputError, match="unknown 'balanced', did you mean 'balance'"):
        of.follow_family(duffing(), "frequency", settings=of.FamilySettings(method="balanced"))
    with pytest.raises(InputError, match="directions"):
        of.follow_family(duffing(), "frequency", settings=replace(settings, directions="up"))


@pytest.mark.slow
def test_the_beam_of_the_problem_file_is_certified():
    """200 coordinates, stiff: its samples lie on the certificate's motion, and a state a little off is no orbit."""
    orbit = of.find_orbit(of.load_problem(Path("problems/structures/beam.toml")))
    assert orbit.certificate.passed and orbit.stability == "asymptotically stable"
    moved = replace(orbit, state=orbit.state * (1 + 1e-5))
    assert {"closure", "distance"} & set(of.certify(moved).failures)


def free_duffing_period(amplitude):
    """Exact: of x'' + x + x^3 = 0 from rest at an amplitude, 4 K(m) / sqrt(1 + a^2), m = a^2 / 2 (1 + a^2)."""
    return 4 * ellipk(amplitude**2 / (2 * (1 + amplitude**2))) / np.sqrt(1 + amplitude**2)


@pytest.fixture(scope="module")
def free():
    """Two masses whose first spring is cubic: the family of the second mode in the energy."""
    model = of.structure(np.eye(2), None, [[2.0, -1], [-1, 2]], {"c": {"kind": "cubic", "at": "q1", "stiffness": 0.5}})
    problem = of.Problem(model, of.guesses.normal_mode(model, 1, 0.3), of.pin(energy=0.2), name="two masses")
    watch = {"first": "amplitude(q1, 1)", "third": "amplitude(q1, 3)"}
    settings = of.FamilySettings(method="balance")
    return problem, of.follow_family(problem, "energy", until=42.0, settings=settings, watch=watch)


def test_free_modes_are_those_of_shooting(free):
    """The orbit, its family's resonances and its branch point with their errors, and stability; certified."""
    problem, family = free
    shot = of.find_orbit(problem)
    balanced = of.find_orbit(problem, BALANCE)
    assert balanced.certificate.passed and balanced.stability == shot.stability == "elliptic"
    assert balanced.period == pytest.approx(shot.period, rel=1e-13)
    assert balanced.action == pytest.approx(shot.action, rel=1e-11)
    others = of.follow_family(shot, "energy", until=42.0)
    kinds = [[event.kind for event in each.events] for each in (family, others)]
    assert kinds[0] == kinds[1] == ["resonance"] * 3 + ["branch_point", "stability_change"]
    for event, other in zip(family.events, others.events, strict=True):
        assert abs(event.parameter - other.parameter) <= 3 * (event.error + other.error)
        assert event.certified
    assert family.ends[0].kind == "target" and family.points[-1].certified
    assert family.points[-1].value == pytest.approx(42.0, rel=1e-13)
    ratio = family.values("third") / family.values("first")
    assert np.all(np.diff(ratio) > 0)


def test_a_backbone_is_near_the_free_motions():
    """Phase resonance of the driven Duffing oscillator to 1e-9; its frequencies are those of free motions of the same
    amplitude to the square of the damping, both ways of finding which are exact but for it."""
    off = []
    for damping in (0.02, 0.04):
        model = of.systems.forced_duffing(frequency=1.05, force=damping / 2, damping=damping)
        guess = of.guesses.linear_response(model)
        problem = of.Problem(model, guess, of.pin(phase_x=-np.pi / 2), free=("frequency",), method="balance")
        watch = {"lag": "phase(x, 1)", "top": "max(x)", "rate": "amplitude(xdot, 1) / amplitude(x, 1)"}
        settings = of.FamilySettings(method="balance", events=False)
        backbone = of.follow_family(problem, "force", until=2 * damping, settings=settings, watch=watch)
        assert backbone.values("lag") == pytest.approx(-np.pi / 2, abs=1e-9)
        assert backbone.values("rate") == pytest.approx(backbone.values("frequency"), rel=1e-9)
        assert backbone.points[0].certified and backbone.points[-1].certified
        free = 2 * np.pi / free_duffing_period(backbone.values("top")[-1])
        off.append(abs(backbone.values("frequency")[-1] / free - 1))
    assert off[0] < 1e-3
    assert off[1] / off[0] == pytest.approx(4.0, rel=0.3)


def row(count, mode, amplitude):
    """A mode of masses between walls, springs of force d + d^3, with an amplitude of the first mass."""
    rows = sparse.diags([-np.ones(count - 1), 2 * np.ones(count), -np.ones(count - 1)], offsets=[-1, 0, 1])
    springs = {f"s{i}": {"kind": "cubic", "at": f"q{i}", "to": f"q{i - 1}", "stiffness": 1.0}
               for i in range(2, count + 1)}  # fmt: skip
    springs |= {at: {"kind": "cubic", "at": at, "stiffness": 1.0} for at in ("q1", f"q{count}")}
    model = of.structure(sparse.eye(count), None, rows, springs)
    shape = np.sin(np.pi * mode / (count + 1))
    guess = of.guesses.normal_mode(model, mode, amplitude / shape)
    return of.Problem(model, guess, of.pin(q1=amplitude), name="row", method="balance")


def scalar_traces(count, amplitude):
    """Of the middle mode of an odd number: it is a of a'' + 2 a + 2 a^3 = 0 in every other mass, and beside it each
    other linear mode alone moves by b'' + w^2 (1 + 3 a^2) b = 0; the traces of their monodromies, and the period."""
    modes = np.delete(np.arange(1, count + 1), count // 2)
    squares = 4 * np.sin(np.pi * modes / (2 * count + 2)) ** 2
    period = free_duffing_period(amplitude) / np.sqrt(2)

    def rates(_, y):
        (a, v), (b, c) = y[:2], y[2:].reshape(2, -1)
        return np.concatenate([[v, -2 * a - 2 * a**3], c, -np.tile(squares, 2) * (1 + 3 * a**2) * b])

    unit = np.repeat([1.0, 0.0, 0.0, 1.0], modes.size)
    answer = solve_ivp(rates, (0, period), [amplitude, 0, *unit], method="DOP853", rtol=1e-12, atol=1e-14).y[2:, -1]
    first, _, _, last = answer.reshape(4, -1)
    return first + last, period


@pytest.mark.parametrize(("amplitude", "told"), [(0.22, "elliptic"), (0.3, "unstable")])
def test_all_multipliers_of_a_free_mode_of_41_masses_are_known(amplitude, told, monkeypatch):
    """By scalar equations of another integrator, to 1e-10; where too many steps would be needed those that grow are, by
    Hill's matrix, and else nothing is claimed."""
    point = begun(row(41, 21, amplitude), "")
    traces, period = scalar_traces(41, amplitude)
    about = exponents(point.problem, point.w)
    assert 2 * np.pi / point.w.vector[-1] == pytest.approx(period, rel=1e-13)
    assert np.sort(about.whole.indices.real) == pytest.approx(np.sort(traces), abs=1e-10)
    assert about.stability == told == ("unstable" if traces.max() > 2 else "elliptic")
    assert (about.root, about.multipliers.size) == (2, 80)
    monkeypatch.setattr(hill, "MOST_STEPS", 8)
    point.w.known.pop("exponents")
    few, grows = exponents(point.problem, point.w), np.abs(np.abs(about.multipliers) - 1) > 1e-6
    assert np.sort_complex(few.multipliers) == pytest.approx(np.sort_complex(about.multipliers[grows]), abs=1e-8)
    assert few.stability == ("unstable" if told == "unstable" else "undecided")
    assert few.why == ("" if told == "unstable" else "nothing damps it; its modes ask for over 8 steps")


@pytest.mark.slow
def test_a_free_mode_of_twelve_masses_is_that_of_shooting():
    """All multipliers by three ways to 1e-8, in reciprocal pairs, of a stable and of an unstable motion."""
    for mode, amplitude, told in ((1, 0.05, "elliptic"), (3, 1.0, "unstable")):
        problem = row(12, mode, amplitude)
        one = of.find_orbit(problem)
        other = of.find_orbit(replace(problem, guess=of.Guess(one.state, one.period), method=None))
        point = begun(problem, "")
        states = states_of(point, np.zeros(1))[0]
        third = gathered(problem.model, states, one.period)[0].floquet
        assert one.certificate.passed and one.stability == other.stability == third.stability == told
        for floquet in (other.floquet_multipliers, third.multipliers):
            gaps = np.abs(one.floquet_multipliers[:, None] - floquet)
            assert gaps[linear_sum_assignment(gaps)].max() < 1e-8
        gaps = np.abs(one.floquet_multipliers[:, None] * one.floquet_multipliers - 1)
        assert gaps.min(axis=1).max() < 1e-9


@pytest.mark.slow
def test_a_mode_of_many_coordinates_loses_its_stability_where_it_must(monkeypatch):
    """By the problem file of 41 masses: the amplitude to 1e-10 of the scalar equations', certified; wrong verdicts and
    events are rejected, and so is a verdict of a certificate whose steps do not follow the fastest mode."""
    problem = of.load_problem(Path("problems/structures/row-41.toml"))
    family = of.follow_family(problem, "q1", until=0.35)
    branch, change = family.events
    exact = brentq(lambda amplitude: scalar_traces(41, amplitude)[0].max() - 2, 0.2, 0.3, xtol=1e-14)
    assert (branch.kind, change.kind, change.detail) == ("branch_point", "stability_change", "becomes unstable")
    assert abs(branch.parameter - exact) <= max(branch.error, 1e-12) and branch.error < 1e-11  # it was said to be 8e-8
    assert branch.certified
    assert all(point.stability == ("elliptic" if point.value < exact else "unstable") for point in family.points)
    assert all(check.passed for _, check in verified(family, problem.model))
    wrong = replace(family, events=(replace(branch, multiplier=1j),))
    assert [check.name for _, check in verified(wrong, problem.model) if not check.passed] == ["branch_point"]
    first, last = family.points[0], family.points[-1]
    assert of.certify(last).passed
    for point, claimed in ((first, "unstable"), (last, "elliptic")):
        assert of.certify(replace(point, stability=claimed)).failures == ("stability",)
    monkeypatch.setattr(implicit, "FREE", 4)
    assert "stability" in of.certify(first).failures
    assert "stability" not in of.certify(last).failures


def test_nothing_is_suggested_that_a_large_family_cannot_do(tmp_path, capfd):
    """`show`, `continue` and pages offered --switch and --curve at its events, which both refuse it."""
    words = ("continue", "problems/structures/row-41.toml", "--parameter", "q1", "--until", "0.35", "--no-figures")
    done = CliRunner().invoke(cli, [*words, "-o", str(tmp_path)])
    file = tmp_path / "row-41" / "family.json"
    shown = done.output + capfd.readouterr().err
    assert done.exit_code == 0 and "branch point at q1" in shown and "--switch" not in shown
    said = CliRunner().invoke(cli, ["show", str(file)]).output
    assert "--switch" not in said and "what leads on from it is not known by balance of many coordinates" in said
    family = of.load_family(file)
    assert family.events[0].kind == "branch_point" and not left_at(family) and not curves_through(family)
    with pytest.raises(InputError, match="balance of many coordinates knows no branches and curves"):
        of.switch_branch(family, 0)
    fold = replace(family, events=(replace(family.events[0], kind="fold"),))
    assert not facts(fold)["events"][0].follow
    with pytest.raises(InputError, match="event: no curve leads|knows no branches and curves"):
        of.follow_curve(fold, 0, ("cubic", "energy"))
    done = CliRunner().invoke(cli, ["continue", str(file)])
    assert done.exit_code == 2 and "give the event to leave row-41 at: none" in done.stderr


@pytest.mark.slow
def test_pairs_of_many_coordinates_that_meet_are_located():
    """Two pairs of the second mode of 41 masses meet and leave the circle: between orbits of both verdicts, by balance
    and by the certificate's steps, that are near."""
    problem = row(41, 2, 0.02)
    family = of.follow_family(problem, "energy", until=0.05)
    (meeting,) = [event for event in family.events if event.kind == "collision"]
    other_steps = of.FamilySettings(first_step=0.03, longest_step=0.2)
    again = of.follow_family(problem, "energy", until=0.05, settings=other_steps)
    (other,) = [event for event in again.events if event.kind == "collision"]
    assert abs(meeting.parameter - other.parameter) <= meeting.error + other.error < 1e-11  # said to be 5e-8
    assert all(check.passed for _, check in verified(family, problem.model))
    for aside, told in ((-1e-4, "elliptic"), (1e-4, "unstable")):
        near = replace(problem, pin=of.pin(energy=meeting.parameter * (1 + aside)),
                       guess=of.Guess(meeting.state, meeting.period))  # fmt: skip
        point = begun(near, "")
        assert exponents(point.problem, point.w).stability == told
        seen = gathered(problem.model, states_of(point, np.zeros(1))[0], 2 * np.pi / point.w.vector[-1])[0]
        assert seen.floquet.stability == told


@pytest.mark.slow
def test_a_doubling_of_many_coordinates_is_that_of_few():
    """An oscillator with a stop beside 40 others that it does not touch doubles its period where it does alone."""
    found = []
    for count in (1, 41):
        damping, stiffness = np.diag([0.1] + [0.5] * (count - 1)), np.diag(np.arange(1.0, count + 1))
        stop = {"s": {"kind": "stop", "at": "q1", "stiffness": 8.0, "gap": 0.2, "smoothing": 0.2}}
        load = {"at": "q1", "amplitude": 1.0, "frequency": 2.8}
        model = of.structure(np.eye(count), damping, stiffness, stop, load)
        problem = of.Problem(model, of.guesses.linear_response(model), name="stop", method="balance")
        family = of.follow_family(problem, "frequency", until=2.5)
        doubling, change = family.events
        assert (doubling.kind, change.kind) == ("period_doubling", "stability_change")
        assert doubling.certified
        assert all(check.passed for _, check in verified(family, model))
        found.append(doubling)
    assert abs(found[0].parameter - found[1].parameter) <= 3 * (found[0].error + found[1].error)
    assert found[0].parameter == pytest.approx(found[1].parameter, abs=1e-7)


@pytest.mark.slow
def test_a_torus_of_a_large_family_is_where_all_multipliers_say():
    """41 masses through a torus bifurcation: its pair is on the circle among all multipliers of implicit steps, which
    are within it on one side and beyond it on the other."""
    problem = replace(masses(41, 0.2215, damping=0.0005), method="balance")
    family = of.follow_family(problem, "frequency", until=0.222)
    (torus,) = [event for event in family.events if event.kind == "torus"]
    assert torus.certified
    assert all(check.passed for _, check in verified(family, problem.model))
    for aside, told in ((-1e-5, "asymptotically stable"), (1e-5, "unstable")):
        frequency = torus.parameter + aside
        beside = masses(41, frequency, damping=0.0005)
        state = states_of(begun(beside, "frequency"), np.zeros(1))[0]
        assert gathered(beside.model, state, 2 * np.pi / frequency)[0].floquet.stability == told


def test_what_a_series_is_too_rough_for_is_said_with_the_remedy(tmp_path):
    """Friction below a tenth of the rates' size: certified with the multipliers of shooting, or without an answer."""
    problem = """[system]
kind = "structure"
mass = [[1.0, 0.0], [0.0, 1.0]]
damping = [[0.1, -0.05], [-0.05, 0.1]]
stiffness = [[2.0, -1.0], [-1.0, 2.0]]
forcing = { at = "q1", amplitude = 0.3, frequency = 0.8 }
[system.elements]
rub = { kind = "friction", at = "q1", limit = 0.05, smoothing = SMOOTHING }
[guess]
linear = true
"""
    said, multipliers = {}, {}
    for smoothing, method in ((0.001, "balance"), (0.01, "balance"), (0.01, "shooting")):
        file = tmp_path / "rub.toml"
        file.write_text(problem.replace("SMOOTHING", str(smoothing)))
        done = CliRunner().invoke(cli, ["run", str(file), "--method", method, "--no-figures", "-o", str(tmp_path)])
        said[smoothing, method] = done.exit_code, done.output
        if smoothing == 0.01:
            multipliers[method] = of.load_orbit(tmp_path / "rub" / "orbit.json").floquet_multipliers
    assert said[0.01, "shooting"][0] == said[0.01, "balance"][0] == 0
    assert np.sort_complex(multipliers["balance"]) == pytest.approx(np.sort_complex(multipliers["shooting"]), abs=1e-8)
    code, words = said[0.001, "balance"]
    assert code == 1 and 'make what has corners smoother, or take method = "shooting"' in words


@pytest.mark.parametrize("far", [False, True])
def test_variations_that_do_not_meet_are_carried_together(far, monkeypatch):
    """Of a slow mode of 100 masses, the fastest a hundred times as fast: a third of the columns, the same multipliers
    and closure; where they reach farther than was thought more are carried."""
    problem = row(100, 1, 0.01)
    orbit = of.find_orbit(problem)
    widths, varied = [], implicit.Implicit._varied
    monkeypatch.setattr(
        implicit.Implicit, "_varied", lambda own, *given: (widths.append(given[-1].shape[1]), varied(own, *given))[1]
    )
    if far:  # four steps' reach for eight steps
        whole = implicit.Compressed
        monkeypatch.setattr(implicit, "Compressed", lambda table, n, reach: whole(table, n, reach // 4))
    local = gathered(problem.model, orbit.state, orbit.period)[0]
    assert min(widths) < 70 and (max(widths) > 70) == far
    widths.clear()
    monkeypatch.setattr(implicit.Implicit, "_compressed", lambda own, reach: None)
    alone = gathered(problem.model, orbit.state, orbit.period)[0]
    assert set(widths) == {200}
    for one, other in zip(local.tour.pieces, alone.tour.pieces, strict=True):
        assert np.abs(one - other).max() <= 1e-12 * np.abs(other).max()
    assert np.sort_complex(local.floquet.indices) == pytest.approx(np.sort_complex(alone.floquet.indices), abs=1e-10)
    assert local.floquet.stability == alone.floquet.stability
    assert local.tour.closes.gap == alone.tour.closes.gap


def test_what_is_told_apart_too_narrowly_is_known_to_be_off():
    """A column of all coordinates says by how much, as a comparison with all columns does."""
    model = row(100, 1, 0.01).model
    motion = implicit.Implicit(model, Residual(model, cycles=0), np.array([0.0, 1.0]))
    state, units = np.zeros(200), np.ones(200)
    state[:100] = 0.01 * np.sin(np.pi * np.arange(1, 101) / 101)

    def after(columns):
        now, a = state, motion._start(state)
        for k in range(8):
            now, columns, a = motion.both(k * 0.5, now, 0.5, a, units, columns)
        return columns

    whole = after(np.eye(200))
    for reach, most in ((6, 1.0), (10, 1e-6), (16, 1e-14)):
        local = implicit.Compressed(motion.table, 100, reach)
        part, off = local.whole(after(local.begin(units)), units)
        wrong = np.abs(part - whole).max()
        assert wrong <= most and 0.05 * wrong <= off <= max(20 * wrong, 1e-14)


def steel(nodes):
    """M and K of a clamped steel beam by Hermite's elements: 700 x 14 x 14 mm (Ecole centrale's benchmark)."""
    side, length, count = 0.014, 0.7 / (nodes - 1), 2 * nodes
    bent, heavy = 2.05e11 * side**4 / 12 / length**3, 7800 * side**2 * length / 420
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4.0]])
    scale, whole = np.outer([1, length, 1, length], [1, length, 1, length]), np.zeros((2, count, count))
    for j in range(0, count - 2, 2):
        whole[:, j : j + 4, j : j + 4] += heavy * m * scale, bent * k * scale
    return whole[:, 2:, 2:]


def beam(nodes, tip=None):
    """Its first free mode with a spring of 6e9 N/m^3 at its tip; from 0.1 mm, or that far at t = 0."""
    mass, stiffness = steel(nodes)
    name = f"q{2 * nodes - 3}"
    spring = {"tip": {"kind": "cubic", "at": name, "stiffness": 6e9}}
    model = of.structure(mass, np.zeros_like(mass), stiffness, spring)
    guess = of.guesses.normal_mode(model, 1, tip or 1e-4)
    return Problem(model, guess, of.pin(**{name: tip}) if tip else ())


def own_balance(nodes, tip, first=None):
    """The period of that motion: harmonics x_k of the tip obey x_k = -H(k w) f_k, f that of 6e9 x^3."""
    (mass, stiffness), orders = steel(nodes), np.arange(1, 62, 2)
    squares, shapes = eigh(stiffness, mass)
    waves = np.cos(np.outer(2 * np.pi * np.arange(512) / 512, orders))

    def rows(unknowns):
        w, x = 150.0 * unknowns[0], tip * unknowns[1:]
        force = 2 * waves.T @ (6e9 * (waves @ x) ** 3) / len(waves)
        moved = (shapes[-2] ** 2 / (squares - (orders[:, None] * w) ** 2)).sum(axis=1)
        return np.append(x.sum() / tip - 1, (x / moved + force) / (6e9 * tip**3))

    if first is None:
        first = np.eye(orders.size + 1)[:2].sum(axis=0)
        if tip > 2e-4:  # from a smaller one
            first[0] = 2 * np.pi / own_balance(nodes, 0.8 * tip) / 150.0
    found = root(rows, first, tol=1e-14)
    assert np.abs(found.fun).max() < 1e-10
    return 2 * np.pi / (150.0 * found.x[0])


@pytest.mark.slow
@pytest.mark.parametrize("nodes", [2, 5, 20])
def test_a_beam_of_steel_is_followed_to_two_millimetres(nodes):
    """Unasked, with its events: periods as own balance of the tip has them, whichever method follows.

    On the way lie tongues of internal resonances. That of seven times the first mode leads to the second mode of two
    nodes and back out; that of nine times, to which the motion of 2 mm belongs, to the third mode of more nodes.
    """
    at, name = 2 * nodes - 4, f"q{2 * nodes - 3}"
    found = of.find_orbit(beam(nodes, 1e-3))
    assert found.certificate.passed and found.period == pytest.approx(own_balance(nodes, 1e-3), rel=1e-9)
    assert ("method_reason" in found.provenance) == (nodes > 2)
    goal = {"until": 0.1} if nodes > 2 else {"stop": {"tip": 2e-3}}
    settings = of.FamilySettings(directions="forward")
    family = of.follow_family(beam(nodes, 1e-3), "energy", **goal, settings=settings, watch={"tip": f"max({name})"})
    assert family.ends[-1].kind == "target" and all(event.certified for event in family.events)
    tips, energies = family.values("tip"), family.values("value")
    assert tips[-1] == pytest.approx(2e-3) if nodes == 2 else tips[-1] > 2e-3 and family.undecided == ()
    assert energies[-1] < 0.5 * energies.max() if nodes == 2 else energies[-1] == energies.max()
    point = family.points[int(np.argmin(np.abs(tips - 2e-3)))]
    first, start = np.eye(32)[:2].sum(axis=0), point.state[at]
    first[0] = 2 * np.pi / 150.0 / point.period
    if nodes > 2:  # where the ninth harmonic is large
        motion = np.fft.rfft(point.shooting_nodes[:, at], norm="forward").real[1:62:2]
        first[1 : motion.size + 1] = 2 * motion / start
    assert point.period == pytest.approx(own_balance(nodes, start, first), rel=1e-9)
    places = [event.parameter for event in family.events if event.kind == "branch_point"]
    assert nodes != 5 or places == pytest.approx([0.0193338487, 0.0193686790], rel=1e-8)


def test_a_stiff_start_follows_no_fast_mode(monkeypatch):
    """Nor does it need to: simulated, that mode's 6100 turns in a period took minutes. Its stiffness, 6100^2 times that
    of the motion, is known to a round-off of its own."""
    monkeypatch.delattr("orbitfinder.orbits.balance.lap")
    known = np.finfo(float).eps * 6100**2
    assert freed(begun(beam(20, 1e-4), ""))[1] == pytest.approx(own_balance(20, 1e-4), rel=known)


def test_a_closure_that_few_steps_miss_is_looked_at_with_more():
    """Exact: two oscillators, of which the other turns twenty times; by no steps does a wrong period close."""
    check = implicit.ImplicitCheck(of.structure(np.eye(2), None, np.diag([1.0, 400.0])), ())
    state, units = np.array([1.0, 0.5, 0.0, 0.0]), np.array([2.0, 1.0, 2.0, 20.0])
    few, more = (check(state, 2 * np.pi, {}, units, allowed) for allowed in (1.0, 1e-10))
    assert few > 1e-9 and more <= 1e-10
    assert check(state, 2 * np.pi * (1 + 1e-6), {}, units, 1e-10) == pytest.approx(2e-6 * np.pi * 20 / 2, rel=0.1)


@pytest.mark.parametrize("large", [False, True])
def test_events_that_cannot_be_told_cost_no_family(free, monkeypatch, large):
    """Each step says so, the family goes on to what was asked."""

    def lost(*_):
        raise ConvergenceError("its mesh would become too fine")

    monkeypatch.setattr(*((balance._Large, "events") if large else (balance, "find_events")), lost)
    settings = of.FamilySettings(method="balance", directions="forward", certify=False)
    problem, until = (beam(20, 1e-4), 3e-5) if large else (free[0], 0.4)
    family = of.follow_family(problem, "energy", until=until, settings=settings)
    assert family.ends[-1].kind == "target" and not family.events
    assert any("events are unknown: its mesh would become too fine" in each for each in family.undecided)


def test_a_fast_mode_makes_a_free_motion_stiff():
    """Why is said; a record without multipliers must say that its stability is undecided, and is at its period."""
    asked = beam(5)
    name, _, why = method_of(asked)
    assert name == "balance" and why == "the fastest mode turns by 1703 rad in a period"
    assert method_of(replace(asked, model=beam(2).model, guess=beam(2).guess))[0] == "shooting"
    orbit = of.find_orbit(beam(2))
    known = of.certify(orbit).passed, of.certify(replace(orbit, floquet_multipliers=np.zeros(0))).passed
    off = replace(orbit, floquet_multipliers=np.zeros(0), stability="undecided", period=orbit.period * (1 + 1e-7))
    assert (*known, of.certify(off).passed) == (True, False, False)


@pytest.mark.parametrize("covers", [2, 3])
def test_a_motion_of_many_coordinates_gone_round_twice_is_refused(covers):
    """Free ones and driven ones, which no check of their period looked at."""
    for problem in (row(41, 21, 0.22), masses(41, 0.1, 0.3)):
        orbit = of.find_orbit(problem, BALANCE)
        again = replace(orbit, period=covers * orbit.period, action=covers * orbit.action, nodes=orbit.state[None],
                        floquet_multipliers=orbit.floquet_multipliers**covers, times=np.zeros(0),
                        samples=np.zeros((0, orbit.state.size)))  # fmt: skip
        assert orbit.certificate.passed and "minimal_period" in of.certify(again).failures
