"""The certificate: planted errors are rejected by the name of the failing check."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.cvodes import Flow
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits import evidence
from orbitfinder.orbits.certify import Tolerances, certified, certify
from orbitfinder.orbits.evidence import gather
from orbitfinder.records.orbit import Orbit, save_orbit
from orbitfinder.records.registry import load_orbit

NAMES = ["triple-1", "triple-2", "quadruple-1", "quadruple-2"]


@pytest.fixture(params=NAMES)
def orbit(request, report_orbits):
    """Each report orbit."""
    return report_orbits[request.param]


@pytest.fixture
def good(report_orbits):
    """One elliptic orbit, quick to certify."""
    return report_orbits["quadruple-2"]


def test_good_orbits_pass_with_the_checks_that_were_promised(orbit):
    """Every check of the contract is made and passed, with its tolerance."""
    certificate = certify(orbit)
    assert certificate.failures == ()
    promised = {
        "closure", "second_closure", "energy_drift", "minimal_period", "not_equilibrium", "trivial_multipliers",
        "symplectic", "unfolding", "energy", "action", "recorded_closure", "floquet_multipliers", "stability",
        "symmetry", "pair_defect", "distance", "nodes", "samples", "time_dependence", "invariant_energy",
    }  # fmt: skip
    assert promised <= {check.name for check in certificate.checks}
    assert certificate.scale >= np.abs(orbit.floquet_multipliers).max()


def test_certifying_twice_gives_the_same_numbers(good):
    """A certificate depends on the orbit alone."""
    assert certify(good) == certify(good)


def test_the_certificate_needs_no_cvodes(good, monkeypatch):
    """With CasADi's integrators and solvers disabled and the flow out of reach, certify still answers."""

    def refuse(*_, **__):
        pytest.fail("the certificate used the finder's integrator")

    monkeypatch.setattr(ca, "integrator", refuse)
    monkeypatch.setattr(ca, "nlpsol", refuse)
    monkeypatch.setattr(Flow, "end", property(refuse))
    monkeypatch.setattr(Flow, "derivatives", property(refuse))
    assert certify(good).passed


def test_the_certificate_uses_neither_nodes_nor_samples(good):
    """State and period alone decide: without nodes and samples the answer is the same."""
    bare = certify(replace(good, nodes=good.state[None], times=np.zeros(0), samples=np.zeros((0, 8))))
    shown = [check for check in certify(good).checks if check.name not in ("nodes", "samples")]
    assert [check for check in bare.checks if check.name != "nodes"] == shown


@pytest.mark.parametrize("change", [1e-3, 1e-6, -1e-6, 1e-9])
def test_a_wrong_period_fails_closure(orbit, change):
    """A period off by 1e-3 down to 1e-9 relative is rejected by closure."""
    assert "closure" in certify(replace(orbit, period=orbit.period * (1 + change))).failures


@pytest.mark.parametrize("component", range(8))
def test_a_state_nudged_by_a_millionth_fails_closure(good, component):
    """1e-6 on any one component of the state is rejected by closure, and by the energy that no longer fits."""
    state = good.state.copy()
    state[component] += 1e-6
    found = certify(replace(good, state=state))
    assert "closure" in found.failures


@pytest.mark.parametrize("name", NAMES)
def test_a_state_nudged_along_the_family_fails_too(report_orbits, name):
    """All components off by 1e-6: rejected by closure."""
    orbit = report_orbits[name]
    assert "closure" in certify(replace(orbit, state=orbit.state + 1e-6)).failures


@pytest.mark.parametrize("cover", [2, 3, 7])
def test_a_multiple_of_the_period_fails_minimal_period(good, cover):
    """Two, three and seven times round closes, and is rejected by minimal_period."""
    assert "minimal_period" in certify(replace(good, period=cover * good.period)).failures


def test_a_running_orbit_twice_round_fails_minimal_period(pendulum_orbit):
    """Angles are compared modulo 2 pi, so a doubled running orbit is recognised as well."""
    from scipy.special import ellipk

    lift = 8.0 + 4.9
    period = 4 * float(ellipk(2 * 4.9 / lift)) / np.sqrt(6 * lift)
    state = np.array([0.0, np.sqrt(6 * lift)])
    running = replace(pendulum_orbit, state=state, period=2 * period, winding=(2,))
    assert "minimal_period" in certify(running).failures
    once = certify(replace(running, period=period, winding=(1,)))
    assert not {"closure", "minimal_period", "not_equilibrium"} & set(once.failures)
    assert "closure" in certify(replace(running, winding=(1,))).failures


