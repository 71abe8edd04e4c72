"""The paper: its numbers are those of the result pages; its length, citations and example; (slow) it can be built."""

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path
from runpy import run_path

import pytest

PAPER = Path(__file__).parents[1] / "paper"
NUMBERS = run_path(str(PAPER / "numbers.py"))
TEXT = (PAPER / "paper.md").read_text(encoding="utf-8")
BODY = TEXT.split("---\n", 2)[2]
UNCONFIRMED = {"munoz"}
"""Entries whose DOI could not be looked up: none is better than one from memory."""


def test_every_number_is_that_of_the_result_pages():
    """What numbers.py would write is what stands there; a stale number is replaced, a lost phrase is an error."""
    filled = NUMBERS["filled"]
    assert filled(TEXT) == TEXT
    ((phrase, (rows, *_)), *_) = NUMBERS["claims"]()
    assert phrase.startswith("Of {} comparisons")
    stale = re.sub(r"Of \d+ comparisons", "Of 12345 comparisons", TEXT)
    assert stale != TEXT and filled(stale) == TEXT and f"Of {rows} comparisons" in TEXT
    with pytest.raises(ValueError, match=r"has the phrase 'Of \{\} comparisons.* 0 times"):
        filled(TEXT.replace("comparisons", "rows"))


def test_no_number_stands_outside_a_claim():
    """Names of programs, mathematics, code and citations apart, every digit belongs to a phrase that is filled in."""
    prose = BODY
    for phrase, _ in NUMBERS["claims"]():
        prose, found = NUMBERS["pattern"](phrase).subn("", prose)
        assert found == 1, phrase
    prose = re.sub(r"```.*?```|\$\$.*?\$\$|\$.*?\$|`[^`]*`|\[@[^\]]*\]|AUTO-07p", "", prose, flags=re.DOTALL)
    assert re.findall(r".*\d.*", prose) == []


def test_length_and_sections_are_those_of_the_journal():
    """At most 1000 words with example, caption and headings; every section that is asked for."""
    assert 250 <= len(BODY.split()) <= 1000
    found = re.findall(r"^# (.+)$", BODY, re.MULTILINE)
    wanted = ["Summary", "Statement of need", "State of the field", "Software design", "Research impact statement",
              "AI usage disclosure", "Acknowledgements", "References"]  # fmt: skip
    assert [one for one in found if one in wanted] == wanted
    assert "written by AI agents" in BODY and "orcid" not in TEXT.lower()
    authors = (PAPER.parent / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^  - name: (.+)$", TEXT.split("affiliations:")[0], re.MULTILINE) == re.findall(
        r"^  - name: (.+)$", authors, re.MULTILINE
    )


def test_what_is_cited_is_in_the_list_and_the_other_way_round():
    """Keys of paper.md and of paper.bib; each entry has a DOI or, where there is none, an address; pictures exist."""
    entries = re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", (PAPER / "paper.bib").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert {key for key, _ in entries} == set(re.findall(r"@([a-z]+)\b", BODY))
    assert len(entries) == len({key for key, _ in entries}) >= 10
    for key, entry in entries:
        if key in UNCONFIRMED:
            assert "volume = {" in entry and "pages = {" in entry and "doi" not in entry, key
        else:
            assert "doi = {10." in entry or "url = {https://" in entry, key
    for picture in re.findall(r"\]\(([^)]+\.png)\)", BODY.replace("\n", " ")):
        assert (PAPER / picture).is_file()


def test_the_example_prints_what_it_says():
    """The block of Python, run; the block after it is its output."""
    code, printed = (re.search(rf"```{kind}\n(.*?)```", BODY, re.DOTALL)[1] for kind in ("python", "text"))
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(code, "paper.md", "exec"), {})
    assert said.getvalue() == printed


@pytest.mark.slow
def test_it_is_built(tmp_path):
    """A PDF of some pages, from the script, where Pandoc and Typst are installed."""
    pytest.importorskip("pypandoc")
    pytest.importorskip("typst")
    out = tmp_path / "paper.pdf"
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    subprocess.run(["sh", str(PAPER / "build.sh"), str(out)], check=True, timeout=120, env={"PATH": path})
    assert out.read_bytes().startswith(b"%PDF") and out.stat().st_size > 20_000
    assert not (PAPER / "paper.typ").exists()
