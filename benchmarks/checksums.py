"""results/SHA256SUMS, a checksum of every file there: `python benchmarks/checksums.py` writes it, `--check` compares.

To be run after anything in results/ was made again. `cd results && sha256sum -c SHA256SUMS` checks it without Python.
"""

import argparse
import hashlib
import sys
from pathlib import Path

RESULTS = Path(__file__).parents[1] / "results"
NAME = "SHA256SUMS"
PASSING = ("-wal", "-shm", "-journal", ".lock")
"""What SQLite and running commands put beside a file for a while"""


def lines(folder: Path) -> list[str]:
    """`digest  path` of every file, by path; paths with slashes on every system."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(PASSING)]
    named = {path.relative_to(folder).as_posix(): path for path in files}
    return [f"{hashlib.sha256(named[one].read_bytes()).hexdigest()}  {one}" for one in sorted(named) if one != NAME]


def differences(folder: Path) -> list[str]:
    """Files that are changed, missing or not listed, each with what it is."""
    told = dict(reversed(line.split("  ", 1)) for line in (folder / NAME).read_text(encoding="utf-8").splitlines())
    true = dict(reversed(line.split("  ", 1)) for line in lines(folder))
    what = {name: "changed" if name in told and name in true else "missing" if name in told else "not listed"
            for name in told | true if told.get(name) != true.get(name)}  # fmt: skip
    return [f"{name}: {what[name]}" for name in sorted(what)]


def main() -> int:
    """Write the list, or with --check compare it; exit code 1 where it is not true."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    if parser.parse_args().check:
        found = differences(RESULTS)
        print("\n".join(found) or f"{RESULTS / NAME}: true")
        return int(bool(found))
    listed = lines(RESULTS)
    (RESULTS / NAME).write_text("\n".join([*listed, ""]), encoding="utf-8")
    print(f"{RESULTS / NAME}: {len(listed)} files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
