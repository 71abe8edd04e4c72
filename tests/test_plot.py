"""Figures of an orbit: what they show, that they are whole, that odd input does not break them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.text import Text

import orbitfinder as of
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.modes import normal_mode
from orbitfinder.records.family import load_family
from orbitfinder.show import plot
from orbitfinder.show.diagram import changes, verdicts
from orbitfinder.show.scene import tip
from orbitfinder.show.style import arrows, line_style, new_figure, place_labels, rounded, save_png, told_in
from orbitfinder.show.svg import COLOURS

RESULTS = Path(__file__).parents[1] / "results"
NAMES = {"time_histories.png", "phase_portraits.png", "swept_configuration.png", "energy_error.png"}


@pytest.fixture(scope="module")
def orbit():
    model = chain(2)
    return find_orbit(Problem(model, normal_mode(model, 1, 0.4), pin=pin(energy=-18.0), title="Double"))


def drawn(figure):
    """The figure laid out and rendered; every text lies inside it."""
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    for text in [
        *figure.texts,
        *(axes.xaxis.label for axes in figure.axes),
        *(axes.yaxis.label for axes in figure.axes),
    ]:
        if text.get_visible() and text.get_text():
            box = text.get_window_extent()
            assert box.x0 >= -1 and box.y0 >= -1 and box.x1 <= width + 1 and box.y1 <= height + 1, text.get_text()
    return figure


def test_save_figures_writes_four_png_files(orbit, tmp_path):
    paths = plot.save_figures(orbit, tmp_path / "new")
    assert {path.name for path in paths} == NAMES == {path.name for path in (tmp_path / "new").iterdir()}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_pyplot_is_not_touched(orbit, tmp_path):
    """No global figure is left behind, and no display is needed."""
    import matplotlib.pyplot as plt

    plot.save_figures(orbit, tmp_path)
    assert plt.get_fignums() == []


def test_every_axis_has_a_label_with_a_unit(orbit):
    model = build_model(orbit.system)
    for make in (plot.phase_portraits, plot.swept_configuration):
        for axes in drawn(make(orbit, model)).axes:
            assert "(" in axes.get_xlabel() and "(" in axes.get_ylabel()
    for make in (plot.time_histories, plot.energy_error):
        upper, lower = drawn(make(orbit, model)).axes
        assert lower.get_xlabel() == "time (s)" and "(" in upper.get_ylabel() and "(" in lower.get_ylabel()


def test_what_goes_over_decades_is_drawn_in_logarithms_and_nothing_else():
    orbit = of.load_orbit(Path(__file__).parents[1] / "results/gallery/lorenz/orbit.json")
    stretched = replace(orbit, samples=orbit.samples * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0])
    stretched.samples[:, 2] = np.exp(orbit.samples[:, 0])
    scales = [axes.get_yscale() for axes in plot.time_histories(stretched, build_model(orbit.system)).axes]
    assert scales == ["linear", "linear", "log"]


def test_time_histories_are_the_samples(orbit):
    upper, lower = plot.time_histories(orbit, build_model(orbit.system)).axes
    for k in range(2):
        np.testing.assert_array_equal(upper.lines[k].get_ydata(), orbit.samples[:, k])
        np.testing.assert_array_equal(lower.lines[k].get_ydata(), orbit.samples[:, 2 + k])


def test_swept_configuration_hangs_down(orbit):
    """x points down and y to the right: the tip is drawn at (y, -x), on equal axes."""
    axes = plot.swept_configuration(orbit, build_model(orbit.system)).axes[0]
    tip = next(line for line in axes.lines if line.get_label() == "path of the tip")
    first, second = orbit.samples[:, 0], orbit.samples[:, 1]
    np.testing.assert_allclose(tip.get_xdata(), np.sin(first) + np.sin(second), atol=1e-12)
    np.testing.assert_allclose(tip.get_ydata(), -np.cos(first) - np.cos(second), atol=1e-12)
    assert axes.get_aspect() == 1.0


def test_energy_error_is_small_and_starts_at_zero(orbit):
    _, lower = plot.energy_error(orbit, build_model(orbit.system)).axes
    error = lower.lines[0].get_ydata()
    assert error[0] == 0 and np.abs(error).max() < 1e-9


@pytest.mark.parametrize("title", ["$\\frac{1", "x" * 300, "long words again and " * 20, "a_b^c % {} \\"])
def test_titles_are_text_and_never_clipped(orbit, title):
    """Mathematics markup in a title is shown as it stands; long titles are wrapped."""
    model = build_model(orbit.system)
    for make in (plot.time_histories, plot.phase_portraits, plot.swept_configuration, plot.energy_error):
        drawn(make(replace(orbit, title=title), model))


def test_letters_that_the_font_lacks_are_boxes_and_no_warning(orbit, tmp_path):
    figure = plot.energy_error(replace(orbit, title="\u632f\u5b50 \x1b[2J"), build_model(orbit.system))
    assert save_png(figure, tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize(
    "links",
    [1, *(pytest.param(many, marks=pytest.mark.slow) for many in (4, 9, 20, 40))],
)
def test_any_number_of_links(orbit, links, tmp_path):
    model = chain(links)
    times = np.linspace(0, 1, 65)
    angles = 0.1 * np.outer(np.cos(2 * np.pi * times), np.arange(1, links + 1))
    rates = -0.2 * np.pi * np.outer(np.sin(2 * np.pi * times), np.arange(1, links + 1))
    many = replace(orbit, system=model.system, times=times, samples=np.hstack([angles, rates]), period=1.0)
    assert len(plot.save_figures(many, tmp_path)) == 4
    assert len(drawn(plot.phase_portraits(many, model)).axes) >= min(links, plot.MOST_PORTRAITS)


def test_orbit_without_samples_says_so(orbit):
    bare = replace(orbit, times=np.zeros(0), samples=np.zeros((0, 4)))
    with pytest.raises(InputError, match=r"orbit\.npz"):
        plot.time_histories(bare, build_model(orbit.system))


def test_no_event_hides_another_at_its_place():
    """Where a branch point changes the stability, the diamond is behind it and larger; nothing larger lies above."""
    family = load_family(RESULTS / "families" / "triple-mode-2" / "family.json")
    (axes,) = plot.frequency_energy([family]).axes
    marks = [line for line in axes.lines if line.get_linestyle() == "None"]
    places = np.array([np.concatenate(line.get_data()) for line in marks])
    together = [
        (marks[i], marks[j]) for i in range(len(marks)) for j in range(i)
        if {marks[i].get_marker(), marks[j].get_marker()} == set("Do") and np.allclose(places[i], places[j], rtol=1e-9)
    ]  # fmt: skip
    assert len(together) == 3
    for pair in together:
        above, below = sorted(pair, key=lambda one: -one.get_zorder())
        assert above.get_marker() == "o" and above.get_markersize() < 0.7 * below.get_markersize()


def test_curves_can_be_told_apart():
    """Up to 28 curves no two share colour and dashes; the palette has no yellow on white."""
    styles = [line_style(k, 28) for k in range(28)]
    assert len({(style["color"], style["linestyle"]) for style in styles}) == 28
    assert "#F0E442" not in COLOURS


def test_indices_break_where_they_pass_through_infinity() -> None:
    """A jump from one side of a pole to the other is no crossing; a steep crossing is kept."""
    values = np.arange(5.0)
    across, line = plot.unpoled(values, np.array([3.0, 40.0, -900.0, -5.0, 1.0]))
    assert np.isnan(line).tolist() == [False, False, True, False, False, False] and across.size == line.size
    assert np.array_equal(plot.unpoled(values, np.array([3.0, 1.0, -5.0, 2.0, 0.0]))[1], [3.0, 1.0, -5.0, 2.0, 0.0])


def test_names_do_not_lie_on_each_other() -> None:
    """Ten names at one place have boxes that are apart, inside the frame."""
    figure = new_figure(6.0, 4.0, "names")
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0])
    place_labels(figure, axes, [(f"event {k}", 0.5, 0.5 + 0.01 * k) for k in range(10)])
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]  # not the lines that lead to far names
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    frame = axes.get_window_extent()
    assert all(frame.contains(*box.min) and frame.contains(*box.max) for box in boxes)


def test_one_family_is_coloured_by_stability_and_events_have_their_own_colours() -> None:
    family = load_family(RESULTS / "families" / "triple-mode-2" / "family.json")
    (axes,) = plot.frequency_energy([family]).axes
    curves = {line.get_linestyle(): line.get_color() for line in axes.lines if line.get_linestyle() != "None"}
    assert curves == {"-": plot.STABLE, "--": plot.UNSTABLE}
    unsure = replace(family, points=tuple(replace(point, stability="marginal") for point in family.points))
    (axes,) = plot.frequency_energy([unsure]).axes
    assert {line.get_linestyle() for line in axes.lines} - {"None"} == {":"}
    marks = {line.get_color() for line in axes.lines if line.get_linestyle() == "None"}
    assert len(marks) > 3 and not marks & {plot.STABLE, plot.UNSTABLE}


def test_curves_have_no_corners_and_go_through_their_points() -> None:
    """Twelve points of a circle in two stretches that meet: on it to a thousandth, turned by little at each place."""
    angles = np.linspace(0, 2 * np.pi, 13)
    circle = np.column_stack([np.cos(angles), 50 * np.sin(angles)])
    (_, first), (_, second) = rounded([(True, circle[:6]), (False, circle[5:])])
    assert np.array_equal(first[-1], second[0]) and np.abs(first[::8] - circle[:6]).max() < 1e-12
    whole = np.vstack([first, second[1:]]) / [1, 50]
    assert np.abs(np.linalg.norm(whole, axis=1)[8:-8] - 1).max() < 2e-3
    steps = np.diff(whole, axis=0)
    turns = np.diff(np.unwrap(np.arctan2(*steps.T)))
    assert np.abs(turns).max() < 0.12 < 2 * np.pi / 12 / 3  # of the polygon 0.52


def test_families_are_drawn_in_coordinates_of_ones_own(tmp_path) -> None:
    """By quantities that are asked for, in a window, with the fonts of a style sheet, which others do not have then."""
    file, sheet = RESULTS / "families" / "five-bar-length" / "family.json", tmp_path / "own.mplstyle"
    sheet.write_text("font.size: 17")
    asked = ["plot", str(file), "--across", "arclength", "--up", "period", "--xlim", "0,40", "-o", str(tmp_path)]
    plain, larger = CliRunner().invoke(cli, asked), tmp_path / "chosen.png"
    assert plain.exit_code == 0 and plain.output.strip() == str(larger)
    before = larger.read_bytes()
    assert CliRunner().invoke(cli, [*asked, "--style", str(sheet)]).exit_code == 0 and larger.read_bytes() != before
    assert CliRunner().invoke(cli, asked).exit_code == 0 and larger.read_bytes() == before
    for wrong, words in (
        (["--across", "foo"], "foo: not known along five-bar-length; it has energy, period"),
        (["--xlim", "2,1"], "give LOW,HIGH"),
        (["--style", "nope"], "style: nope: no style sheet"),
    ):
        refused = CliRunner().invoke(cli, ["plot", str(file), *wrong, "-o", str(tmp_path)])
        assert refused.exit_code == 2 and words in refused.output


def test_branches_of_auto_are_drawn_beside_a_family(tmp_path, monkeypatch) -> None:
    """Marks at AUTO's points, filled where it says stable, under the family, by default with the period upwards."""
    file = RESULTS / "families" / "five-bar-length" / "family.json"
    family, beside, drawn = load_family(file), tmp_path / "b.bar", []
    name, values = family.parameter, family.values("value")
    head = f"   0    PT  TY  LAB     {name}            MAX theta1              PERIOD\n"
    rows = [(values[0], 0.5, family.points[0].period, 1), (values[-1], 0.25, 7.5, -2)]
    beside.write_text(head + "".join(f"   1 {pt} 0 0 {p:.17g} {q} {t:.17g}\n" for p, q, t, pt in rows))
    monkeypatch.setattr(plot, "save_png", lambda figure, path: drawn.append(figure) or path)
    asked = ["plot", str(file), "--beside", str(beside), "-o", str(tmp_path)]
    assert CliRunner().invoke(cli, asked, catch_exceptions=False).exit_code == 0
    assert CliRunner().invoke(cli, [*asked, "--up", "max_theta1"], catch_exceptions=False).exit_code == 0
    for figure, up, called in zip(drawn, (2, 1), ("period", "greatest theta1"), strict=True):
        (axes,) = figure.axes
        (marks,) = axes.collections
        assert marks.get_offsets().tolist() == [[row[0], row[up]] for row in rows] and called in axes.get_ylabel()
        assert marks.get_facecolors()[:, 3].tolist() == [0.0, 1.0] and marks.get_zorder() < axes.lines[0].get_zorder()
        assert axes.get_legend().get_texts()[0].get_text() == "b.bar: AUTO, filled where stable"
    for more, why in (
        (
            [*asked, "--up", "frequency"],
            f"no branch has {name}, frequency, PT; the last has {name}, max_theta1, period; AUTO",
        ),
        ([*asked[:3], str(tmp_path / "b.none")], "b.none: no such file"),
        ([*asked[:3], str(tmp_path)], "a folder, not a file"),
        (["plot", f"{file}#0", *asked[2:]], "--xlim and --beside take families; leave them out"),
    ):
        refused = CliRunner().invoke(cli, more)
        assert refused.exit_code == 2 and why in refused.output, refused.output


