"""Phase responses: closed forms, cycles of the road against kicks, units, planted faults, messages, files; planes."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from test_equilibria import hodgkin_huxley, morris_lecar

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.records import registry
from orbitfinder.structures.phase_response import certify_phase_response

TURN, SHEAR, COUPLED = 1.5, 0.7, 0.3


def ring(attraction=1.0, out=-0.5, shear=SHEAR):
    """r' = a r (1 - r^2), theta' = w + b (r^2 - 1) + c z, z' = k z; theta + (b / a) log r - (c / k) z is the phase."""

    def field(t, x, p):
        off = x[0] ** 2 + x[1] ** 2 - 1
        turn = TURN + shear * off + COUPLED * x[2]
        return [-attraction * x[0] * off - turn * x[1], -attraction * x[1] * off + turn * x[0], out * x[2]]

    return of.ode(field, ["x", "y", "z"], find_invariants=out != 0.0)  # z alone is conserved where nothing drives it


def found(model, state, period, name="cycle"):
    return of.find_orbit(of.Problem(model, of.Guess(state, period), name=name))


@pytest.mark.parametrize(
    "attraction, out, shear, read, stability",
    [(1.0, -0.5, SHEAR, "after 9 periods, read along", "asymptotically stable"),
     (30.0, -8.0, 0.0, "after 1 periods, read along", "asymptotically stable"),
     (-1.0, 0.5, SHEAR, "after -9 periods, read along", "unstable"),
     (1.0, 0.5, SHEAR, "after 1 periods, read by Z", "unstable")], ids=["stable", "poincare", "unstable", "saddle"],
)  # fmt: skip
def test_the_isochrons_of_a_ring_are_known(attraction, out, shear, read, stability):
    """Z = (grad theta + (b / a) grad r - (c / k) grad z) / w, whether all decays, nothing does, or one does not."""
    model = ring(attraction, out, shear)
    curve = of.phase_response(found(model, [1.0, 0.0, 0.0], 2 * np.pi / TURN), model)
    x, y, _ = curve.states.T
    bend = shear / attraction
    exact = np.stack([-y + bend * x, x + bend * y, np.full(x.size, -COUPLED / out)], axis=1) / TURN
    assert np.abs(curve.response - exact).max() < 1e-11 and curve.normalisation < 1e-12
    assert curve.certificate.passed and curve.stability == stability
    assert read in curve.certificate.checks[-1].note
    size = np.sort(np.exp(curve.period * np.array([-2 * attraction, out])))
    assert np.allclose(np.sort(np.abs(curve.multipliers)), size, rtol=1e-10, atol=0)


FITZHUGH = of.ode(
    lambda t, x, p: [x[0] - x[0] ** 3 / 3 - x[1] + p[0], 0.08 * (x[0] + 0.7 - 0.8 * x[1])], ["v", "w"], {"I": 0.5}
)
ROAD = [
    (morris_lecar(100.0), [-8.96, 0.154], 85.29064104291239209, 5.366250621782675e-5),
    pytest.param(hodgkin_huxley(10.0), [-36.27, 0.316, 0.363, 0.4406], 14.636209989831557397, 0.0740602596866272,
                 marks=pytest.mark.slow),
    (of.systems.brusselator(rate=2.5), [1.379, 2.9646], 6.5772843419058333034, 0.0318997378933531),
    (FITZHUGH, [-0.3004, -0.1883], 39.474414980241752554, 2.299479019772148e-17),
]  # fmt: skip


@pytest.mark.parametrize("model, state, period, multiplier", ROAD, ids="mhbf")
def test_the_cycles_of_the_road_respond_as_finite_kicks_say(model, state, period, multiplier):
    """By the certificate's kicks, and by a kick of this test's own: when the cycle passes its start again."""
    orbit = found(model, state, period)
    curve = of.phase_response(orbit, model)
    assert curve.certificate.passed, curve.certificate.failures
    assert curve.period == pytest.approx(period, rel=1e-12, abs=0)
    assert abs(curve.multipliers[0]) == pytest.approx(multiplier, rel=1e-8, abs=0)
    k, moved = len(curve.times) // 3, np.ptp(curve.states, axis=0)
    rest = 3 * period - curve.times[k]
    there = np.asarray(model.rate(0.0, curve.states[0], model.parameter_values).full()).ravel()

    def rates(_, x):
        return model.rate(0.0, x.reshape(-1, 4), model.parameter_values).full().ravel()

    kicks = np.diag(1e-4 * moved)[:2]
    starts = curve.states[k] + np.concatenate([kicks, -kicks])
    kept = {"rtol": 1e-11, "atol": 1e-12 * np.repeat(moved, 4)}
    end = solve_ivp(rates, (0, rest), starts.T.ravel(), "DOP853", **kept).y[:, -1].reshape(-1, 4).T
    shifts = (end - curve.states[0]) @ (there / moved**2) / (there @ (there / moved**2))
    expected = kicks @ curve.response[k]
    sizes = np.abs(curve.response).max(axis=0)[:2] * np.diag(kicks)
    assert np.all(np.abs((shifts[:2] - shifts[2:]) / 2 - expected) < 1e-3 * sizes)


