"""A family proved over an interval of energies: pieces, joints, points where multipliers pass a value, records."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("flint")

from click.testing import CliRunner

from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.loops.symmetry import NONE, REFLECTION
from orbitfinder.proof.balls import arb, arb_mat
from orbitfinder.proof.branch import (
    BranchPiece,
    Checked,
    branch_document,
    contradictions,
    passage,
    prove_branch,
    read_branch,
    replayed,
    same_orbit,
)
from orbitfinder.proof.formulation import Formulation
from orbitfinder.proof.trajectory import Trajectory
from orbitfinder.records.family import load_family

pytestmark = pytest.mark.needs("proof")
FAMILIES = Path(__file__).parents[1] / "results" / "families"
BREAKING = -37.516214081097964
"""Energy (J) at which the reflection of the triple pendulum's second mode breaks, as the family's event has it"""
DOUBLING = 0.13528591930053516
"""Energy of the first period doubling of Hénon and Heiles' straight orbits"""


@pytest.fixture(scope="module")
def mode():
    return load_family(FAMILIES / "triple-mode-2" / "family.json")


@pytest.fixture(scope="module")
def proved(mode):
    """The branch within 2e-7 J of the symmetry breaking."""
    return prove_branch(mode, BREAKING - 1e-7, BREAKING + 1e-7)


@pytest.mark.slow
def test_the_symmetry_breaking_of_the_triple_pendulum_is_proved(proved):
    """One orbit for each energy, and a determinant of proved signs, opposite at the two ends."""
    assert proved.proved and proved.pieces[0].low < BREAKING < proved.pieces[-1].high
    (event,) = proved.passages
    assert event.proved and event.level == -2.0 and event.kept == "brake" and event.kind == "branch_point"
    assert event.low.startswith("[-") != event.high.startswith("[-")


@pytest.fixture(scope="module")
def straight():
    return load_family(FAMILIES / "henon-heiles-straight" / "family.json")


@pytest.fixture(scope="module")
def doubled(straight):
    """The branch of Hénon and Heiles' straight orbits about the first doubling."""
    return prove_branch(straight, DOUBLING - 1e-7, DOUBLING + 1e-7)


def test_pieces_reach_from_one_end_to_the_other(straight):
    """Several pieces, each beginning where the last one ended, the recorded orbit among them."""
    low = straight.points[10].energy
    found = prove_branch(straight, low, low + 1e-3)
    assert found.proved and len(found.pieces) > 1
    assert found.pieces[0].low == low and found.pieces[-1].high == low + 1e-3
    assert all(a.high == b.low for a, b in zip(found.pieces[:-1], found.pieces[1:], strict=True))
    for piece in found.pieces:  # the boxes go along with the energy and are narrower than the way that they go
        assert max(piece.radius) < 1e-3 * max(abs(one[1]) for one in piece.centre)


def test_the_recorded_orbit_is_in_the_box_of_its_energy(straight, doubled):
    """Where the family has its event, off the middle of a piece: the period there lies in the box."""
    event = next(one for one in straight.events if one.kind == "period_doubling")
    found = prove_branch(straight, DOUBLING - 1e-5, DOUBLING + 3e-6)
    piece = next(one for one in found.pieces if one.low <= event.energy <= one.high)
    parts = doubled.formulation.parts * doubled.formulation.segments
    place = (2 * event.energy - piece.low - piece.high) / (piece.high - piece.low)
    off = abs(float(piece.at(place)[-1]) - event.period / parts)
    assert off < piece.radius[-1] < 1e-3 * abs(place * piece.centre[-1][1])