def test_stretches_of_one_stability_meet_at_the_events_between_them() -> None:
    family = load_family(RESULTS / "families" / "five-bar-length" / "family.json")
    told, said = changes(family), verdicts(family)
    assert told and all(said[k] != said[k - 1] for k, _ in told)
    for k, at in told:
        if at is not None:
            low, high = family.points[k - 1].arclength, family.points[k].arclength
            assert low <= family.events[at].arclength <= high
    unsure = replace(family, points=(replace(family.points[0], stability="marginal"), *family.points[1:]))
    assert verdicts(unsure)[0] is None and changes(unsure)[0][0] == 1


def test_distance_from_a_level_is_logarithmic(tmp_path) -> None:
    """What gathers at the saddle of Henon and Heiles is spread; orbits are no families."""
    family = load_family(RESULTS / "families" / "henon-heiles-straight" / "family.json")
    (axes,) = plot.frequency_energy([family], level=1 / 6).axes
    assert axes.get_xscale() == "log" and "distance" in axes.get_xlabel()
    with pytest.raises(InputError, match="take families"):
        plot.save_frequency_energy([family.points[0]], tmp_path / "x.png")


def test_multipliers_stand_against_periods_one_panel_an_energy() -> None:
    """No axis mixes joules and logarithms."""
    with Atlas(RESULTS / "atlas" / "triple.sqlite") as atlas:
        rows = atlas.rows()
    figure = plot.energy_period(rows)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [f"\N{MINUS SIGN}{size} J" for size in (40, 35, 30)]
    drawn_marks = sum(len(line.get_xdata()) for axes in figure.axes for line in axes.lines)
    assert drawn_marks == len(rows) and all(axes.get_yscale() == "log" for axes in figure.axes)


