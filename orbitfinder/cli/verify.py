"""The commands `verify`, `prove` and `refine`: what is true of recorded orbits, from the files alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.cluster import scheduler_at
from orbitfinder._runtime.rooms import loaded
from orbitfinder._runtime.tasks import crew
from orbitfinder.cli.console import note, time_left
from orbitfinder.cli.jobs import check_writable, model_of, one_line, orbit_and_model
from orbitfinder.cli.options import (
    FILES,
    FINITE,
    SYSTEM_TRUST,
    Decorator,
    finish,
    option,
    orbit_files,
    text,
    trusted,
    usual,
    workers_option,
)
from orbitfinder.errors import InputError, plural
from orbitfinder.records.certificate import Certificate, certificate_to_document
from orbitfinder.records.codec import entries_of
from orbitfinder.records.reading import Entries, Table
from orbitfinder.records.registry import answer, held, kind_of, kinds, load, load_orbit, member

if TYPE_CHECKING:
    from orbitfinder.atlas.store import Atlas
    from orbitfinder.proof.theorem import Proving
    from orbitfinder.records.orbit import Orbit


@click.command()
@orbit_files
@option("proof", "Replay the recorded proof of each file too (see `orbitfinder prove`).", kind=bool)
@usual()
def verify(files: tuple[Path, ...], proof: bool, trust: bool) -> None:
    """Recompute the certificate of each ORBIT.json from the file alone.

    Another integrator, another formulation, nothing taken on trust. Exit code 0: every check of
    every file passed; 1: some failed, and are named. The equations of a system that a Python module
    of yours makes are that module's; it is run only with --trust. FILE#K is point K of a family.json,
    counted from 0, or orbit K of an atlas; without #K all events and ends of a
    family.json are checked by their definitions; tori of a tori.json, optima, a controller.json and a connection too.

    \b
    Examples:
      orbitfinder verify orbits/triple-1/orbit.json
      orbitfinder verify orbits/*/orbit.json --json
      orbitfinder verify families/triple-mode-2/family.json#17
      orbitfinder verify families/triple-mode-2/family.json
      orbitfinder verify --proof families/triple-mode-2/branch-proof.json families/triple-1/event-9-proof.json
      orbitfinder verify --proof equilibria/wing-flutter/equilibria-proof.json
    """
    results = list[Entries]()
    for file in (part for given in files for part in _each(given)):
        kind = held(file)[1]
        if proof and kind.replay and not kind.verify:
            results.append({"file": str(file)} | _replayed(file, trust, f"{file}: "))
            continue
        results.append(verified(file, trust))
        interrupt.check()
        if proof:
            results[-1]["proof"] = _replayed(file, trust, "  ")
    passed = all(result["passed"] and result.get("proof", result)["passed"] for result in results)
    finish("verify", {"passed": passed, "results": results}, passed)


def _each(file: Path) -> list[Path]:
    """FILE, or FILE#K of each of the tori or optima that are verified singly."""
    kind = held(file)[1]
    if kind.parts is None or not kind.apart or member(file)[1] is not None:
        return [file]
    return [Path(f"{file}#{k}") for k in range(len(kind.parts(load(file))))]


def _replayed(file: Path, trust: bool, margin: str) -> Entries:
    """The recorded proof of FILE or FILE#K made again: `passed`, and `message`, a sentence."""
    replay = loaded(held(file)[1].replay or kinds()["orbit"].replay)
    again, wrong, what = replay(file, trusted(file, trust), note)
    message = f"proof replayed in {again.wall_time:.1f} s: proved, {what}"
    message = f"proof REJECTED: {'; '.join(wrong)}" if wrong else message
    text(f"{margin}{message}")
    return {"passed": not wrong, "message": message}


def verified(file: Path, trust: bool) -> Entries:
    """What of FILE or FILE#K was checked again, from the file alone."""
    from orbitfinder.families.verified import point_checks
    from orbitfinder.records.family import Family, FamilyPoint, load_family

    answers = answer("verify", file)
    record, model = orbit_and_model(file, trust, read=load)
    try:
        certificate = answers(record, model)
        placed = list(certificate) if isinstance(record, Family) else []
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    about = {"file": str(file), "name": record.name}
    if not isinstance(record, Family):
        if isinstance(record, FamilyPoint):
            family = load_family(member(file)[0])
            certificate = point_checks(family, record.index, certificate, model_of(family, file, trust))
        _print_certificate(f"{file} ({record.name})", certificate)
        return about | certificate_to_document(certificate)
    wrong = [f"{where}: {check.name}" for where, check in placed if not check.passed]
    skipped = sum(check.skipped for _, check in placed)
    for where, check in placed:
        said = one_line(check.note)
        verdict = f"FAILED  {said}" if not check.passed else said if check.skipped else "passed"
        text(f"  {check.name:<18}{where:<42}{check.value:>9.1e} of {check.tolerance:<8.1e}  {verdict}")
    what = f"{plural(len(record.events), 'event')} and {plural(len(record.ends), 'end')}"
    verdict = f"REJECTED by {len(wrong)}" if wrong else "verified"
    text(f"{file} ({record.name}): {what} {verdict}{f', {skipped} of them not checked' if skipped else ''}")
    return about | {
        "passed": not wrong,
        "checks": [{"where": where} | entries_of(check) for where, check in placed],
    }


def _print_certificate(heading: str, certificate: Certificate) -> None:
    """Every check with its number and what was asked, yes or no in words, and the verdict last."""
    text(f"  {'check':<22}{'found':>10}  {'asked':<11}  result  note")
    for check in certificate.checks:
        sense, answer = check.sense, "yes" if check.passed else "no"
        number, wanted = (f"{check.value:.2e}", f"{sense} {check.tolerance:.2e}") if sense else (answer, "yes")
        result, note = "passed" if check.passed else "FAILED", one_line(check.note)
        text(f"  {check.name:<22}{number:>10}  {wanted:<11}  {result}  {note}".rstrip())
    verdict = "certified" if certificate.passed else f"REJECTED by {', '.join(certificate.failures)}"
    text(f"{one_line(heading)}: {verdict}")


def _symmetry(context: click.Context, parameter: click.Parameter, name: str | None) -> str | None:
    """The name itself, or a message that lists the known ones, which are looked up only then: that loads CasADi."""
    if name is None:
        return None
    from orbitfinder.loops.symmetry import SYMMETRIES

    return click.Choice(list(SYMMETRIES)).convert(name, parameter, context)


def symmetry_option(what: str) -> Decorator:
    """The option --symmetry, its help saying what it chooses."""
    known = "[none|reflection|brake|reversal|brake+reflection]"
    return option("symmetry", what, callback=_symmetry, metavar=known)


@click.command()
@orbit_files
@symmetry_option("Prove in this symmetry; default: the recorded one. none: unique among all near.")
@option("segments", "Shooting segments; default: by the largest multiplier.", kind=int)
@option("order", "Order of the Taylor series.  [default: 22]", kind=int)
@option("bits", "Precision of the ball arithmetic.  [default: 106]", kind=int)
@option("tolerance", "Remainder allowed in one step.  [default: 1e-17, of events 1e-19]", kind=FINITE)
@option("record/--no-record", "Write the proof into the ORBIT.json.", True)
@option("from low", "Of a FAMILY.json: prove it from this energy (J) ...", kind=FINITE)
@option("to high", "... to this one, and its events in between.", kind=FINITE)
@option("event number", "Of a FAMILY.json: prove this fold, doubling or branch point, counted from 0.", kind=int)
@workers_option()
@option("shard", "Prove every N-th only, from the K-th; auto: by the Slurm array that runs it.", metavar="K/N")
@usual(trust=SYSTEM_TRUST)
def prove(
    files: tuple[Path, ...], record: bool, low: float | None, high: float | None, number: int | None, trust: bool,
    workers: int, scheduler: str | None, shard: str | None, **given: Any,
) -> None:  # fmt: skip
    """Prove that each ORBIT.json is a periodic orbit, by a theorem in ball arithmetic.

    Needs the extra `proof` (python-flint). A proof encloses the orbit, its minimal period and its
    multipliers, and is recorded in the file. Exit code 0: all proved; 1: some not, with the reason.
    FILE#K is orbit K of an atlas, or point K of a family.json, counted from 0, whose proof is not recorded; an atlas
    stands for all of its orbits that have no proof yet. Of an equilibria.json all points, folds and Hopf points are
    proved, into an equilibria-proof.json beside it; of a connection.json that both manifolds meet, into a
    connection-proof.json.

    \b
    Examples:
      orbitfinder prove orbits/triple-1/orbit.json
      orbitfinder prove orbits/*/orbit.json --no-record --json
      orbitfinder prove families/triple-mode-2/family.json --from -37.516219 --to -37.516209
      orbitfinder prove equilibria/wing-flutter/equilibria.json
      orbitfinder prove families/triple-1/family.json --event 9
      orbitfinder prove connections/oterma-l2/connection-1.json
    """
    asked = given | {"shard": shard, "scheduler": scheduler, "workers": None if workers == 1 else workers,
                     "from": low, "to": high, "event": number}  # fmt: skip
    part = "branch-proof" if {low, high} != {None} else "orbit" if number is None else "event-proof"
    known = {kind_of(file) if file.is_file() else "" for file in files}
    made = next((f"{name}-proof" for name in kinds() if name in known and f"{name}-proof" in kinds()), part)
    proving, jobs, results = loaded(kinds()[made].prove)(asked), [], list[Entries]()
    if proving.alone and len(files if proving.file else known) > 1:
        raise InputError(proving.alone)
    for file in files if proving.codec else _unproved(files, shard):
        target = file.with_name(proving.file or f"{file.stem}-proof.json")
        jobs.append((file, proving.read(file), target))
        if record:
            check_writable(file.parent, "--record")
            if proving.check:
                proving.check(target)
            elif book := _atlas(*jobs[-1][:2], trust):  # if it cannot be written to, that is said before the proof
                book.close()
    for (file, source, target), proof, document, (verdict, *lines) in _proofs(jobs, proving, asked, trust):
        interrupt.check()
        if record and proving.codec and proof.kept:
            proving.codec.save(proof, target)
        elif record and not proving.codec and document["proved"]:
            _record(file, source, document, trust)
        results.append({"file": str(file)} | ({} if proving.codec else {"name": source.name}) | document)
        text(f"{file} ({source.name}){proving.part}: {verdict}")
        for line in lines:
            text(line)
    passed = all(result.get("passed", result["proved"]) for result in results)
    finish("proof", document if proving.file else {"passed": passed, "results": results}, passed)


def _unproved(files: Sequence[Path], shard: str | None) -> list[Path]:
    """The shard's orbits, a whole atlas standing for those that have no proof."""
    from orbitfinder.atlas.shard import WHOLE, shard_from
    from orbitfinder.atlas.store import Atlas

    part, listed = shard_from(shard) or WHOLE, list[tuple[Path, bool]]()
    for file in files:
        if file.is_file() and kind_of(file) == "atlas":
            with Atlas(file) as atlas:
                listed += [(Path(f"{file}#{row.id}"), bool(row.proof)) for row in atlas.rows()]
        else:
            listed.append((file, False))
    shared = listed[part.first :: part.parts]
    return [file for file, proved in shared if not proved]  # left out now: shards have the same list at any time


