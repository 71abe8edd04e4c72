"""The documentation: every code block is executed, what it is said to print is compared, and the site builds.

A page runs from top to bottom in one folder (which has `problems/`) and one Python namespace:

    ```python          executed
    ```sh              each `orbitfinder` command, with exit code 0 unless a line `# exit 1` says otherwise
    ```toml title="x"  written to x first
    ```text            what the block before it printed, in full; a line `...` stands for lines left out

Numbers agree to the last digit but one unit; what round-off left (below 1e-8) within a factor of 1000. Before a block,
`<!-- numbers: 1e-3 -->` allows a relative difference, `counts` whole numbers (of steps, of points) that
differ by a fifth, `any` any number (times, versions), `ends` that only the first and the last line are
the same (searches: a start that fails on one processor may succeed on another).
`ORBITFINDER_WRITE_DOCS=1 python -m pytest tests/test_docs.py -k page_runs` writes what was printed into the pages,
and the figures that a page's commands drew (`<!-- picture: FILE -->` before an image) into docs/pictures.
`<!-- slow -->` on a page moves it to the slow tests, `<!-- needs: proof -->` skips it where that extra is
missing; pages in `PARSED_ONLY` are checked without being run. Lines of shell that are not ours are in `NOT_RUN`.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import PIL.Image
import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
GENERATED = {"problem-file.md"}
OWN = {"contributing.md"}
"""Pages that a test of their own runs: tests/test_contributing.py."""
PARSED_ONLY = {"cluster.md"}
"""Pages whose blocks need a cluster: Python is compiled, the options of our commands are parsed, nothing runs."""
FENCE = re.compile(r"^( *)```(\w*)([^\n]*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
NOT_RUN = (
    "python3 -m venv",  # makes an environment and installs
    ".venv/bin/pip install",
    "pip install",
    "pip download",
    "rattler-build ",
    "python -m build",
    "python -m pytest",  # would run this
    "OPENBLAS_CORETYPE=",  # the same
    "python benchmarks/",  # minutes
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
    """One fenced block: its language, what follows the language, its text, its line, how far numbers may differ."""

    language: str
    info: str
    text: str
    line: int
    allowed: str = ""

    @property
    def title(self):
        found = re.search(r'title="([^"]+)"', self.info)
        return found.group(1) if found else None


def blocks(page):
    text = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        _, language, info, _ = found.groups()
        said = re.search(r"<!-- numbers: (\S+) -->\s*$", text[: found.start()])
        yield Block(
            language, info, dedented(found), text.count("\n", 0, found.start()) + 1, said.group(1) if said else ""
        )


def dedented(found):
    """The text of a fence without its indentation."""
    return "\n".join(line.removeprefix(found.group(1)) for line in found.group(4).splitlines())


def is_slow(page):
    return "<!-- slow" in page.read_text(encoding="utf-8")


def parameters():
    for page in PAGES:
        runs = [block for block in blocks(page) if block.language in ("python", "sh")]
        if page.name not in GENERATED | OWN | PARSED_ONLY and runs:
            marks = [pytest.mark.slow] if is_slow(page) else []
            marks += map(pytest.mark.needs, re.findall(r"<!-- needs: (\w+) -->", page.read_text(encoding="utf-8")))
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
        if words[0] == "cc":
            if not shutil.which("cc"):
                pytest.skip("no C compiler (cc) on the path")
            printed += subprocess.run(line, shell=True, capture_output=True, text=True, check=True).stdout
            continue
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


PICTURE = re.compile(r"<!-- picture: (\S+) -->\n!\[[^\]]*\]\(([^)]+)\)")
"""A figure that the page's own commands draw, and the copy of it that is shown."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
VERSION = re.compile(r"\b\d+(?:\.\d+){2,}\w*\+?")
ROUND_OFF, ONE_DIGIT = 1e-8, re.compile(r"[1-9]e-\d+")
"""Printed numbers below it are errors, of which only the size can be repeated; and error bars where one digit is: the
difference of two computations, which the round-off of another processor makes 50 times as large or small."""


def numbers_agree(shown, printed, allowed=""):
    """Whether two printed numbers say the same; unless more is allowed, to one unit of the last digit shown."""
    one, other = float(shown), float(printed)
    whole = not re.search("[.e]", shown + printed)
    if one == other or allowed == "any":
        return True
    if ONE_DIGIT.fullmatch(shown) and ONE_DIGIT.fullmatch(printed) and max(abs(one), abs(other)) < ROUND_OFF:
        return max(abs(one), abs(other)) <= 100 * min(abs(one), abs(other))
    if allowed and (whole or allowed != "counts"):
        return abs(one - other) <= (0.2 if allowed == "counts" else float(allowed)) * max(abs(one), abs(other))
    if "e" in shown + printed and max(abs(one), abs(other)) < ROUND_OFF:
        return max(abs(one), abs(other)) <= 1000 * max(min(abs(one), abs(other)), 1e-16)
    digits, _, exponent = shown.partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    return not whole and abs(one - other) <= 1.01 * unit


