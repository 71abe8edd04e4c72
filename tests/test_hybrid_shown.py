"""What is seen of hybrid orbits: problem files, courses, pictures, pages, exports; and each orbit computed again."""

import base64
import importlib.util
import json
import sys
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.exports.write import export_orbit
from orbitfinder.families.members import motions, whole
from orbitfinder.mechanics.hybrid import Mode, Transition, hybrid, with_cycle
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanisms.machines import MACHINES, kneed_walker, simplest_walker
from orbitfinder.orbits.course import course, course_of, sampled
from orbitfinder.problemfile.read import load_problem
from orbitfinder.problemfile.write import orbit_text
from orbitfinder.records.orbit import orbit_to_document
from orbitfinder.show import plot
from orbitfinder.show.animate import AnimationSettings, draw_frames, orbit_clip
from orbitfinder.show.html import motions as moving
from orbitfinder.show.html import orbit_html
from orbitfinder.site.build import SiteSettings, build_site
from orbitfinder.site.gather import gather
from orbitfinder.site.motion import Simulator, histories, packed

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "problems" / "hybrid"
WALKERS = ["compass-gait", "kneed-walker", "rimless-wheel", "simplest-walker-long", "simplest-walker-period-2"]


@pytest.fixture(scope="module")
def found():
    """Orbits of problem files by name, each found once."""
    kept = {}

    def orbit(name):
        if name not in kept:
            kept[name] = of.find_orbit(load_problem(FOLDER / f"{name}.toml"))
        return kept[name], build_model(kept[name].system)

    return orbit


def independent():
    """The second program, which uses nothing of the package."""
    path = ROOT / "benchmarks" / "hybrid_gaits.py"
    assert "orbitfinder" not in path.read_text().replace("problems/hybrid", "")
    spec = importlib.util.spec_from_file_location("hybrid_gaits", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look there
    spec.loader.exec_module(module)
    return module


def computed_again(found, name):
    orbit, _ = found(name)
    state, period = independent().again(name)
    assert period == pytest.approx(orbit.period, abs=1e-9)
    assert state == pytest.approx(orbit.state, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kneed-walker"])
def test_computed_again(found, name):
    computed_again(found, name)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(independent().NAMES) - {"kneed-walker"}))
def test_all_computed_again(found, name):
    computed_again(found, name)


def test_every_machine_has_a_problem_file():
    named = {json.dumps(load_problem(path).model.system["function"]) for path in FOLDER.glob("*.toml")}
    assert {json.dumps(one) for one in MACHINES} == named
    assert len(list(FOLDER.glob("*.toml"))) >= 14


def test_wedge_in_closed_form(found):
    """The parabola that meets both walls at right angles; bounces keep the energy."""
    orbit, model = found("gravity-wedge")
    a, (x, y, vx, vy) = 0.6, orbit.state
    assert orbit.period == pytest.approx(4 * np.sin(a) * np.sqrt(10 / (1 + 2 * np.cos(a) ** 2)), abs=1e-12)
    assert (-x / y, vy / vx) == pytest.approx((np.tan(a), np.tan(a)), abs=1e-12)
    assert orbit.stability == "elliptic" and model.hybrid.cycle == ("right", "left")


def test_a_knee_that_locks_stays_straight(found):
    orbit, model = found("kneed-walker")
    free, locked = course_of(orbit, model).pieces
    assert np.abs(locked.states[:, 1] - locked.states[:, 2]).max() < 1e-12
    assert np.max(free.states[:, 1] - free.states[:, 2]) > 0.5
    knee = model.hybrid.transition("knee")
    before, after = free.states[-1], locked.states[0]
    turned = [model.kinetic(x[:3], x[3:], model.parameter_values) for x in (before, after)]
    assert float(knee.lost(before, model.parameter_values)) == pytest.approx(float(turned[0] - turned[1]), abs=1e-12)


