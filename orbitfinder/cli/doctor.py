"""The commands `doctor` and `completion`: what of this installation works, and what makes it easier to use."""

from __future__ import annotations

import math
import os
import platform
import re
import shutil
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path

import click

import orbitfinder as of
from orbitfinder._runtime import __version__
from orbitfinder._runtime.quiet import captured
from orbitfinder.cli.options import finish, json_option, text
from orbitfinder.errors import LimitError

WIDTH, INDENT = 80, 31
"""Columns of the report, and where details begin"""
OK, NOTE, MISSING, BROKEN = "ok", "note", "missing", "BROKEN"
EXTRAS = {
    "mp4": "animate -o FILE.mp4", "proof": "prove and refine", "cluster": "search --scheduler (Dask)",
    "parquet": "atlas export --to parquet", "robot": "URDF and MJCF files, SymPy's systems",
    "sbml": "SBML files",
    "studio": "studio: mechanisms dragged to orbits",
    "notebook": "orbit.widget(), the notebooks", "docs": "building the documentation",
    "browser": "tests of pages in a browser", "test": "the tests",
    "compiler": "a C compiler where there is no other",
}  # fmt: skip
"""What each optional extra is for; what a release does not declare is not asked about."""


@dataclass(frozen=True)
class Finding:
    """One thing seen at: `status` ok, note, missing (optional) or BROKEN (essential), and what to do."""

    name: str
    status: str
    detail: str
    remedy: str = ""


def finding(name: str, fine: object, detail: str, remedy: str, otherwise: str = MISSING) -> Finding:
    """What is fine, or `otherwise`, with what to do about it."""
    return Finding(name, OK, detail) if fine else Finding(name, otherwise, detail, remedy)


def examine() -> list[Finding]:
    """Every finding, essential ones first. Takes about two seconds, most of them imports."""
    return [*essential(), *tools(), *extras(), *defects()]


def essential() -> Iterator[Finding]:
    """What the main job cannot do without, the main job included."""
    fits = sys.version_info[:2] >= (3, 11)
    yield finding("python", fits, platform.python_version(), "use Python 3.11 to 3.15", BROKEN)
    for name in (
        "casadi", "numpy", "scipy", "matplotlib", "pillow", "click", "pydantic", "rich", "threadpoolctl",
        "platformdirs", "jinja2", "lazy_loader",
    ):  # fmt: skip
        again = "pip install --force-reinstall orbitfinder"
        yield _asked(name, partial(_package, name), "cannot be imported: ", again)
    for name, kind in {"cvodes": "integrator", "idas": "integrator", "ipopt": "nlpsol"}.items():
        wheel = "install the casadi wheel from the package index; system packages often lack plugins"
        yield _asked(f"casadi {name}", partial(_plugin, name, kind), "cannot be asked for: ", wheel)
    yield _main_job()


def _asked(name: str, ask: Callable[[], tuple[object, str]], trouble: str, remedy: str) -> Finding:
    """What an essential part answers, or that it cannot be asked: a broken wheel raises whatever its loader makes."""
    try:
        fine, detail = ask()
    except LimitError:
        raise
    except Exception as error:
        fine, detail = False, f"{trouble}{type(error).__name__}: {error}"
    return finding(name, fine, detail, remedy, BROKEN)


def _package(name: str) -> tuple[object, str]:
    """An installed distribution that can be imported, and its version."""
    from importlib import metadata

    import_module({"pillow": "PIL"}.get(name, name))
    return True, metadata.version(name)


def _plugin(name: str, kind: str) -> tuple[object, str]:
    """A solver that CasADi loads at run time; a wheel has it, some system packages do not."""
    there = bool(getattr(import_module("casadi"), f"has_{kind}")(name))
    return there, "plugin loads" if there else "plugin missing"


def _main_job() -> Finding:
    """A pendulum swing solved and certified, its period compared with the elliptic integral."""
    try:
        from scipy.special import ellipk

        exact = 4 * float(ellipk(math.sin(0.5) ** 2)) / math.sqrt(9.8 * 0.5 * 3)
        orbit = of.find_orbit(of.Problem(of.chain(1), of.Guess([1.0, 0.0], 1.8), of.pin(theta1=1.0)))
        error = abs(orbit.period / exact - 1)
        fine = error < 1e-11 and of.certify(orbit).passed
        detail = f"pendulum at 1 rad certified, period off the elliptic integral by {error:.0e}"
        return finding("main job", fine, detail, "please report this with the output", BROKEN)
    except LimitError:
        raise
    except Exception as error:
        return Finding("main job", BROKEN, f"{type(error).__name__}: {error}", "see the findings above")