@pytest.mark.parametrize(("kind", "order"), [("resonance", 6), ("resonance", 4), ("resonance", 3)])
def test_resonances_are_proved_where_the_family_has_them(straight, kind, order):
    """The determinant of K - level changes its sign at the event, and keeps it beside."""
    event = next(one for one in straight.events if (one.kind, one.order) == (kind, order))
    found = prove_branch(straight, event.energy - 1e-7, event.energy + 1e-7)
    assert found.proved and [one.proved for one in found.passages] == [True]
    beside = replace(event, energy=event.energy + 2e-7)
    off = prove_branch(replace(straight, events=(beside,)), event.energy + 1e-7, event.energy + 3e-7)
    assert off.proved and [one.proved for one in off.passages] == [False]


def test_a_branch_is_not_proved_where_it_turns_back_or_another_is_mixed_in(doubled):
    """A piece whose centre is off, whose tangent is wrong, or with a gap before the next one is refused."""
    piece = doubled.pieces[0]
    first, *others = piece.centre
    moved = replace(piece, centre=((first[0] + 1e-4, *first[1:]), *others))
    turned = replace(piece, centre=tuple((one[0], -one[1], *one[2:]) for one in piece.centre))
    for wrong in (moved, turned):
        again = replayed(replace(doubled, pieces=(wrong, *doubled.pieces[1:])))
        assert not again.proved and "does not map the box into itself" in again.reason
    short = replace(piece, high=0.5 * (piece.low + piece.high))
    again = replayed(replace(doubled, pieces=(short,)))
    assert not again.proved and "do not reach" in again.reason


def test_two_pieces_with_different_orbits_are_not_joined():
    """The orbit that the first one ends with must lie in the second one's box."""
    first = BranchPiece(0.0, 1.0, ((0.5, 0.5),), (0.1,))
    one = Checked(first, [arb(0, 0.01)], 0.1, True, [])
    assert same_orbit(one, BranchPiece(1.0, 2.0, ((1.5, 0.5),), (0.1,)))
    assert not same_orbit(one, BranchPiece(1.0, 2.0, ((1.7, 0.5),), (0.1,)))
    assert not same_orbit(one, BranchPiece(1.0, 2.0, ((1.5, 0.5),), (0.005,)))


@pytest.mark.parametrize(("symmetry", "kind"), [(REFLECTION, "branch_point"), (NONE, "period_doubling")])
def test_what_a_multiplier_of_minus_one_means(symmetry, kind):
    """Of a half map it is 1 over the period: another reflection is lost, nothing doubles."""
    form = Formulation(symmetry, 1, 1, (0, 0), (0,))
    sign = -1 if symmetry is REFLECTION else 1
    ends = [Trajectory(None, form, [], [], arb_mat([[sign * a, 0], [0, 3 * sign]])) for a in (-0.5, -2.0)]
    for name in ("branch_point", "period_doubling", "torus"):
        assert passage(name, -2.0, ends).proved is (name == kind)


def test_a_record_is_read_and_replayed_and_a_false_one_is_not(doubled, tmp_path):
    """Written and read back the same; an event that does not happen there is not borne out."""
    path = tmp_path / "branch-proof.json"
    path.write_text(json.dumps(branch_document(doubled)))
    back = read_branch(path)
    assert back.pieces == doubled.pieces and back.formulation == doubled.formulation
    again = replayed(back)
    assert again.proved and again.passages[0].proved and again.passages[0].kind == "period_doubling"
    elsewhere = replace(back, passages=(replace(back.passages[0], kind="resonance", level=0.0),))
    assert replayed(elsewhere).proved and not replayed(elsewhere).passages[0].proved
    spoilt = branch_document(doubled)
    spoilt["pieces"][0]["radius"] = [1.0]
    path.write_text(json.dumps(spoilt))
    with pytest.raises(InputError, match="its digest is another"):
        read_branch(path)
    del spoilt["record"]
    path.write_text(json.dumps(spoilt))
    with pytest.raises(InputError, match="do not fit the system"):
        read_branch(path)
    path.write_text("{}")
    with pytest.raises(InputError, match="format: expected"):
        read_branch(path)