@pytest.mark.parametrize("name", WALKERS)
def test_the_stance_foot_stays(found, name):
    """Within a step the first point does not move; at the strike the next foothold is where the foot came down."""
    orbit, model = found(name)
    path = course_of(orbit, model)
    assert path.walks and path.stride[1] > 0.3
    slope = dict(zip(model.parameter_names, model.parameter_values, strict=True))["slope"]
    assert path.stride[0] / path.stride[1] == pytest.approx(np.tan(slope), abs=1e-10)
    ends = [0.0, *(moment for moment, one in path.events if one == "strike")]
    for k in range(2):
        for begin, end in pairwise(ends):
            feet = path.positions(k * path.period + np.linspace(begin, end, 9)[1:-1])[:, :, 0]
            assert np.ptp(feet, axis=0).max() < 1e-12
    before, after = path.positions(path.period * np.array([1 - 1e-12, 1 + 1e-12]))
    landed = np.linalg.norm(before - after[:, :1], axis=0)
    assert landed.min() < 1e-9 and (name == "rimless-wheel" or landed[-1] < 1e-9)
    ground = path.grounds(np.array([0.0, 2.5 * path.period]))
    for line in ground:  # one and the same straight line
        assert np.allclose(np.diff(line[0]) / np.diff(line[1]), np.tan(slope))
        assert line[0, 0] - ground[0, 0, 0] == pytest.approx((line[1, 0] - ground[0, 1, 0]) * np.tan(slope), abs=1e-9)


def test_what_flies_is_drawn_in_one_frame(found):
    """The mass of a runner goes on without a jump through touchdown, liftoff and apex."""
    orbit, model = found("slip-runner-stable")
    path = course_of(orbit, model)
    mass = path.positions(np.linspace(0, 2 * path.period, 2001)[:-1])[:, :, -1]
    assert np.abs(np.diff(mass, axis=0)).max() < 1.01 * 6 * path.period / 1000
    assert np.all(np.diff(mass[:, 1]) > 0)


def test_course_of_a_smooth_orbit_is_one_piece():
    orbit = of.find_orbit(load_problem(ROOT / "problems" / "examples" / "pendulum-2rad.toml"))
    model = build_model(orbit.system)
    path = course_of(orbit, model)
    assert not (path.jumps or path.walks or path.events or path.resets) and path.grounds(np.zeros(1)) is None
    assert path.positions(orbit.times[:5]) == pytest.approx(of.positions(model, orbit.samples[:5]), abs=1e-9)
    with pytest.raises(InputError, match="samples: 2 arcs where the orbit has 1"):
        course(model, np.array([0.0, 1.0, 1.0, 2.0]), np.zeros((4, 2)))


def test_figures_mark_events_and_dash_resets(found):
    orbit, model = found("kneed-walker")
    histories, portraits = plot.time_histories(orbit, model), plot.phase_portraits(orbit, model)
    upper = histories.axes[0]
    assert [text.get_text() for text in upper.texts] == ["knee", "strike"]
    curve = upper.lines[0].get_ydata()
    assert np.isnan(curve).sum() == 1
    dashed = [line for line in portraits.axes[1].lines if line.get_linestyle() == "--"]
    ends = np.array([line.get_xydata() for line in dashed])
    path = course_of(orbit, model)
    assert ends[0, 0] == pytest.approx(path.pieces[0].states[-1][[1, 4]])
    assert ends[-1, 1] == pytest.approx(orbit.state[[1, 4]])


def test_figures_of_every_kind_are_written(found, tmp_path):
    names = {
        "bouncing-ball": {"time_histories", "phase_portraits", "swept_configuration"},
        "slip-walker": {"time_histories", "phase_portraits", "swept_configuration", "energy_error"},
        "compass-gait": {"time_histories", "phase_portraits", "swept_configuration"},
    }
    for name, wanted in names.items():
        orbit, _ = found(name)
        file = of.save_orbit(orbit, tmp_path / name / "orbit.json")
        assert {one.stem for one in plot.save_figures(of.load_orbit(file), tmp_path / name)} == wanted


def test_swept_picture_keeps_its_ground_in_sight(found):
    orbit, model = found("wall-pendulum")
    (axes,) = plot.swept_configuration(orbit, model).axes
    (wall,) = [line for line in axes.lines if line.get_label() == "ground"]
    assert wall.get_xdata() == pytest.approx([0.2, 0.2]) and axes.get_xlim()[0] < 0.2 < axes.get_xlim()[1]
    assert axes.get_ylim()[0] > -3


def test_a_walker_walks_four_steps_in_its_animation(found):
    orbit, model = found("simplest-walker-period-2")
    clip = orbit_clip(orbit, model, AnimationSettings(rate=5))
    feet = clip.points[:, 1, 0]
    assert len(np.unique(feet.round(9))) == 4 and np.all(np.diff(feet) >= 0) and not clip.loops
    assert len(clip.cuts) == 4 and clip.ground.shape == (len(feet), 2, 2)
    frame = draw_frames(clip)[0]
    assert frame.size[0] > frame.size[1]


