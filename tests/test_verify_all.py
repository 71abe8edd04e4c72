"""The command that verifies all that is shipped: what it verifies, that it goes on, and how it counts."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import verify_all
from benchmarks.verify_all import Job, Verdict

ORBIT = "results/orbits/triple-1/orbit.json"


def verdict(kind="atlas", passed=True, scale=10.0, record="a#1", cause=""):
    return Verdict(kind, record, "seal", passed, scale, cause, 1.0)


def test_every_kind_of_record_is_there():
    """Each once; of families every point and the whole, of atlases every row."""
    every = verify_all.jobs()
    assert len({job.record for job in every}) == len(every) and all(job.file.exists() for job in every)
    kinds = {job.kind for job in every}
    assert kinds >= {"atlas", "points of families", "events and ends of families", "gallery", "control", "hybrid",
                     "mechanisms", "report", "robots", "published", "examples", "chains"}  # fmt: skip
    whole = [job for job in every if job.kind == "events and ends of families"]
    family = json.loads(whole[0].file.read_text(encoding="utf-8"))
    assert sum(job.record.startswith(f"{whole[0].record}#") for job in every) == len(family["points"])
    assert len(whole) == 16 and sum(job.kind == "atlas" for job in every) > 3000


def test_records_of_one_file_go_together():
    wanted = [Job("atlas", f"a#{k}") for k in range(14)] + [
        Job("atlas", "b#0"),
        Job("gallery", "c"),
        Job("gallery", "d"),
    ]
    sizes = [len(group) for group in verify_all.groups(wanted)]
    assert sizes == [verify_all.TOGETHER, 2, 1, 1, 1]


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A folder with one true orbit, one whose period is wrong and one that is none."""
    monkeypatch.setattr(verify_all, "PROGRAMS", tmp_path)
    found = []
    for name, changed in (("true", {}), ("false", {"period": 1.66}), ("none", {"format": "nothing"})):
        document = json.loads((verify_all.ROOT / ORBIT).read_text(encoding="utf-8")) | changed
        document.pop("record", None)  # its digest
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
        shutil.copy((verify_all.ROOT / ORBIT).with_suffix(".npz"), tmp_path / f"{name}.npz")
        found.append(Job("gallery", str(tmp_path / f"{name}.json")))
    return found


def test_a_false_record_and_a_broken_one_fail_with_their_causes_and_what_is_done_is_kept(
    elsewhere, tmp_path, monkeypatch
):
    """Interrupted it goes on, changed code or files are verified again, a line that was cut short too."""
    journal = tmp_path / "journal.jsonl"
    right, wrong, broken = verify_all.run(elsewhere, journal, 2).values()
    assert right.passed and 1 < right.scale < 100
    assert not wrong.passed and "closure" in wrong.cause and verify_all.classed(wrong) == "small"
    assert not broken.passed and "format" in broken.cause and str(tmp_path) in broken.record
    assert verify_all.classed(broken) == "none" and np.isnan(broken.scale)

    lines = journal.read_text(encoding="utf-8").splitlines()
    assert len(lines) == 3
    asked = []
    monkeypatch.setattr(
        verify_all, "verified", lambda group: asked.append(group) or [replace(right, record=group[0].record)]
    )
    verify_all.run(elsewhere, journal, 1)
    assert not asked
    journal.write_text("\n".join([*lines[:2], lines[2][:40]]))
    verify_all.run(elsewhere, journal, 1)
    assert len(asked) == 1
    monkeypatch.setattr(verify_all, "seal", lambda file: "other code")
    asked.clear()
    verify_all.run(elsewhere, tmp_path / "journal.jsonl", 1)
    assert len(asked) == 3


def test_the_page_counts_apart_what_double_precision_cannot_hold():
    verdicts = [
        verdict(), verdict(passed=False, cause="closure 1 of 1e-9", record="a#2"),
        verdict("points of families", False, 1e6, "f#3", "pair_defect 7 of 0.1"),
        verdict("events and ends of families", False, np.nan, "f", "fold | 6.7"),
    ]  # fmt: skip
    text = verify_all.page(verdicts)
    assert "| atlas | 2 | 1 | 1 | 0 | 0 | 2 |" in text and "| **all** | 4 | 1 | 1 | 1 | 1 | 4 |" in text
    for words in ("| a#2 | 10 | closure 1 of 1e-9 |", "| f#3 | 1e+06 |", "| f | nan | fold / 6.7 |"):
        assert words in text
    assert "## Fail" not in verify_all.page([verdict()])


def test_a_sample_has_of_every_kind():
    every = [Job("atlas", f"a#{k}") for k in range(90)] + [Job("control", f"c{k}") for k in range(3)]
    chosen = verify_all.sampled(every, 20, 0)
    assert sum(job.kind == "control" for job in chosen) == 2 and 15 <= len(chosen) <= 25
    assert len(set(chosen)) == len(chosen) and chosen == verify_all.sampled(every, 20, 0)
