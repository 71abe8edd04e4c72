"""What a person sees at a terminal: lines that fit, a verdict in colour, help by purpose, a word at once."""

import io
import os
import re
from dataclasses import replace

import click
import pytest
from click.testing import CliRunner

from orbitfinder.cli import console, options
from orbitfinder.cli.continue_ import event_words
from orbitfinder.cli.group import PURPOSES, cli
from orbitfinder.records.certificate import Certificate, Check
from orbitfinder.records.family import Reading, load_family


@pytest.mark.parametrize("width", [40, 60, 80, 120])
@pytest.mark.parametrize("line", [
    "triple-1: certified, period 1.65533898831 s, energy -38.3510985746 J, closure 1.6e-14, unstable, symmetry none",
    "  closure                 2.32e-15  \u2264 3.90e-12   passed  DOP853 on Hamilton's equations; 2.7 round-offs",
    "  ended: merged (joins a family that is its own mirror image at energy -1.49589946 J, period 4.06518173 s)",
])  # fmt: skip
def test_lines_fit_and_lose_nothing(line: str, width: int) -> None:
    """No part is wider than the terminal, no word is broken, and together they say the same."""
    parts = options.folded(line, width)
    assert max(map(len, parts)) <= width
    assert " ".join(" ".join(parts).split()) == " ".join(line.split())
    assert all(part.startswith("  ") for part in parts[1:])


def test_a_number_stays_with_its_name() -> None:
    """A line of fields is broken after commas, so that `closure` and its number stay together."""
    parts = options.folded("triple-1: certified, period 1.65533898831 s, energy -38.3510985746 J, closure 8e-15", 78)
    assert len(parts) == 2 and parts[1] == "  closure 8e-15"


def test_verdicts_are_coloured_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Green or red there, and NO_COLOR is heard; no escape code in a pipe."""
    assert options.coloured("x: certified") == "x: " + click.style("certified", fg="green")
    assert click.style("REJECTED", fg="red", bold=True) in options.coloured("x: REJECTED by certified")
    assert "\x1b[32m" not in options.coloured("x: not certified")
    with click.Context(click.Command("x")):
        options.text("x: certified")
        options.next_step("page", "orbits")
    assert capsys.readouterr().out == "x: certified\n"
    monkeypatch.setattr(options, "on_terminal", lambda: True)
    monkeypatch.setenv("NO_COLOR", "1")
    with click.Context(click.Command("x"), color=True):
        options.next_step("page", "orbits")
        options.text("x: certified")
    assert capsys.readouterr().out == "next: orbitfinder page orbits\nx: certified\n"
    monkeypatch.delenv("NO_COLOR")
    with click.Context(click.Command("x"), color=True):
        options.text("x: certified")
    assert "\x1b[32m" in capsys.readouterr().out


def test_time_left_is_that_of_the_way_to_a_value_or_of_the_steps_that_may_come(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 2.0, 6.0, 0.0, 3.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(clock))
    towards = console.way_left(100, 4.0)
    assert [towards(1.0), towards(1.5), towards(2.0, 3.0), towards(4.0)] == ["", ", 10 s left", ", 3 s left", ""]
    steps = console.way_left(4, None, 0.0)
    assert steps(7.0) == ", 9 s left"


def test_every_command_stands_under_one_purpose_and_is_not_cut() -> None:
    """The help names all commands once, each with its whole sentence."""
    named = [name for names in PURPOSES.values() for name in names]
    assert sorted(named) == sorted(cli.commands)
    said = CliRunner().invoke(cli, ["--help"]).stdout
    assert "..." not in said.split("Options:")[1] and max(map(len, said.splitlines())) <= 80
    places = [said.index(f"\n{heading}:\n") for heading in PURPOSES]
    assert places == sorted(places)


def test_certificates_say_which_side_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """At least or at most, yes or no in words, the verdict last."""
    from orbitfinder.cli.verify import _print_certificate as printed

    lines: list[str] = []
    monkeypatch.setattr("orbitfinder.cli.verify.text", lines.append)
    checks = (Check("closure", 1e-14, 1e-12, True), Check("minimal_period", 0.05, 1e-6, True),
              Check("stability", 1.0, 0.0, False, "as recorded"))  # fmt: skip
    printed("orbit.json (x)", Certificate(checks))
    assert "\u2264 1.00e-12" in lines[1] and "\u2265 1.00e-06" in lines[2]
    assert re.search(r"stability +no +yes +FAILED +as recorded", lines[3])
    assert lines[-1] == "orbit.json (x): REJECTED by stability"


def test_something_is_said_before_anything_is_computed(capfd) -> None:
    """Without a terminal the first line is there as soon as the display is."""
    with console.display("triple-1: reading 1 file"):
        assert capfd.readouterr().err == "triple-1: reading 1 file\n"


def test_the_panel_shows_progress_and_the_last_events() -> None:
    """Rows, then the events with their numbers, in a frame with the family's name."""
    from rich.console import Console

    stream = io.StringIO()
    shown = console.Report("triple-mode-2", [("points", "41"), ("energy", "-41 J")], ["  3  fold at energy -40 J"])
    Console(file=stream, width=80).print(console._panel(shown))
    for part in ("triple-mode-2", "points", "-41 J", "  3  fold at energy -40 J"):
        assert part in stream.getvalue()