def test_units_rescale_the_response():
    """A component in other units: Z by their inverse, everything else as it was."""
    orbit, units = found(morris_lecar(100.0), [-8.96, 0.154], 85.29), np.array([1e-6, 1e4])
    moved = {name: getattr(orbit, name) * units for name in ("state", "nodes", "samples")}
    plain = of.phase_response(orbit, morris_lecar(100.0))
    other = of.phase_response(replace(orbit, **moved), morris_lecar(100.0, tuple(units)))
    assert plain.certificate.passed and other.certificate.passed
    assert np.allclose(other.response[0] * units, plain.response[0], rtol=1e-11, atol=0)
    at = CubicSpline(other.times, other.response * units)(plain.times)  # steps are those of round-off
    assert np.allclose(at, plain.response, rtol=0, atol=1e-6 * np.abs(plain.response).max(axis=0))


def test_mechanical_cycles_respond_in_coordinates_and_rates():
    """Van der Pol's oscillator as a mass with forces, and as a first-order system; its mirror image in time."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p", 1)
    symbols = of.Symbols(q, v, p, ("mu",), (1.0,))
    mass = of.lagrange(v**2 / 2, q**2 / 2, symbols, forces=p[0] * (1 - q**2) * v, names=["q"])
    plain = of.ode(lambda t, x, p: [x[1], (1 - x[0] ** 2) * x[1] - x[0]], ["q", "v"])
    one, other = (of.phase_response(found(model, [2.0, 0.0], 6.66), model) for model in (mass, plain))
    assert one.certificate.passed and other.certificate.passed
    assert np.allclose(one.response[0], other.response[0], rtol=1e-9)
    assert one.multipliers[0].real == pytest.approx(8.59695026e-4, rel=1e-6)


@pytest.fixture(scope="module")
def clock():
    return of.systems.brusselator(rate=2.5)


@pytest.fixture(scope="module")
def cycle(clock):
    return found(clock, [1.379, 2.9646], 6.577, "clock")


@pytest.fixture(scope="module")
def curve(clock, cycle):
    return of.phase_response(cycle)


def test_planted_faults_are_seen(curve, clock):
    """Z too large, at other phases, with what the flow does not see; states, multipliers, verdict, period."""
    assert certify_phase_response(curve, clock).passed
    rates = np.array([clock.rate(0.0, x, clock.parameter_values).full().ravel() for x in curve.states])
    across = np.stack([-rates[:, 1], rates[:, 0]], axis=1)
    twice = replace(curve, period=2 * curve.period, times=np.append(curve.times, curve.period + curve.times),
                    states=np.tile(curve.states, (2, 1)), response=np.tile(curve.response, (2, 1)))  # fmt: skip
    faults = {
        "normalisation": replace(curve, response=curve.response * (1 + 2e-7)),
        "adjoint": replace(curve, response=curve.response + 1e-6 * across),
        "kicks": replace(curve, response=curve.response + 1e-4 * across),
        "closure": replace(curve, states=curve.states * (1 + 1e-7 * np.sin(np.arange(curve.times.size))[:, None])),
        "multipliers": replace(curve, multipliers=curve.multipliers * 1.001),
        "stability": replace(curve, stability="unstable"),
        "period": twice,
    }
    for name, wrong in faults.items():
        assert name in certify_phase_response(wrong, clock).failures, name
    rolled = replace(curve, response=np.roll(curve.response, 1, axis=0))
    assert {"normalisation", "adjoint", "kicks"} <= set(certify_phase_response(rolled, clock).failures)
    nowhere = replace(curve, states=curve.states * 1e60)
    assert certify_phase_response(nowhere, clock).failures[0] in ("integration", "closure")


def test_messages(cycle):
    """What has no phase, and why."""
    ball, swing = of.systems.bouncing_ball(), of.systems.henon_heiles()
    for model, words in (
        (of.systems.forced_duffing(), "model: is forced, so that its phase is the forcing's"),
        (ball, "model: jumps; phase responses are of"), (of.chain_dae(1), "model: is under constraints; take its min"),
        (swing, "model: keeps an integral, so that a kick leads to another orbit"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            of.phase_response(cycle, model)
    turning = found(ring(), [1.0, 0.0, 0.0], 2 * np.pi / TURN)
    with pytest.raises(InputError, match="orbit: not hyperbolic, another multiplier is .* from the unit circle"):
        of.phase_response(turning, ring(out=0.0))


def test_the_commands(tmp_path, cycle, curve):
    """Written, verified, shown, plotted, read again; a doctored file is rejected, a damaged or foreign one refused."""
    orbit = str(of.save_orbit(cycle, tmp_path / "orbit.json"))
    done = CliRunner().invoke(cli, ["phase", orbit, "-o", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output
    file = tmp_path / "clock" / "phase.json"
    assert json.loads(done.stdout)["certificate"]["passed"] and (tmp_path / "clock" / "phase.png").exists()
    again = registry.load(file)
    assert np.array_equal(again.response, curve.response) and np.array_equal(again.multipliers, curve.multipliers)
    for command in (["verify", str(file)], ["show", str(file)], ["plot", str(file), "-o", str(tmp_path / "figures")]):
        done = CliRunner().invoke(cli, command)
        assert done.exit_code == 0, (command, done.output)
    assert (tmp_path / "figures" / "phase.png").exists()
    document = json.loads(file.read_text())
    wrong = document | {"response": (1.001 * np.array(document["response"])).tolist()}
    file.write_text(json.dumps(wrong))
    done = CliRunner().invoke(cli, ["verify", str(file)])
    assert done.exit_code == 1 and "normalisation" in done.output
    file.write_text(json.dumps(document | {"times": document["times"][::-1]}))
    done = CliRunner().invoke(cli, ["verify", str(file)])
    assert done.exit_code == 2 and "times: expected as many as states" in done.stderr
    forced = of.systems.forced_duffing()
    steady = found(forced, [0.1, 0.0], float(forced.forcing_period(forced.parameter_values)), "forced")
    done = CliRunner().invoke(cli, ["phase", str(of.save_orbit(steady, tmp_path / "forced.json")), "-o", str(tmp_path)])
    assert done.exit_code == 2 and "is forced" in done.stderr and not (tmp_path / "forced").exists()


def test_phase_planes(tmp_path, cycle, clock):
    """Nullclines where a rate is 0, every equilibrium with its sort, and the orbit, from Python and by the command."""
    figure = of.phase_plane(clock, orbits=[cycle])
    axes, (names,) = figure.axes[0], figure.legends
    assert [text.get_text() for text in names.get_texts()] == ["u' = 0", "v' = 0", "clock", "equilibrium, unstable"]
    for k, drawn in enumerate(axes.collections[:2]):
        points = np.vstack([path.vertices for path in drawn.get_paths()])
        rates = clock.rate(0.0, points.T, clock.parameter_values).full()
        assert len(points) > 50 and np.abs(rates[k]).max() < 1e-2 * np.abs(rates).max()
    assert np.allclose(axes.lines[-1].get_xydata(), [[1.0, 2.5]], atol=1e-12)
    hoop = of.phase_plane(of.systems.rotating_hoop(spin=4.0), {"theta": (-3.5, 3.5), "thetadot": (-9.0, 9.0)})
    rests = {tuple(np.round(line.get_xydata()[0], 9)): line.get_marker() for line in hoop.axes[0].lines}
    side = round(float(np.arccos(9.8 / 16)), 9)
    up = round(np.pi, 9)
    assert rests == {(0, 0): "D", (side, 0): "s", (-side, 0): "s", (up, 0): "D", (-up, 0): "D"}
    file = tmp_path / "clock.toml"
    file.write_text('system = { kind = "python", function = "brusselator", arguments = { rate = 1.5 } }\n'
                    "simulate = { state = [1.0, 1.0] }\n")  # fmt: skip
    orbit = str(of.save_orbit(cycle, tmp_path / "orbit.json"))
    ranges = ["--range", "u=0:4", "--range", "v=0:5"]
    for given in ([orbit], [str(file), *ranges], [str(file), orbit]):
        done = CliRunner().invoke(cli, ["phase-plane", *given, "-o", str(tmp_path / "out")])
        assert done.exit_code == 0 and done.output.strip().endswith("clock/phase-plane.png"), done.output
    done = CliRunner().invoke(cli, ["phase-plane", str(file), "-o", str(tmp_path)])
    assert done.exit_code == 2 and "ranges: expected the least and the largest value of u and v, got {}" in done.stderr


@pytest.mark.parametrize("model, ranges, message", [
    (of.systems.brusselator(), {"u": (0, 1), "z": (0, 1)}, "ranges: expected the least and the largest value of u"),
    (of.systems.brusselator(), {"u": (1, 0), "v": (0, 1)}, r"value of u and v, got {'u': \(1, 0\)"),
    (of.systems.forced_duffing(), {}, "model: depends on time; phase planes are of autonomous systems of two states"),
    (of.systems.bouncing_ball(), {}, "model: jumps"),
    (of.chain(2), {}, "model: has 4 states; phase planes are of autonomous systems of two states, draw a section"),
])  # fmt: skip
def test_no_phase_plane(model, ranges, message):
    """Field, value, remedy."""
    with pytest.raises(InputError, match=message):
        of.phase_plane(model, ranges)