def test_a_ball_and_its_table_move(found):
    orbit, model = found("bouncing-ball")
    clip = orbit_clip(orbit, model)
    gap = clip.ground[:, 0, 0] - clip.points[:, 0, 0]
    assert clip.loops and gap.min() > -1e-9 and np.ptp(clip.ground[:, 0, 0]) == pytest.approx(0.024, rel=0.02)


def test_notebooks_show_mechanism_ground_and_portrait(found):
    for name in ("kneed-walker", "bouncing-ball"):
        orbit, _ = found(name)
        assert orbit_html(orbit).count("<svg") == 3 and orbit_html(orbit).count('stroke-opacity=".6"/><polyline') == 1
    portrait = moving(found("kneed-walker")[0])[1]  # solid through two arcs, dashed across two events
    assert portrait.count("<polyline") == 4 and portrait.count("dasharray") == 2
    smooth = of.find_orbit(of.Problem(of.chain(1), of.Guess([0.5, 0.0], 2.0), of.pin(theta1=0.5)))
    assert moving(smooth)[1].count("<polyline") == 1


def test_a_page_jumps_where_the_orbit_does(found, tmp_path):
    orbit, _ = found("simplest-walker-period-2")
    file = of.save_orbit(orbit, tmp_path / "orbit.json")
    (entry,) = gather([file]).orbits
    data = packed(Simulator().orbit(entry.document, entry.dense))
    bare = packed(Simulator().orbit(entry.document, None))
    assert data["jumps"] == bare["jumps"] and len(data["jumps"]) == 2 and data["jumps"][-1] == data["count"] - 1
    assert len(data["ground"]) == 1 and data["moving"] == bare["moving"]
    drawn = histories(Simulator().orbit(entry.document, entry.dense))
    states = np.frombuffer(base64.b64decode(drawn["data"]), "<f4").reshape(4, -1)
    leaps = np.flatnonzero(np.abs(np.diff(states[0])) > 0.1)  # where the page breaks its lines, and nowhere else
    assert drawn["jumps"] == [*leaps, drawn["count"] - 1] and len(leaps) == 1  # and from the end to the beginning
    assert states[:, -1] == pytest.approx(orbit.samples[-1], abs=1e-6)
    site, summary = build_site(gather([file]), SiteSettings("gaits"))
    assert summary.orbits == 1 and b"certified" in site.files["index.html"]


def test_a_page_shows_first_order_states_and_a_table_that_moves(found, tmp_path):
    orbit, _ = found("bouncing-ball")
    (entry,) = gather([of.save_orbit(orbit, tmp_path / "orbit.json")]).orbits
    motion = Simulator().orbit(entry.document, entry.dense)
    data = packed(motion)
    assert len(data["ground"]) == data["count"] and data["jumps"] == [data["count"] - 1]
    site, _ = build_site(gather([tmp_path / "orbit.json"]), SiteSettings("balls"))
    assert b"certified" in site.files["index.html"]


def test_a_family_is_drawn_by_simulation(found):
    orbit, model = found("simplest-walker-long")
    family = of.follow_family(orbit, "slope", until=0.0095)
    first, *_, last = motions(family, model)
    assert first.joints.shape[1:] == (2, 3) and last.point.value == pytest.approx(0.0095)
    times, states = sampled(build_model(last.point.system), last.point.state, last.point.period)
    assert last.states == pytest.approx(states) and times[-1] == pytest.approx(last.point.period, abs=1e-8)


def test_exports(found, tmp_path):
    """CSV has events twice; programs refuse and say why."""
    orbit, _ = found("kneed-walker")
    (file,) = export_orbit(orbit, "csv", tmp_path)
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    assert np.array_equal(table[:, 0], orbit.times) and (np.diff(table[:, 0]) == 0).sum() == 1
    for to in ("c", "julia", "auto"):
        with pytest.raises(InputError, match="files know no events, and this system is hybrid; use csv"):
            export_orbit(orbit, to, tmp_path)


def test_a_record_without_samples_is_simulated_again(found):
    """An event at the very end of a step: a record's state alone gives the motion that its samples show."""
    for name in ("rimless-wheel", "bouncing-ball", "wall-pendulum"):
        orbit, model = found(name)
        times, states = sampled(model, orbit.state, orbit.period)
        assert times[-1] == pytest.approx(orbit.period, rel=1e-12)
        assert np.allclose(states[-1], orbit.samples[-1], rtol=0, atol=1e-9)