def lines_agree(shown, printed, allowed=""):
    """Whether two lines have the same words and, but for spaces, the same numbers."""
    if allowed == "any":
        shown, printed = (VERSION.sub("0", line) for line in (shown, printed))
    words = [" ".join(NUMBER.sub(" # ", line).split()) for line in (shown, printed)]
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=False)
    return words[0] == words[1] and all(numbers_agree(*pair, allowed) for pair in pairs)


def assert_printed(expected, printed, where, allowed=""):
    """Every printed line is shown, in order; a line `...` stands for any number of them."""
    if allowed == "ends":
        first, *_, last = filter(str.strip, expected.splitlines())
        expected, allowed = f"{first}\n...\n{last}", "any"
    rest, gap = [line.rstrip() for line in printed.splitlines() if line.strip()], False
    for line in filter(str.strip, expected.splitlines()):
        if line.strip() == "...":
            gap = True
            continue
        while rest and gap and not lines_agree(line, rest[0], allowed):
            rest.pop(0)
        assert rest and lines_agree(line, rest[0], allowed), f"{where}: {line!r} was not printed next; was\n{printed}"
        rest.pop(0)
        gap = False
    assert gap or not rest, f"{where}: not shown are {rest}"


def written(block, printed):
    """The block with what was printed in place of what it shows; lines that it leaves out stay left out."""
    lines = [line.rstrip() for line in printed.splitlines()]
    if "..." not in (line.strip() for line in block.text.splitlines()):
        return "\n".join(lines).strip("\n")
    kept, rest, gap = [], lines, False
    for line in block.text.splitlines():
        if line.strip() == "...":
            gap = True
            continue
        pattern = ".*".join(NUMBER.sub(".*", re.escape(part).replace("\\-", "-")) for part in line.split("..."))
        pattern = re.sub(r"(\\ )+", r"\\s+", pattern)
        place = next((k for k, one in enumerate(rest) if re.fullmatch(pattern + ".*", one)), None)
        assert place is not None, f"{line!r} was not printed; was\n{printed}"
        kept += (["..."] if gap and place else rest[:place]) + [rest[place]]
        rest, gap = rest[place + 1 :], False
    kept += (["..."] if gap else rest) if any(map(str.strip, rest)) else []
    return "\n".join(kept).strip("\n")


def rewrite(page, block, printed):
    """Write what was printed into the page, at the block's place."""
    text = page.read_text(encoding="utf-8")
    found = next(one for one in FENCE.finditer(text) if one.group(2) == "text" and dedented(one) == block.text)
    body = "".join(f"{found.group(1)}{line}".rstrip() + "\n" for line in written(block, printed).splitlines())
    page.write_text(text[: found.start(4)] + body + text[found.end(4) :], encoding="utf-8")


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
            if os.environ.get("ORBITFINDER_WRITE_DOCS"):
                rewrite(page, block, printed)
            else:
                assert_printed(block.text, printed, where, block.allowed)
            printed = None
    for drawn, shown in PICTURE.findall(page.read_text(encoding="utf-8")):
        assert (folder / drawn).is_file(), f"{page.name}: {drawn} was not drawn"
        if os.environ.get("ORBITFINDER_WRITE_DOCS"):
            PIL.Image.open(folder / drawn).convert("RGB").quantize(96).save(page.parent / shown, optimize=True)


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
    assert not re.search(r"^(<{7}|>{7}) |^={7}$|\S +#{2,} \w", FENCE.sub("", text), re.MULTILINE), (
        "a merge left its marks"
    )
    assert len(re.findall(r"^ *```", text, re.MULTILINE)) == 2 * len(list(blocks(page)))


@pytest.mark.parametrize("page", list(parameters()))
def test_pages_say_how_long_their_examples_take(page):
    """Every page that runs something says in seconds how long that takes."""
    text = page.read_text(encoding="utf-8")
    assert re.search(r"\btakes?\s(about|a|from)\s[\w\s()]*(second|minute)", text, re.IGNORECASE)


def test_expected_output_is_compared():
    """The comparison itself: order, words and digits matter, `...` is lines left out, nothing is silently skipped."""
    assert_printed("period 1.6554 s\n...\nlast", "period 1.6553 s\nmore\nlast\n", "page")
    assert_printed("gap 3.1e-15, 41 orbits", "gap  8e-14, 41 orbits", "page")
    assert_printed("took 3.1 s", "took 9.7 s", "page", "any")
    for shown, printed in (
        ("period 1.6555 s", "period 1.6553 s"),
        ("41 orbits", "42 orbits"),
        ("gap 3.1e-15", "gap 3.1e-09"),
        ("period 1.65 s", "time 1.65 s"),
        ("b\na", "a\nb"),
        ("a", "a\nb"),
        ("a\n...\nc", "a\nb"),
    ):
        with pytest.raises(AssertionError, match=r"not printed next|not shown"):
            assert_printed(shown, printed, "page")
    with pytest.raises(AssertionError, match="not printed next"):
        assert_printed("ratio 1.00", "ratio 1.02", "page", "1e-2")
    assert_printed("12 starts\nrandom 1\n3 orbits", "12 starts\nmodes 2\nrandom 2\n4 orbits", "page", "ends")
    assert_printed("105 closed orbits, T = 2.5 s", "98 closed orbits, T = 2.5 s", "page", "counts")
    with pytest.raises(AssertionError, match="not printed next"):
        assert_printed("105 closed orbits, T = 2.5 s", "105 closed orbits, T = 2.7 s", "page", "counts")


