"""docs/contributing.md: its examples, written into a copy of the package, do what the page says they do."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^### (A[^\n]*)\n(.*?)(?=^##)", PAGE, re.MULTILINE | re.DOTALL))
FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```', re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The package with all examples written into it."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(ROOT / "orbitfinder", folder / "orbitfinder")  # with its bytecode
    for text in EXAMPLES.values():
        files = [(title, body) for _, title, body in FENCE.findall(text) if title]
        assert 1 <= len([title for title, _ in files if title.startswith("orbitfinder/")]) <= 2
        for title, body in files:
            file = folder / title.removesuffix(" +")
            assert file.exists() == title.endswith(" +"), title
            with file.open("a", encoding="utf-8") as stream:
                stream.write(body)
    return folder


def test_there_are_seven():
    assert list(EXAMPLES) == [
        "A kind of system", "A method", "A discretisation", "A condition", "An event", "A record with its picture",
        "A command",
    ]  # fmt: skip


RUN = """
import shlex, sys
from orbitfinder.cli.group import cli

for line in sys.argv[1:]:
    if line.startswith("### "):
        print(line)
    elif code := cli(shlex.split(line)[1:], standalone_mode=False):
        sys.exit(f"{line}: exit code {code}")
"""


@pytest.mark.slow
def test_every_example_does_what_the_page_says(copy):
    """In the order of the page, in one process, which imports once; what is said to be printed is."""
    environment = {**os.environ, "PYTHONPATH": str(copy), "MPLBACKEND": "Agg"}
    lines = []
    for name, text in EXAMPLES.items():
        ours = [line for language, _, body in FENCE.findall(text) if language == "sh" for line in body.splitlines()]
        assert all(line.startswith("orbitfinder ") for line in ours)
        lines += [f"### {name}", *ours]
    words = [sys.executable, "-P", "-c", RUN, *lines]
    done = subprocess.run(words, cwd=copy, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for name, text in EXAMPLES.items():
        printed = " ".join(done.stdout.partition(f"### {name}\n")[2].partition("### ")[0].split())
        for language, _, body in FENCE.findall(text):
            for line in body.splitlines() if language == "text" else ():
                assert " ".join(line.split()) in printed, f"{name}: {line}\n{done.stdout}"
    assert list((copy / "figures").rglob("heights.txt")) and list((copy / "figures").rglob("*.png"))


def test_a_record_that_is_false_fails(copy):
    """A ball below the ground is not certified."""
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    for words, code in (("heights -o low.json -- 0.5 -0.1", 0), ("verify low.json", 1)):
        command = [sys.executable, "-P", "-m", "orbitfinder", *words.split()]
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True)
        assert done.returncode == code, done.stdout + done.stderr


@pytest.mark.parametrize("words", ["run wrong.toml"])
def test_its_mistakes_are_told_like_others(copy, words):
    (copy / "wrong.toml").write_text((copy / "spring.toml").read_text().replace("4.0", "-4.0"))
    command = [sys.executable, "-P", "-m", "orbitfinder", *words.split()]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and "stiffness: must be positive, got -4.0" in done.stderr
