"""Closed chains: assembly, velocities, forces, motion, and what cannot be assembled."""

import json

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.integrate.idas import simulate_dae
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanisms.linkage import (
    assemble,
    closure_jacobian,
    joint_forces,
    linkage,
    linkage_rates,
    linkage_state,
)

CRANK_ROCKER = ([0.5, 1.5, 1.2], (0.0, 1.4))


def closure(lengths, theta, ground):
    return np.array([np.cos(theta), np.sin(theta)]) @ np.asarray(lengths, float) - ground


def moving(lengths, ground, angle, rate, branch=1):
    model = linkage(lengths, ground=ground)
    theta = assemble(model, {"theta1": angle}, branch)
    return model, linkage_state(model, theta, linkage_rates(model, theta, {"theta1dot": rate}))


@pytest.mark.parametrize("branch", [1, -1])
@pytest.mark.parametrize("angle", [-2.0, 0.3, 1.5])
def test_assembly_closes_on_the_branch_asked_for(angle, branch):
    lengths, ground = CRANK_ROCKER
    theta = assemble(linkage(lengths, ground=ground), {"theta1": angle}, branch)
    assert theta[0] == angle
    assert np.abs(closure(lengths, theta, ground)).max() < 1e-14
    assert np.sign(np.sin(theta[2] - theta[1])) == branch


def test_a_guess_chooses_branch_and_winding():
    lengths, ground = CRANK_ROCKER
    model = linkage(lengths, ground=ground)
    wanted = assemble(model, {"theta1": 0.3}, -1) + np.array([0, 2 * np.pi, 0])
    assert assemble(model, {"theta1": 0.3}, guess=wanted + 0.1) == pytest.approx(wanted, abs=1e-12)


def test_five_bar_from_two_angles_or_from_a_guess():
    lengths, ground = [1.0, 1.2, 0.9, 1.1], (0.2, 1.5)
    model = linkage(lengths, ground=ground)
    full = assemble(model, {"theta1": 0.2, "theta4": 2.5})
    assert np.abs(closure(lengths, full, ground)).max() < 1e-13
    near = assemble(model, {"theta1": 0.2}, guess=full + 0.05)
    assert np.abs(closure(lengths, near, ground)).max() < 1e-12
    assert near[0] == 0.2
    rates = linkage_rates(model, full, {"theta1dot": 1.0, "theta2dot": -0.5})
    assert np.abs(closure_jacobian(np.array(lengths), full) @ rates).max() < 1e-13


def test_forces_at_rest_balance_the_weight():
    """A symmetric hanging four-bar at rest: the joints on the ground carry m g in all, half each."""
    model = linkage([1, 1, 1], ground=(0.0, 1.5))
    angle = np.arcsin(0.25)
    state = linkage_state(model, assemble(model, {"theta1": angle}, 1))
    forces = joint_forces(model, state)
    assert forces.shape == (2, 4)
    assert forces[0] == pytest.approx([-14.7, -4.9, 4.9, 14.7])
    assert forces[1] == pytest.approx(forces[1][0] * np.ones(4))


@pytest.mark.parametrize(
    "lengths, ground, angle, rate, least",
    [
        pytest.param([1, 1, 1], (0.0, 1.5), 0.9, 0.0, 0.1, id="the report's, rocking"),
        pytest.param(*CRANK_ROCKER, 0.3, 6.0, 0.1, id="crank-rocker"),
        pytest.param([1, 1.5, 1], (0.0, 1.5), 0.5, 0.0, 0.1, id="parallelogram, rocking"),
        pytest.param([1.2, 1.0, 1.3], (0.0, 0.6), 0.3, 9.0, 10 * np.pi, id="drag-link, fully rotating"),
    ],
)
def test_ten_seconds_of_motion_stay_on_the_constraints(lengths, ground, angle, rate, least):
    model, state = moving(lengths, ground, angle, rate)
    result = simulate_dae(model, state, 10.0)
    assert result.constraint_drift.max() <= 1e-11
    assert result.rate_drift.max() <= 1e-10
    assert np.abs(result.energy - result.energy[0]).max() <= 1e-8
    assert np.ptp(result.states[:, 2]) > least


