"""One orbit told in other units is found alike, certified alike, and verified alike from its file."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.systems import duffing

UNITS = {
    "metres and seconds": (1.0, 1.0),
    "millimetres": (1e3, 1.0),
    "megametres": (1e-6, 1.0),
    "milliseconds": (1.0, 1e3),
    "a resonator of 2 um and 1 MHz": (2e-6, 1.6e-7),
    "microns and weeks": (1e6, 1e-6),
    "an amplitude of a nanometre": (1e-9, 1.0),
}
"""Lengths and times of the same motion, in units of which the first is told in."""
PERIOD = 4.7680220291024620


def told(length: float, time: float) -> dict[str, float]:
    """x'' + x + x^3 = 0 with x measured in `length` and t in `time`."""
    return {"stiffness": time**-2, "cubic": time**-2 * length**-2}


@pytest.mark.parametrize(("length", "time"), UNITS.values(), ids=UNITS)
def test_a_duffing_orbit_is_found_and_certified_in_any_units(length, time):
    """The period is the exact one to 1e-13 in all of them, and the certificate passes with like numbers."""
    model = duffing(**told(length, time))
    orbit = of.find_orbit(of.Problem(model, of.Guess([length, 0.0], 5.0 * time), pin=of.pin(x=length)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert orbit.period / time == pytest.approx(PERIOD, rel=1e-13)
    assert orbit.certificate.scale == pytest.approx(3.549, rel=1e-3)
    assert (orbit.stability, orbit.symmetry) == ("elliptic", "brake+reflection")


@pytest.mark.parametrize(("length", "time"), UNITS.values(), ids=UNITS)
def test_by_the_command_and_from_the_file(length, time, tmp_path):
    """`run` certifies it, `verify` says so again from the file, and a period off by 1e-8 is rejected in all units."""
    numbers = ", ".join(f"{name} = {value!r}" for name, value in told(length, time).items())
    (tmp_path / "p.toml").write_text(
        f'name = "p"\n[system]\nkind = "python"\nfunction = "duffing"\narguments = {{ {numbers} }}\n'
        f"[guess]\nstate = [{length!r}, 0.0]\nperiod = {5.0 * time!r}\n[find]\npin = {{ x = {length!r} }}\n"
    )
    file = tmp_path / "out" / "p" / "orbit.json"
    assert CliRunner().invoke(cli, ["run", str(tmp_path / "p.toml"), "--out", str(tmp_path / "out")]).exit_code == 0
    assert CliRunner().invoke(cli, ["verify", str(file)]).exit_code == 0
    document = json.loads(file.read_text())
    assert document["period"] / time == pytest.approx(PERIOD, rel=1e-13)
    document["period"] *= 1 + 1e-8
    del document["record"]
    file.write_text(json.dumps(document))
    assert CliRunner().invoke(cli, ["verify", str(file)]).exit_code == 1


CHAINS = {
    "metres": {}, "millimetres": {"length": 1e3, "gravity": 9.8e3},
    "links of 1 mm and 1 g": {"length": 1e-3, "mass": 1e-3},
    "a microgram": {"mass": 1e-9}, "slow": {"gravity": 9.8e-12}, "a heavy end": {"mass": [1.0, 1e6]},
}  # fmt: skip


@pytest.mark.parametrize("arguments", CHAINS.values(), ids=CHAINS)
def test_a_double_pendulum_is_certified_whatever_it_is_measured_in(arguments):
    """Multipliers, pairs and symplecticity hold in canonical coordinates of any size."""
    model = of.chain(2, **arguments)
    guess = of.guesses.normal_mode(model, 1, 0.5)
    orbit = of.find_orbit(of.Problem(model, guess, pin=of.pin(theta1=float(np.asarray(guess.state)[0]))))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert np.abs(orbit.floquet_multipliers) == pytest.approx(1.0, abs=1e-8)