@pytest.mark.parametrize("angles", [[0.0] * 4, [np.pi] * 4, [0.0, np.pi, 0.0, np.pi]])
def test_an_equilibrium_fails_not_equilibrium(good, angles):
    """Hanging, upright and folded at rest close perfectly, and are rejected by not_equilibrium."""
    state = np.concatenate([angles, np.zeros(4)])
    assert "not_equilibrium" in certify(replace(good, state=state)).failures


def test_a_small_oscillation_is_no_equilibrium():
    """An honest motion of 1e-4 rad passes not_equilibrium."""
    from orbitfinder.loops.conditions import pin
    from orbitfinder.loops.problem import Guess, Problem
    from orbitfinder.orbits.find import find_orbit

    orbit = find_orbit(Problem(chain(1), Guess([1e-4, 0.0], 1.64), pin=pin(theta1=1e-4)))
    assert orbit.certificate.failures == ()


def test_an_unfolding_that_did_not_return_to_zero_fails(good):
    """s = 1e-6 is a damped system's orbit: rejected by unfolding."""
    assert certify(replace(good, unfolding=(1e-6,))).failures == ("unfolding",)


@pytest.mark.parametrize("name", ["period", "energy", "action"])
def test_disagreement_with_what_was_expected_fails_by_name(good, name):
    """An expected number off by ten tolerances is rejected as expected_<name>; within it passes."""
    value = getattr(good, name)
    off = replace(good, expected={name: (value + 1e-8, 1e-9)})
    assert certify(off).failures == (f"expected_{name}",)
    assert certify(replace(good, expected={name: (value + 1e-10, 1e-9)})).passed


def edited(orbit, path, keep_record=True, **changes):
    """The orbit as read back from an orbit.json in which someone changed some entries."""
    file = save_orbit(orbit, path / "orbit.json")
    document = json.loads(file.read_text()) | changes
    if not keep_record:
        del document["record"]
    file.write_text(json.dumps(document))
    return load_orbit(file)


def edits(orbit):
    """Entry -> (forged value, name of the check that must fail without the help of the digest)."""
    multipliers = [[mu.real, mu.imag] for mu in orbit.floquet_multipliers]
    system = dict(orbit.system)
    return {
        "energy": (orbit.energy + 1e-7, "energy"),
        "action": (orbit.action * (1 + 1e-7), "action"),
        "floquet_multipliers": ([[re, im + 1e-4] for re, im in multipliers], "floquet_multipliers"),
        "stability": ("unstable", "stability"),
        "symmetry": ("none", "symmetry"),
        "closure": (1e-9, "recorded_closure"),
        "state": ((orbit.state + 1e-9).tolist(), "closure"),
        "period": (orbit.period + 1e-9, "closure"),
        "winding": ([1, 0, 0, 0], "closure"),
        "unfolding": ([1e-3], "unfolding"),
        "nodes": ((orbit.nodes + 1e-6).tolist(), "nodes"),
        "system": (system | {"gravity": 9.81}, "closure"),
    }


ENTRIES = [
    "energy", "action", "floquet_multipliers", "stability", "symmetry", "closure", "state", "period", "winding",
    "unfolding", "system", "nodes",
]  # fmt: skip


@pytest.mark.parametrize("keep_record", [True, False])
@pytest.mark.parametrize("entry", ENTRIES)
def test_a_file_edited_by_hand_fails_the_check_of_that_entry(good, tmp_path, entry, keep_record):
    """Each forged entry is caught by its own recomputation, with the digest and without it."""
    value, check = edits(good)[entry]
    failures = certify(edited(good, tmp_path, keep_record, **{entry: value})).failures
    assert check in failures
    assert ("record" in failures) == keep_record


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("closure", 0.0),
        ("tolerance", 1e-3),
        ("pair_defect", 0.0),
        ("expected", {"period": {"value": 0.0, "tolerance": 1e9}}),
        ("record", "0" * 64),
    ],
)
def test_an_edit_too_small_to_recompute_fails_the_digest(good, tmp_path, entry, value):
    """What no recomputation contradicts is still caught by record, the digest of the numbers as written."""
    assert certify(edited(good, tmp_path, **{entry: value})).failures == ("record",)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 5e-324, 1e300, -1e300, 1e200, 1e-200])