def test_parallelogram_stays_parallel():
    model, state = moving([1, 1.5, 1], (0.0, 1.5), 0.5, 0.0)
    angles = simulate_dae(model, state, 10.0).states[:, 2:9:3]
    assert np.abs(angles[:, 1] - np.pi / 2).max() < 1e-10
    assert np.abs(np.sin(angles[:, 0] - angles[:, 2])).max() < 1e-10


def test_description_rebuilds():
    model = linkage(*CRANK_ROCKER[:1], mass=[1, 2, 3], ground=CRANK_ROCKER[1])
    system = json.loads(json.dumps(model.system))
    assert set(system) == {"kind", "length", "mass", "com", "gravity", "ground", "baumgarte"}
    assert np.array_equal(build_model(system).parameter_values, model.parameter_values)
    rebuilt = build_model(system)
    assert rebuilt.state_names == model.state_names
    assert with_parameters(rebuilt, {"ground2": 1.3, "length1": 0.6}).system["ground"] == [0.0, 1.3]


def test_unassemblable_linkage_names_the_side_and_the_excess():
    with pytest.raises(InputError, match=r"length2 = 5 m exceeds the sum of all other sides, 3.5 m .*1.5 m"):
        linkage([1, 5, 1], ground=(0.0, 1.5))
    with pytest.raises(InputError, match="distance between the ground pivots = 4 m"):
        linkage([1, 1, 1], ground=(0.0, 4.0))


def test_unreachable_angle_names_bars_and_reach():
    model = linkage([1, 1, 1], ground=(0.0, 1.5))
    with pytest.raises(InputError, match=r"theta1 = -1.5: bars 2 and 3 would have to span 2.49\d+ m, .* at most 2 m"):
        assemble(model, {"theta1": -1.5})
    short = linkage([1, 3, 1.2], ground=(0.0, 1.5))
    with pytest.raises(InputError, match=r"at least 1.8 m = \|length2 - length3\|"):
        assemble(short, {"theta1": 1.5})


def test_change_point_is_refused():
    """A parallelogram folded onto the ground line: all bars in one line, the next branch undecided."""
    model = linkage([1, 1.5, 1], ground=(0.0, 1.5))
    with pytest.raises(InputError, match="change-point"):
        assemble(model, {"theta1": np.pi / 2})
    folded = np.array([1, 1, -1]) * np.pi / 2
    with pytest.raises(InputError, match="change-point"):
        linkage_rates(model, folded, {"theta1dot": 1.0})
    with pytest.raises(InputError, match="change-point"):
        simulate_dae(model, linkage_state(model, folded), 1.0)


def test_dead_point_asks_for_another_rate():
    """Bars 2 and 3 stretched out: theta1 stands still whatever they do."""
    model = linkage([1, 1, 1], ground=(0.0, 1.5))
    inner = np.arccos((1 + 1.5**2 - 4) / 3)
    theta = assemble(model, {"theta1": np.pi / 2 - inner})
    with pytest.raises(InputError, match="dead point"):
        linkage_rates(model, theta, {"theta1dot": 1.0})
    assert linkage_rates(model, theta, {"theta2dot": 1.0})[0] == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda m: assemble(m, {"theta9": 1.0}), "theta9: unknown"),
        (lambda m: assemble(m, {"theta1": np.nan}), "must be finite"),
        (lambda m: assemble(m, {"theta1": 1.0, "theta2": 1.0}), "give at most 1"),
        (lambda m: assemble(m, {}), "or guess="),
        (lambda m: assemble(m, {"theta1": 1.0}, branch=2), "branch: must be"),
        (lambda m: assemble(m, {}, guess=[1.0]), "need 3 finite angles"),
        (lambda m: linkage_rates(m, np.zeros(3), {}), "0 rates given"),
        (lambda m: linkage([1.0], ground=(0, 1)), "at least 2 bars"),
        (lambda m: linkage([1, 1, 1], ground=(0, np.inf)), "ground: need"),
        (lambda m: linkage([1, 1, 1], ground=(0, 1), baumgarte=(-1, 0)), "baumgarte: need"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call(linkage([1, 1, 1], ground=(0.0, 1.5)))
