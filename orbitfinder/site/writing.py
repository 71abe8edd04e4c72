"""A site on the disk: written beside its place and then put there, whole, with what others keep in that folder."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from orbitfinder._runtime import locks
from orbitfinder.errors import InputError

MARK = "orbitfinder-page.json"
"""A file of this name says that a folder was written here, and which files in it."""
PATIENCE = 60.0
"""s to wait for another process that writes the same site"""
FIRST_EDITION = re.compile(r"index\.html|(assets|atlases|data|families|orbits)/.*\.(html|js|css|svg|txt)")
"""What a site of the first edition, which kept no list, had written."""


def mark(paths: Iterable[str]) -> bytes:
    """The content of MARK for a site of these files."""
    document = {"format": "orbitfinder/page", "version": 2, "files": sorted({*paths, MARK})}
    return (json.dumps(document, indent=0) + "\n").encode()


def check_target(out: Path) -> None:
    """`InputError` when the target is no folder for a site."""
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise InputError(f"out: {out} exists and is not a folder; name a new folder")
    if out.is_dir() and any(out.iterdir()) and not (out / MARK).is_file():
        raise InputError(
            f"out: {out} is not empty and holds no former page ({MARK} is missing), so it is left alone; "
            "name a new or an empty folder"
        )


def write_site(files: Mapping[str, bytes], out: Path) -> None:
    """Write everything into a temporary folder beside the target, then put it in the target's place.

    A former page there is replaced; files of others stay. Raises `InputError`.
    """
    check_target(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"out: cannot write beside {out} ({error}); choose another folder") from error
    try:
        with locks.held(out.parent / f".{out.name}.lock", PATIENCE) as alone:
            if not alone:
                raise InputError(f"out: another process is writing {out}; wait for it, or name another folder")
            for left in out.parent.glob(f".{out.name}.????????"):  # of killed processes: nobody else writes there now
                ours = left.is_dir() and not left.is_symlink()
                if ours and {inner.name for inner in left.iterdir()} <= {"new", "old"}:
                    _cleared(left, out)
            with _beside(out) as temporary:
                _put(files, temporary / "new", out)
                if out.exists():
                    out.rename(temporary / "old")
                (temporary / "new").rename(out)
    except OSError as error:
        raise InputError(f"out: cannot write {out} ({error}); free some space or choose another folder") from error


@contextlib.contextmanager
def _beside(out: Path) -> Iterator[Path]:
    """A temporary folder beside the target, in which its former content may be; gone, or put back, at the end."""
    temporary = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
    try:
        yield temporary
    finally:
        _cleared(temporary, out)


def _cleared(temporary: Path, out: Path) -> None:
    if (temporary / "old").exists() and not out.exists():  # stopped between the two renames
        (temporary / "old").rename(out)
    shutil.rmtree(temporary, ignore_errors=True)


def _put(files: Mapping[str, bytes], fresh: Path, out: Path) -> None:
    """The new files, and links to those of the target that are not of a former page."""
    former = _former(out)
    for path, data in sorted(files.items()):
        if path not in former and (out / path).exists():
            raise InputError(f"out: {out / path} is in the way and no former page's; move it, or name another folder")
        target = fresh / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
    if out.is_dir():
        skipped = {str(out / path) for path in former}
        shutil.copytree(
            out, fresh, symlinks=True, dirs_exist_ok=True, copy_function=_linked,
            ignore=lambda folder, names: {name for name in names if os.path.join(folder, name) in skipped},
        )  # fmt: skip
    for folder in sorted({parent for path in former for parent in (fresh / path).parents}, reverse=True):
        if folder != fresh and fresh in folder.parents:
            with contextlib.suppress(OSError):  # not empty, or not there
                folder.rmdir()


def _linked(source: str, target: str) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:  # a file system without links
        shutil.copy2(source, target)


def _former(out: Path) -> set[str]:
    """Paths in the target that a former page wrote."""
    try:
        document = json.loads((out / MARK).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return set()
    except (ValueError, RecursionError):
        document = {}
    listed = document.get("files") if isinstance(document, dict) else None
    if isinstance(listed, list):
        return {path for path in listed if isinstance(path, str) and ".." not in path and path[:1] != "/"} | {MARK}
    present = (path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    return {path for path in present if FIRST_EDITION.fullmatch(path)} | {MARK}