def _atlas(file: Path, orbit: Orbit, trust: bool) -> Atlas | None:
    """The atlas of FILE#K, to be written to."""
    from orbitfinder.atlas.store import Atlas
    from orbitfinder.proof.theorem import provable_model

    book, number = member(file)
    if number is None or kind_of(book) != "atlas":
        return None
    return Atlas(book, write=True, model=provable_model(orbit, trusted(file, trust)))


def _record(file: Path, orbit: Orbit, document: Entries, trust: bool) -> None:
    """Write what is proved into the atlas or the orbit.json that it is of."""
    from orbitfinder.proof.record import write_entry

    if book := _atlas(file, orbit, trust):
        with book:
            book.describe(member(file)[1] or 0, document)
    elif file.exists():
        write_entry(file, document)
    else:
        note(f"{file}: the proof is not recorded, which only an orbit.json or an atlas can be given")


def _proofs(jobs: Sequence[Any], proving: Proving, asked: Table, trust: bool) -> Iterator[Any]:
    """Each job, its proof, document and lines; of a proof that is made elsewhere the document and the first line."""
    from orbitfinder.proof.record import proved_entry
    from orbitfinder.proof.theorem import chosen_options, provable_model

    workers, scheduler = asked["workers"] or 1, asked["scheduler"]
    if workers == 1 and scheduler is None:
        for job in jobs:
            file, source, _ = job
            say = partial(_say, source.name) if proving.named else note
            proof = proving.prove(source, provable_model(source, trusted(file, trust)), say)
            yield job, proof, proving.document(proof), proof.lines
        return
    home, left, options = trusted(jobs[0][0], trust) if jobs else None, time_left(), chosen_options(asked)
    with scheduler_at(scheduler, "prove", home) as far, crew(proved_entry, workers, "prove", far) as answers:
        folder = far.luggage.folder if far else None if home is None else str(home)
        for done, (k, told) in enumerate(answers([(orbit, folder, options) for _, orbit, _ in jobs]), 1):
            note(f"{done} of {len(jobs)}: {jobs[k][0]}{left(done, len(jobs))}")
            yield jobs[k], None, *told