def test_events_are_told_in_words_with_units() -> None:
    """Kind without underscores, the parameter's unit, the period."""
    root = os.path.dirname(os.path.dirname(__file__))
    family = load_family(os.path.join(root, "results", "families", "triple-mode-2", "family.json"))
    doubling = next(one for one in family.events if one.kind == "period_doubling")
    older = replace(doubling, check=None)  # of a file of before there were error bars
    said = event_words(older, "energy", {})
    assert re.fullmatch(r"period doubling.* at energy -[\d.]+ J, period [\d.]+ s", said)
    check = Reading(0.0, 1e-9, True, parameter_error=3e-12)
    assert " J (+- 3e-12), period" in event_words(replace(family.events[0], check=check), "energy", {})
    assert older.error is None


def commands(group: click.Group, path: tuple[str, ...] = ()):
    """Every command with the words that call it."""
    for name, one in group.commands.items():
        if isinstance(one, click.Group):
            yield from commands(one, (*path, name))
        yield (*path, name)


@pytest.mark.parametrize("words", list(commands(cli)), ids=" ".join)
def test_no_line_of_any_help_is_wider_than_a_terminal(words: tuple[str, ...]) -> None:
    """80 columns; an example that goes on in the next line says so as a shell reads it, and is one command."""
    said = CliRunner().invoke(cli, [*words, "--help"]).stdout
    assert max(map(len, said.splitlines())) <= 80
    examples = said.partition("Examples:\n")[2].partition("\n\n")[0]
    joined = re.sub(r" \\\n +", " ", examples)
    assert all(re.match(r" +orbitfinder ", line) for line in joined.splitlines())


def test_page_wants_a_folder_and_counts_what_it_makes(tmp_path, monkeypatch: pytest.MonkeyPatch, capfd) -> None:
    """Without -o one sentence and no traceback; with it the first line at once, then how many of how many."""
    monkeypatch.setattr("orbitfinder.cli.export.SPEAK_EVERY", 0.0)
    orbit = os.path.join(os.path.dirname(os.path.dirname(__file__)), "results", "orbits", "triple-1")
    refused = CliRunner().invoke(cli, ["page", orbit])
    assert refused.exit_code == 2 and "Missing option '-o'" in refused.output
    made = CliRunner().invoke(cli, ["page", orbit, "-o", str(tmp_path / "site"), "--no-verify"])
    said = capfd.readouterr().err
    assert said.splitlines()[0].endswith("reading 1 path") and "orbit 1 of 1 judged" in said
    assert re.search(r"index.html: 1 orbit, [\d.]+ MB\n$", made.stdout)


def test_the_events_that_switch_takes_are_counted_in_short() -> None:
    """Runs of numbers as from and to."""
    from orbitfinder.families.branches import counted

    assert counted([0, 2, 3, 5, 6, 7, 8, 11]) == "0, 2, 3, 5 to 8, 11" and counted([]) == ""


def test_all_faults_of_a_problem_file_are_told_together(tmp_path) -> None:
    """Missing and wrong values first, unknown keys last, each with its field."""
    file = tmp_path / "bad.toml"
    file.write_text('nam = "x"\n[system]\nkind = "chain"\nlink = 3\n[guess]\nstate = [1, 2]\nperiod = -1\n')
    said = CliRunner().invoke(cli, ["run", str(file)]).stderr
    told = ("system.links: missing", "guess.period: must", "system.link: unknown", "nam: unknown")
    places = [said.index(what) for what in told]
    assert places == sorted(places)