def test_commands_prove_and_replay_a_branch(tmp_path):
    """`prove --from --to` writes the record beside the family, `verify --proof` replays it; bad input is named."""
    shutil.copy(FAMILIES / "henon-heiles-straight" / "family.json", tmp_path / "family.json")
    file, run = str(tmp_path / "family.json"), CliRunner()
    ends = ["--from", repr(DOUBLING - 1e-7), "--to", repr(DOUBLING + 1e-7)]
    found = run.invoke(cli, ["prove", file, *ends])
    assert found.exit_code == 0, found.output
    assert "without a gap" in found.output and "period doubling, nu + 1/nu = -2" in found.output
    record = tmp_path / "branch-proof.json"
    found = run.invoke(cli, ["verify", "--proof", str(record)])
    assert found.exit_code == 0 and "proof replayed" in found.output
    whole = record.read_bytes()  # which a proof of less was written over
    found = run.invoke(cli, ["prove", file, "--from", repr(DOUBLING - 1e-8), "--to", repr(DOUBLING + 1e-7)])
    assert found.exit_code == 2 and f"{record}: from: {DOUBLING - 1e-7!r} to" in found.output
    assert "give a wider range, --no-record" in found.output and record.read_bytes() == whole
    whole, recorded = json.loads(record.read_text()), read_branch(record)
    event, fresh = whole["passages"][0], replayed(recorded)
    for wrong in (
        {"level": 1.0}, {"kind": "torus"}, {"kept": "brake+reflection"}, {"test": "det(N + 2)"}, {"proved": False},
        {"low": event["high"], "high": event["low"]}, {"low": "[+/- inf]"}, {"low": "nan"}, {"low": "little"},
        {"high": event["high"].replace(" +/- ", "3 +/- ").replace("e-", "e-1")},
    ):  # fmt: skip
        false = replace(recorded, passages=(replace(recorded.passages[0], **wrong),))
        assert [said.partition(" {")[0][:15] for said in contradictions(false, fresh)] == ["event: recorded"], wrong
    pieces = [whole["pieces"][0] | {"contraction": 1e-9}, *whole["pieces"][1:]]
    for wrong, message in (
        ({"passages": [event | {"level": 1.0}]}, "event: recorded"),
        ({"passages": [event | {"kind": "torus"}], "pieces": pieces}, "contraction from"),
    ):
        record.write_text(json.dumps({name: part for name, part in (whole | wrong).items() if name != "record"}))
        found = run.invoke(cli, ["verify", "--proof", str(record)])
        assert found.exit_code == 1 and f"proof REJECTED: {message}" in found.output, (wrong, found.output)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--from", "-37.5"], "give both"),
        (["--from", "-60", "--to", "-37"], "from: -60.0 J is not among"),
        (["--from", "-37", "--to", "-38"], "to: must be above from"),
        (["--from", "-38", "--to", "-37", "--bits", "200"], "--bits: is for single orbits"),
    ],
)
def test_bad_ends_are_named(given, message):
    found = CliRunner().invoke(cli, ["prove", str(FAMILIES / "triple-mode-2" / "family.json"), "--no-record", *given])
    assert found.exit_code != 0 and message in (str(found.exception) + found.output)


@pytest.mark.slow
def test_a_doubling_is_proved(mode):
    """The determinant of K changes its sign where the half map's multipliers are +-i."""
    found = prove_branch(mode, -41.2150140, -41.2150139)
    assert found.proved and [one.kind for one in found.passages if one.proved] == ["period_doubling"]


@pytest.mark.slow
def test_five_joules_of_the_triple_pendulum_are_proved():
    """The committed record of its first mode: every piece and joint again, over at least 5 J."""
    recorded = read_branch(FAMILIES.parent / "proofs" / "triple-mode-1" / "branch-proof.json")
    assert recorded.high - recorded.low >= 5.0 and len(recorded.pieces) < 50
    again = replayed(recorded)
    assert again.proved, again.reason