@pytest.mark.parametrize("entry", ["state", "period", "energy", "action", "floquet_multipliers", "nodes"])
def test_a_number_that_cannot_be_computed_with_is_a_rejection(good, entry, value):
    """Of a record in memory, which no file has refused: no exception, and no warning (5e-324 s divided by zero)."""
    for orbit in (good, load_orbit(f"{STRAIGHT.parents[1] / 'triple-1' / 'family.json'}#5")):
        spoilt = np.array(getattr(orbit, entry))
        spoilt.flat[:1] = value
        assert not certify(replace(orbit, **{entry: spoilt if spoilt.ndim else float(spoilt)}, record=None)).passed


@pytest.mark.parametrize("claimed", ["none", "reflection"])
def test_a_found_orbit_has_the_symmetry_that_its_certificate_finds(claimed):
    """Samples missed the instant at rest: ten of twenty rough starts were refused by `symmetry`. A file is no find."""
    model = chain(2, length=[1.0, 0.4], mass=[0.5, 2.0])
    orbit = load_orbit(STRAIGHT.parents[2] / "gallery" / "unequal-double-pendulum" / "orbit.json")
    less = replace(orbit, symmetry=claimed, record=None)
    found = certified(less, model)
    assert found.symmetry == orbit.symmetry == "brake+reflection" and found.certificate.passed
    assert certify(less).failures == ("symmetry",)


@pytest.mark.parametrize("entry", ["pair_defect", "closure", "unfolding"])
def test_a_recorded_error_that_is_no_number_is_rejected(good, entry):
    """nan is no smaller than what is allowed; of reciprocal pairs it once was."""
    certificate = certify(replace(good, **{entry: (np.nan,) if entry == "unfolding" else np.nan}))
    assert certificate.failures == ("finite",) and f"record: {entry}" in certificate.checks[0].note


@pytest.mark.parametrize(
    ("parameter", "value"),
    [("length", [1.0, 1.0, 1.0, 1.0 + 1e-6]), ("mass", [1.0, 1.0, 1.0 + 1e-6, 1.0]), ("com", [0.5, 0.5, 0.5, 0.51])],
)
def test_a_changed_system_fails_closure(good, tmp_path, parameter, value):
    """A mass or length changed by a millionth is another system, in which the orbit does not close."""
    system = dict(good.system) | {parameter: value}
    assert "closure" in certify(edited(good, tmp_path, False, system=system)).failures


def test_a_forged_certificate_in_the_file_changes_nothing(good, tmp_path):
    """Claiming passed: true for a wrong period does not help: verify recomputes."""
    forged = {"passed": True, "scale": 1e9, "checks": [
        {"name": "closure", "value": 0.0, "tolerance": 1.0, "passed": True, "note": ""},
    ]}  # fmt: skip
    orbit = edited(good, tmp_path, False, certificate=forged, period=good.period * 1.001)
    assert orbit.certificate.passed
    assert "closure" in certify(orbit).failures


def test_a_loosened_tolerance_does_not_hide_a_bad_closure(good, tmp_path):
    """With tolerance 0.9 in a file without digest the second closure still rejects a nudged state."""
    state = (good.state + 1e-6).tolist()
    orbit = edited(good, tmp_path, False, tolerance=0.9, state=state, energy=energy(chain(4), np.asarray(state)))
    assert "second_closure" in certify(orbit).failures


@pytest.mark.parametrize("period", [np.nan, np.inf, 0.0, -1.0])
def test_a_period_that_is_no_duration_fails_finite(good, period):
    """NaN, infinity, zero and negative periods are answered by a failed check, not by an exception."""
    assert certify(replace(good, period=period)).failures == ("finite",)


def test_a_state_that_is_not_a_number_fails_finite(good):
    """NaN in the state is answered by a failed check."""
    assert certify(replace(good, state=np.full(8, np.nan))).failures == ("finite",)


@pytest.mark.parametrize("size", [1e60, 1e200])
def test_an_orbit_that_cannot_be_integrated_fails_integration(good, size):
    """A state thrown to 1e60 or 1e200 is answered at once by a failed check naming the integration."""
    assert certify(replace(good, state=good.state * size)).failures == ("integration",)