def tools() -> Iterator[Finding]:
    """Programs and folders outside Python: compiler, cache, browser, AUTO."""
    from orbitfinder.integrate.compiled import available, mode

    compiler, reason = available()
    said = f"{reason or 'runs'} (mode {mode()})"
    remedy = "install gcc or clang, or pip install 'orbitfinder[compiler]'; without one everything runs interpreted"
    yield finding("C compiler", compiler, said, remedy)
    yield _cache()
    browsers = ("chromium", "chromium-browser", "google-chrome", "chrome", "firefox")
    browser = next(filter(None, map(shutil.which, browsers)), None)
    remedy = "any browser opens the pages; headless Chromium is needed for their tests only"
    yield finding("browser", browser, browser or "none on the path", remedy)
    auto = next(filter(os.path.isdir, (os.environ.get("AUTO_DIR", ""), "/usr/lib/auto-07p")), None)
    remedy = "only to run what export --to auto writes; set AUTO_DIR"
    yield finding("AUTO-07p", auto, auto or "not found", remedy)


def _cache() -> Finding:
    from orbitfinder.integrate.compiled import usable

    try:
        place = usable()
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        remedy = "set ORBITFINDER_CACHE to a folder that you, and nobody else, can write to"
        return Finding("cache", NOTE, f"not used, nothing is compiled: {error}", remedy)
    entries = [entry for entry in place.glob("*.so") if not entry.name.startswith("making-")]
    size = sum(entry.stat().st_size for entry in entries)
    if place.is_relative_to(Path.home()):
        place = Path("~") / place.relative_to(Path.home())
    return Finding("cache", OK, f"{place}: {len(entries)} compiled functions, {size / 1e6:.1f} MB")


def extras() -> Iterator[Finding]:
    """Each optional extra of this release: complete, or what it lacks."""
    for extra, wanted in declared_extras().items():
        lacking = [name for name in wanted if not _installed(name)]
        use = EXTRAS.get(extra, extra)
        detail = f"without {', '.join(lacking)}" if lacking else f"for {use}"
        yield finding(f"extra {extra}", not lacking, detail, f"pip install 'orbitfinder[{extra}]', for {use}")


def declared_extras() -> dict[str, list[str]]:
    """Extra -> distributions, as the installed metadata declares them."""
    from importlib import metadata

    declared: dict[str, list[str]] = {}
    try:
        requirements = metadata.requires("orbitfinder") or []
    except metadata.PackageNotFoundError:  # run from a source tree that was never installed
        return declared
    for line in requirements:
        match = re.match(r"([A-Za-z0-9._-]+).*extra == ['\"]([^'\"]+)['\"]", line)
        if match:
            declared.setdefault(match.group(2), []).append(match.group(1))
    return declared


def _installed(distribution: str) -> bool:
    from importlib import metadata

    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True


def defects() -> Iterator[Finding]:
    """Known CasADi defects, tried here (0.1 s): present ones are notes, since orbitfinder goes round them."""
    try:
        from orbitfinder.cli.casadi_bugs import TRIALS

        yield from [_defect(*trial) for trial in TRIALS]
    except LimitError:
        raise
    except Exception as error:
        yield Finding("casadi defects", NOTE, f"not tried: {type(error).__name__}: {error}")


def _defect(name: str, reference: str, trial: Callable[[], tuple[bool, str]], instead: str) -> Finding:
    """What a trial of a defect shows."""
    try:
        with captured():
            present, seen = trial()
    except RuntimeError as error:
        present, seen = True, f"could not be tried: {str(error).strip().splitlines()[-1]}"
    if not present:
        return Finding(name, OK, f"CasADi: defect absent ({reference})")
    return Finding(name, NOTE, f"CasADi: {seen} ({reference})", f"no action: here {instead}")


def report(seen: Finding) -> list[str]:
    """A finding in lines of at most 80 columns: its detail, below it what to do."""
    said = [line for what in (seen.detail, seen.remedy) for line in textwrap.wrap(
        what, WIDTH - INDENT, break_long_words=False, break_on_hyphens=False)]  # fmt: skip
    head = f"  {seen.status:<8}{seen.name}"
    return [f"{head if not k else '':<{INDENT}}{line}" for k, line in enumerate(said)]


@click.command()
@json_option
def doctor() -> None:
    """Check this installation: packages, CasADi plugins and known defects, compiler, cache, extras.

    Finds and certifies one pendulum swing on the way. Exit code 0: usable; 1: something essential is
    missing or wrong, and is marked BROKEN. Takes about three seconds.

    \b
    Examples:
      orbitfinder doctor
      orbitfinder doctor --json
    """
    findings = examine()
    usable = all(finding.status != BROKEN for finding in findings)
    text(f"orbitfinder {__version__} on {platform.platform()}")
    for line in (line for finding in findings for line in report(finding)):
        text(line)
    text("Usable." if usable else "Not usable: see what is marked BROKEN.")
    finish("doctor", {"version": __version__, "usable": usable, "findings": findings}, usable)


SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the completion script for a SHELL; the shell reads it when it starts.

    \b
    Examples:
      orbitfinder completion bash >> ~/.bashrc
      orbitfinder completion zsh >> ~/.zshrc
      orbitfinder completion fish > ~/.config/fish/completions/orbitfinder.fish
    """
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "orbitfinder", "_ORBITFINDER_COMPLETE").source())