def test_samples_go_on_in_time(found, tmp_path):
    """Times of events come twice, never three times, and never go back."""
    orbit, _ = found("kneed-walker")
    file = of.save_orbit(orbit, tmp_path / "orbit.json")
    assert np.array_equal(of.load_orbit(file).times, orbit.times)
    cut = int(np.flatnonzero(np.diff(orbit.times) == 0)[0])
    for at, value in ((cut - 1, orbit.times[cut]), (cut, orbit.times[cut + 3])):
        times = orbit.times.copy()
        times[at] = value
        np.savez(tmp_path / "orbit.npz", times=times, samples=orbit.samples)
        with pytest.raises(InputError, match="damaged"):
            of.load_orbit(file)


@pytest.mark.parametrize(
    "system, message",
    [
        ('function = "simplest_walker"\ncycle = ["strik"]', "system.cycle: unknown transition 'strik', did you mean"),
        ('function = "simplest_walker"\ncycle = "strike"', "system.cycle: must be a valid list"),
        ('function = "slip_runner"\ncycle = ["liftoff", "apex"]', "system.cycle: apex leads to flight, liftoff starts"),
        ('function = "duffing"\ncycle = ["strike"]', "system.cycle: the system is not hybrid"),
    ],
)
def test_cycles_in_problem_files_are_checked(tmp_path, system, message):
    file = tmp_path / "wrong.toml"
    file.write_text(f'[system]\nkind = "python"\n{system}\n[guess]\nstate = [0.2, 0.4, -0.2, 0.0]\nperiod = 3.9\n')
    with pytest.raises(InputError, match=message):
        load_problem(file)


def test_a_cycle_goes_through_the_file_and_back(found, tmp_path):
    orbit, _ = found("simplest-walker-period-2")
    assert orbit.system["cycle"] == ["strike", "strike"]
    text = orbit_text(orbit_to_document(orbit))
    file = tmp_path / "again.toml"
    file.write_text(text)
    assert load_problem(file).model.hybrid.cycle == ("strike", "strike")


def test_ground_and_cycle_change_together():
    model = simplest_walker()
    twice = with_cycle(model, ["strike", "strike"])
    assert twice.hybrid.ground is model.hybrid.ground and len(twice.hybrid.cycle) == 2


def test_guards_see_physical_parameters_only():
    """Shares of the period are the solver's; an impact works in a cycle of several arcs."""
    assert set(kneed_walker().parameter_names) > {"slope", "share_1"}
    symbols = of.Symbols(q := ca.SX.sym("q"), v := ca.SX.sym("v"))
    model = of.lagrange(v**2 / 2, q, symbols, names=["y"])
    bounce = [
        Transition(name, "air", "air", guard=lambda x, p: x.y - p.share_1, reset=lambda x, p: -x.y) for name in "ab"
    ]
    with pytest.raises(InputError, match="unknown name 'share_1'"):
        hybrid([Mode("air", model)], bounce, ["a", "b"])


def test_points_of_a_first_order_system_are_checked():
    with pytest.raises(InputError, match="points: shape"):
        of.ode(lambda t, x, p: [x.v, -x.x], ("x", "v"), points=lambda x, p: ca.vertcat(x.x, x.v, 0))
    drawn = of.ode(lambda t, x, p: [x.v, -x.x], ("x", "v"), points=lambda x, p: ca.vertcat(0, x.x))
    assert of.positions(drawn, np.array([[0.3, 0.1]]))[0, :, 0] == pytest.approx([0.0, 0.3])


@pytest.mark.slow
def test_a_cascade_goes_on_from_a_cycle_of_two(found):
    """Periods 2 to 4: closures do not grow with the arcs, and points are certified, drawn and rebuilt by themselves."""
    orbit, _ = found("simplest-walker-period-2")
    family = of.follow_family(orbit, "slope", until=0.0178)
    (doubling,) = [one for one in family.events if one.kind == "period_doubling"]
    assert doubling.free["slope"] == pytest.approx(0.0176693748626, abs=1e-9)
    settings = of.FamilySettings(parameter="slope", directions="away", points=2)
    last = of.follow_family(of.switch_branch(family, doubling), settings=settings).points[-1]
    assert last.closure < 5e-13 and last.period == pytest.approx(15.54, abs=5e-3)  # loops.mesh.STEP_ERROR
    assert set(last.system["arguments"]) == {"slope"} and last.system["cycle"] == ["strike"] * 4
    assert of.certify(last).passed
    shown = whole(last, build_model(last.system))
    assert shown.symmetry == "none" and (np.diff(shown.times) == 0).sum() == 3