def planted(state, period) -> Orbit:
    """A double pendulum's arc that does not close, its record consistent with what certify will recompute."""
    model, start = chain(2), np.asarray(state, float)
    found = gather(model, start, period, np.zeros(2, int))
    return Orbit(
        name="planted", system=model.system, state=start, period=period, energy=found.energy, action=found.action,
        closure=found.closure, symmetry="none", winding=(0, 0), floquet_multipliers=found.floquet.multipliers,
        pair_defect=0.0, stability=found.floquet.stability, unfolding=(0.0,), nodes=start[None], times=np.zeros(0),
        samples=np.zeros((0, 4)), tolerance=1e-12,
    )  # fmt: skip


@pytest.mark.parametrize("period", [5.0, 20.0, 40.0])
def test_chaos_does_not_excuse_an_arc_that_does_not_close(period):
    """However large the multipliers of a chaotic arc (1e22 over 40 s), closure rejects it."""
    certificate = certify(planted([2.0, 2.5, 0.0, 0.0], period))
    assert "closure" in certificate.failures
    assert certificate.scale <= 1e6


STRAIGHT = Path(__file__).parents[1] / "results" / "families" / "henon-heiles-straight" / "family.json"


@pytest.mark.parametrize("number", [50, 60])
def test_near_a_saddle_the_flow_is_kept_as_well_as_its_linearisation_can_be_known(number):
    """Straight orbits that nearly rest: an error is made where Phi(t, 0) is A times what it is at the end, and grows A
    times: 6.7e-5 at A = 8e5. In long double, which needs a compiler, it is a hundredth of that."""
    point = load_orbit(f"{STRAIGHT}#{number}")
    with compiling("off"):
        certificate = certify(point)
    kept = next(one for one in certificate.checks if one.name == "trivial_multipliers")
    assert certificate.passed and 1e-8 < kept.value < kept.tolerance < 20 * kept.value
    assert certificate.scale < 1e6 and kept.tolerance < 1e-14 * certificate.scale**2


@pytest.mark.parametrize(("number", "error"), [(0, 1e-6), (50, 1e-12)])
def test_a_wrong_linearisation_fails_trivial_multipliers(number, error, monkeypatch):
    """One of sixteen pieces is off by a share of its largest entry: near a saddle 1e-12 is seen, it grows to 1e-5."""
    whole, wider = evidence._pieces, evidence.extended
    monkeypatch.setattr(evidence, "extended", lambda field, deep=False: None if deep else wider(field))

    def disturbed(*arguments):
        pieces, *more = whole(*arguments)
        return [piece + error * (k == 8) * np.abs(piece).max() for k, piece in enumerate(pieces)], *more

    monkeypatch.setattr(evidence, "_pieces", disturbed)
    assert "trivial_multipliers" in certify(load_orbit(f"{STRAIGHT}#{number}")).failures


@pytest.mark.parametrize("number", [0, 50])
def test_a_wrong_linearisation_fails_in_quadruple_precision_too(number, monkeypatch):
    """All of them are off by 1e-6 of their largest entry, that of the whole period too."""
    own = evidence.varied_end

    def disturbed(*arguments):
        end, matrix, action = own(*arguments)
        return end, matrix + 1e-6 * np.abs(matrix).max(), action

    monkeypatch.setattr(evidence, "varied_end", disturbed)
    assert "trivial_multipliers" in certify(load_orbit(f"{STRAIGHT}#{number}")).failures


def test_tolerances_can_be_tightened(good):
    """A caller may ask for more: what then fails is named, and the default passes."""
    assert certify(good, tolerances=Tolerances(cover=10.0)).failures == ("minimal_period",)


def test_a_custom_model_is_certified_with_the_model_in_hand():
    """A system no file describes is certified when its Model is given, and refused by name without."""
    from orbitfinder.errors import InputError
    from orbitfinder.loops.conditions import pin
    from orbitfinder.loops.problem import Guess, Problem
    from orbitfinder.mechanics.lagrange import Symbols, lagrange
    from orbitfinder.orbits.find import find_orbit

    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(0.5 * v**2, 0.5 * q**2 + 0.25 * q**4, Symbols(q, v))
    orbit = find_orbit(Problem(model, Guess([1.0, 0.0], 5.0), pin=pin(q1=1.0)))
    assert certify(orbit, model).failures == ()
    with pytest.raises(InputError, match=r"system.kind: cannot rebuild 'custom'"):
        certify(orbit)