def test_written_output_keeps_what_is_left_out():
    """What is written into the pages: everything, or the shown lines with their new numbers."""
    assert written(Block("text", "", "period 1.6... s", 1), "period 1.65 s\nlast\n") == "period 1.65 s\nlast"
    assert written(Block("text", "", "...\nlast 1", 1), "a\nb\nlast 2\nend") == "...\nlast 2\nend"
    assert written(Block("text", "", "a\n...", 1), "a\nb\nc") == "a\n..."


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
    """No web fonts, no scripts or styles from elsewhere; what is vendored bears its licence, version and origin."""
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "font: false" in settings and "http://" not in settings and "https://" not in settings
    katex = DOCS / "assets" / "katex"
    assert "MIT" in (katex / "LICENSE.txt").read_text() and "katex@0." in (katex / "README.txt").read_text()
    fonts = re.findall(r"url\(([^)]+)\)", (katex / "katex.min.css").read_text())
    assert fonts and all((katex / font).is_file() for font in fonts)


WIDEST_CODE = 100
"""Columns; longer lines are cut on the page. Output is folded there."""
LONG_PAGE = 120
"""Lines of Markdown, about three screens."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_pages_are_readable(page):
    """No code is cut, output has no holes within a line, one h1, and sections to find one's way on a long page."""
    for block in blocks(page):
        if block.language != "text":
            assert max(map(len, block.text.splitlines()), default=0) <= WIDEST_CODE, f"{page.name}:{block.line}"
        else:
            assert not [line for line in block.text.splitlines() if "..." in line and line.strip() != "..."], block
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    assert len(re.findall(r"^# ", text, re.MULTILINE)) == 1
    assert text.count("\n") < LONG_PAGE or len(re.findall(r"^##+ ", text, re.MULTILINE)) >= 4


@pytest.mark.parametrize("folder_name", ["tutorials", "how-to"])
def test_pages_that_show_how_have_a_picture(folder_name):
    """Every tutorial and every how-to page shows what comes of it."""
    for page in (DOCS / folder_name).glob("*.md"):
        assert re.search(r"<!-- (made: (orbit|family)|stage:) |!\[", page.read_text(encoding="utf-8")), page


def anchors(page):
    """The anchors of a Markdown page's headings, as Python-Markdown makes them."""
    for title in re.findall(r"^#+ +(.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE):
        title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        yield re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


WITH_LINKS = [*PAGES, *ROOT.glob("*.md"), *(ROOT / "results").glob("*/README.md"), *(ROOT / "paper").glob("*.md")]


@pytest.mark.parametrize("page", WITH_LINKS, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    """Files that pages link to exist, in docs/ or outside, and so do the headings."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)(?: \"[^\"]*\")?\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        goal = (page.parent / file).resolve() if file else page
        assert goal.exists(), f"{page.name} links to {target}"
        if anchor and goal.suffix == ".md" and "<!-- made: " not in goal.read_text(encoding="utf-8"):
            assert anchor in set(anchors(goal)), f"{page.name} links to {target}"


def test_spelling():
    """codespell finds no common misspelling in what people read."""
    pytest.importorskip("codespell_lib")
    read = [str(one) for one in (*PAGES, *ROOT.glob("*.md"), ROOT / "orbitfinder", ROOT / "problems")]
    command = [
        sys.executable,
        "-m",
        "codespell_lib",
        *read,
        "--skip=*.js,*.css,*.svg,*.urdf",
        f"-L{','.join(OUR_WORDS)}",
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


OUR_WORDS = ("Commun", "fro", "regraded", "Numer", "inout", "oint")
"""Words and names that codespell takes for others."""


@pytest.mark.needs("docs")
def test_the_site_builds(tmp_path):
    """mkdocs --strict: no warning, no dead link; the reference is there and the pages ask the network for nothing."""
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
    assert 'href="search.html#orbitfinder.atlas.search.search"><code>of.search</code>' in reference
    gallery = (tmp_path / "site" / "gallery" / "chains.html").read_text(encoding="utf-8")
    assert "<animate" in gallery and "aligned" in gallery and "The same in Python" in gallery
    commands = (tmp_path / "site" / "reference" / "commands.html").read_text(encoding="utf-8")
    assert "Recompute the certificate of each ORBIT.json" in commands