def _say(name: str, line: str) -> None:
    note(f"{name}: {line}")


@click.command()
@click.argument("file", type=FILES, metavar="ORBIT.json")
@option("digits", "Decimal places wanted.", 50)
@option("order", "Order of the Taylor series; default: by the digits.", kind=int)
@option("bits", "Precision of the arithmetic; default: by the digits.", kind=int)
@symmetry_option("Default: the recorded one.")
@option("enclose/--no-enclose", "Prove the digits; slower.", True)
@usual(trust=SYSTEM_TRUST)
def refine(
    file: Path, digits: int, order: int | None, bits: int | None, symmetry: str | None, enclose: bool, trust: bool,
) -> None:  # fmt: skip
    """Many digits of the period and of a state of an ORBIT.json, at its recorded energy.

    Every number in the file (energy, masses, gravity) is taken as the decimal that is written there.
    Needs the extra `proof` (python-flint). Exit code 0: the digits are enclosed; 1: they are not.

    \b
    Examples:
      orbitfinder refine orbits/triple-1/orbit.json --digits 50
      orbitfinder refine orbits/triple-1/orbit.json --digits 50 --order 80 --bits 300
    """
    from orbitfinder.proof.balls import precision
    from orbitfinder.proof.record import enclosure
    from orbitfinder.proof.theorem import provable_model, settings_for
    from orbitfinder.proof.theorem import refine as refined

    settings, orbit = settings_for(digits, order, bits), load_orbit(file)
    model = provable_model(orbit, trusted(file, trust))
    digitized = refined(orbit, settings, digits, model, symmetry, enclose, note)
    with precision(settings.bits):
        places = digits + 4
        document: Entries = {
            "digits": digits, "enclosed": digitized.enclosed,
            "reason": digitized.reason, "symmetry": digitized.symmetry,
            "energy": None if digitized.energy is None else enclosure(digitized.energy, places),
            "period": enclosure(digitized.period, places),
            "state": [enclosure(x, places) for x in digitized.state],
            "phase": float(digitized.phase), "order": settings.order, "bits": settings.bits,
            "wall_time": round(digitized.wall_time, 1),
        }  # fmt: skip
    proved = "enclosed" if digitized.enclosed else f"not enclosed ({digitized.reason})"
    text(f"{file}: {plural(digits, 'digit')}, {proved}, {digitized.wall_time:.1f} s")
    wide = max(map(len, ("period", *model.state_names))) + 2
    for name, ball in zip(("period", *model.state_names), (document["period"], *document["state"]), strict=True):
        within = f" +/- {ball['radius']:.1e}" if digitized.enclosed and float(ball["value"]) else ""
        text(f"  {name:<{wide}}{ball['value']}{within}{' s' if name == 'period' else ''}")
    finish("refined", document, digitized.enclosed or not enclose)