def test_arrows_follow_time() -> None:
    """Of a circle run clockwise and one run the other way they point differently."""
    turn = np.linspace(0.0, 2 * np.pi, 200)
    for way in (1.0, -1.0):
        axes = new_figure(4.0, 4.0, "x").subplots()
        arrows(axes, np.cos(way * turn), np.sin(way * turn), "black", 1)
        (arrow,) = axes.texts
        (x, y), (dx, dy) = arrow.xyann, np.subtract(arrow.xy, arrow.xyann)
        assert np.sign(x * dy - y * dx) == way


def test_figures_of_equations_without_units_say_none():
    """Axes, titles and numbers of Henon-Heiles carry no J, s or m; a pendulum's do."""
    orbit = of.load_orbit(RESULTS / "gallery" / "henon-heiles-loop" / "orbit.json")
    figure = plot.energy_error(orbit, build_model(orbit.system))
    said = [text.get_text() for text in figure.findobj(Text)]
    assert "energy (J)" in said and any(text.endswith(" s") for text in said)
    left = [text.get_text() for text in told_in(figure, {"function": "lorenz"}).findobj(Text)]
    assert "energy" in left and "time" in left and not any(re.search(r"\((J|s|m)\)|\d s$", text) for text in left)


def test_the_path_of_the_tip_is_that_of_the_last_point_that_moves():
    """Of an outline that ends in its own hinge the corner before; nan between arcs and what stands still count not."""
    turn = np.linspace(0.0, 1.0, 7)
    arm, pin_ = np.stack([np.cos(turn), np.sin(turn)]), np.zeros((2, 7))
    assert tip(np.stack([pin_, arm, 2 * arm, pin_], axis=-1).transpose(1, 0, 2)) == 2
    walked = np.stack([pin_, arm], axis=-1).transpose(1, 0, 2)
    walked[3] = np.nan
    assert tip(walked) == 1 and tip(np.zeros((7, 2, 3))) == -1


def test_what_has_no_energy_is_given_none() -> None:
    """No panel and no curve of an atlas of a dissipative system says 0 J."""
    with Atlas(RESULTS / "atlas" / "rossler.sqlite") as atlas:
        figures = [plot.energy_period(atlas.rows(), conserved=False), plot.discovery_curves(atlas)]
        shown = atlas._repr_html_()
    said = [text.get_text() for figure in figures for text in figure.findobj(Text)]
    assert not any(" J" in words for words in said) and any(words.startswith("seed 0: ") for words in said)
    assert "energy" not in shown and ">period<" in shown
