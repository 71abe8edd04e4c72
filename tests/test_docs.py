"""The documentation: every code block is executed, what it is said to print is compared, and the site builds.

A page runs from top to bottom in one folder (which has `problems/`) and one Python namespace:

    ```python          executed
    ```sh              each `orbitfinder` command, with exit code 0 unless a line `# exit 1` says otherwise
    ```toml title="x"  written to x first
    ```text            what the block before it prints: `...` stands for anything, as a line or within one

`<!-- slow -->` on a page moves it to the slow tests, `<!-- needs: flint -->` skips it where that module is
missing; pages in `PARSED_ONLY` are checked without being run. Lines of shell that are not ours are in `NOT_RUN`.
"""

import fnmatch
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
GENERATED = {"problem-file.md"}
PARSED_ONLY = {"cluster.md"}
"""Pages whose blocks need a cluster: Python is compiled, the options of our commands are parsed, nothing runs."""
FENCE = re.compile(r"^( *)```(\w*)([^\n]*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
NOT_RUN = (
    "python3 -m venv",  # makes an environment and installs
    ".venv/bin/pip install",
    "pip install",
    "mkdocs ",  # test_the_site_builds
    "sbatch ",  # needs a cluster
    "srun ",
    "cp results/atlas",  # so that the shipped files stay as they are; what follows makes a new one
    "dask ",
    "orbitfinder studio",  # serves until Ctrl-C; tests/test_studio.py
    "@r ",  # AUTO-07p; tests/test_export.py runs it
)
"""Starts of the shell lines that no test runs, with the reason."""


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, what follows the language, its text and its line."""

    language: str
    info: str
    text: str
    line: int

    @property
    def title(self):
        found = re.search(r'title="([^"]+)"', self.info)
        return found.group(1) if found else None


def blocks(page):
    text = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        indent, language, info, body = found.groups()
        lines = (line.removeprefix(indent) for line in body.splitlines())
        yield Block(language, info, "\n".join(lines), text.count("\n", 0, found.start()) + 1)


def is_slow(page):
    return "<!-- slow" in page.read_text(encoding="utf-8")


def parameters():
    for page in PAGES:
        runs = [block for block in blocks(page) if block.language in ("python", "sh")]
        if page.name not in GENERATED | PARSED_ONLY and runs:
            marks = [pytest.mark.slow] if is_slow(page) else []
            yield pytest.param(page, id=str(page.relative_to(DOCS).with_suffix("")), marks=marks)


def run_python(block, namespace, page):
    """Execute a block; returns what it printed."""
    import contextlib
    import io

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(block.text, f"{page.name}:{block.line}", "exec"), namespace)
    return printed.getvalue()


def run_shell(block):
    """Run each of our commands in this process; returns what they printed on standard output."""
    printed, wanted = "", 0
    for line in joined(block.text):
        if line.startswith("# exit "):
            wanted = int(line.removeprefix("# exit "))
            continue
        if not line or line.startswith(("#", *NOT_RUN)):
            continue
        words = shlex.split(line, comments=True)
        if words[:2] == ["python", "-m"]:
            result = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True, check=False)
            code, out, err = result.returncode, result.stdout, result.stderr
        else:
            assert words[0] == "orbitfinder", f"{line!r} is not one of our commands; list it in NOT_RUN with a reason"
            answer = CliRunner().invoke(cli, words[1:], catch_exceptions=False)
            code, out, err = answer.exit_code, answer.stdout, answer.stderr
        assert code == wanted, f"{line}: exit code {code}\n{out}{err}"
        printed += out
        wanted = 0
    return printed


def joined(text):
    """Lines with continuations put together."""
    return text.replace("\\\n", " ").splitlines()


def assert_printed(expected, printed, where):
    """Every expected line comes, in order; `...` stands for anything."""
    rest = [line.rstrip() for line in printed.splitlines()]
    for line in expected.splitlines():
        if line.strip() in ("...", ""):
            continue
        pattern = line.rstrip().replace("[", "[[]").replace("...", "*")
        while rest and not fnmatch.fnmatchcase(rest[0], pattern):
            rest.pop(0)
        assert rest, f"{where}: {line!r} was not printed; printed was\n{printed}"
        rest.pop(0)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder with the problem files of the repository."""
    shutil.copytree(ROOT / "problems", tmp_path / "problems")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))  # as Python does for the current folder
    known = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - known:
        if str(getattr(sys.modules[name], "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.mark.parametrize("page", list(parameters()))
def test_page_runs(page, folder):
    """The blocks of a page, in order, do and print what the page says."""
    for module in re.findall(r"<!-- needs: (\w+) -->", page.read_text(encoding="utf-8")):
        pytest.importorskip(module)
    if "results/atlas/" in page.read_text(encoding="utf-8"):
        shutil.copytree(ROOT / "results" / "atlas", folder / "results" / "atlas")
    namespace, printed = {"__name__": "__main__"}, None
    for block in blocks(page):
        where = f"{page.relative_to(ROOT)}:{block.line}"
        if block.title:
            (folder / block.title).write_text(block.text + "\n", encoding="utf-8")
            printed = None
        elif block.language == "python":
            printed = run_python(block, namespace, page)
        elif block.language == "sh":
            printed = run_shell(block)
        elif block.language == "text" and printed is not None:
            assert_printed(block.text, printed, where)
            printed = None


@pytest.mark.parametrize("name", sorted(PARSED_ONLY))
def test_pages_that_need_a_cluster_are_correct_as_far_as_can_be_told(name):
    """Names that they use of ours exist, and our commands take the options that they give."""
    import ast

    import orbitfinder as of

    for block in blocks(DOCS / name):
        if block.language == "python":
            for node in ast.walk(ast.parse(block.text)):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "of":
                    assert hasattr(of, node.attr), node.attr
        for line in joined(block.text) if block.language == "sh" else ():
            words = shlex.split(line.removesuffix("&"), comments=True)
            if words[:1] == ["orbitfinder"]:
                command = cli.commands[words[1]]
                command.make_context(words[1], words[2:])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_blocks_declare_their_language(page):
    """A fence without a language is run by nobody."""
    text = page.read_text(encoding="utf-8")
    assert all(block.language for block in blocks(page))
    assert len(re.findall(r"^ *```", text, re.MULTILINE)) == 2 * len(list(blocks(page)))


@pytest.mark.parametrize("page", list(parameters()))
def test_pages_say_how_long_their_examples_take(page):
    """Every page that runs something says in seconds how long that takes."""
    text = page.read_text(encoding="utf-8")
    assert re.search(r"\btakes?\s(about|a|from)\s[\w\s()]*(second|minute)", text, re.IGNORECASE)


def test_expected_output_is_compared():
    """The comparison itself: order matters, `...` is anything, a missing line is an error."""
    assert_printed("period 1.65... s\n...\nlast", "noise\nperiod 1.6553 s\nmore\nlast\n", "page")
    with pytest.raises(AssertionError, match="was not printed"):
        assert_printed("period 1.7... s", "period 1.6553 s\n", "page")
    with pytest.raises(AssertionError, match="was not printed"):
        assert_printed("b\na", "a\nb\n", "page")


def test_unknown_commands_and_wrong_exit_codes_fail(folder):
    with pytest.raises(AssertionError, match="not one of our commands"):
        run_shell(Block("sh", "", "rm -rf problems", 1))
    with pytest.raises(AssertionError, match="exit code 2"):
        run_shell(Block("sh", "", "orbitfinder verify none.json", 1))
    run_shell(Block("sh", "", "# exit 2\norbitfinder verify none.json", 1))


def test_every_page_is_in_the_navigation():
    """mkdocs --strict warns of the reverse; a page that nobody can reach is of no use either."""
    named = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    assert {str(page.relative_to(DOCS)) for page in PAGES} == named


def test_nothing_is_loaded_from_the_network():
    """No web fonts, no scripts or styles from elsewhere."""
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "font: false" in settings and "extra_javascript" not in settings and "http://" not in settings


def test_the_site_builds(tmp_path):
    """mkdocs --strict: no warning, no dead link; the reference is there and the pages ask the network for nothing."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    few = {
        **os.environ,
        "ORBITFINDER_DOCS": "few",
    }  # two systems of each kind; tests/test_systems_gallery.py sees them all
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=few)
    assert result.returncode == 0, result.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) >= len(PAGES)
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="(https?://[^"]*)"', text)
        assert not loaded, page
    reference = (tmp_path / "site" / "reference" / "python" / "find.html").read_text(encoding="utf-8")
    assert all(name in reference for name in ("find_orbit", "certify", "growth_per_segment", "ConvergenceError"))
    assert 'href="find.html#orbitfinder.orbits.certify.certify"' in reference or "families.html#" in reference
    gallery = (tmp_path / "site" / "gallery" / "chains.html").read_text(encoding="utf-8")
    assert "<animate" in gallery and "aligned" in gallery and "of.chain(" in gallery
    commands = (tmp_path / "site" / "reference" / "commands.html").read_text(encoding="utf-8")
    assert "Recompute the certificate of each ORBIT.json" in commands
