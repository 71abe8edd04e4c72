"""The commands `verify`, `prove` and `refine`: what is true of recorded orbits, from the files alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from decimal import Decimal
from functools import partial
from math import log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.cluster import scheduler_at
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
from orbitfinder.records.certificate import Certificate, Check, certificate_to_document
from orbitfinder.records.codec import entries_of
from orbitfinder.records.reading import Entries, Table
from orbitfinder.records.registry import answer, held, kind_of, load, load_orbit, member

if TYPE_CHECKING:
    from orbitfinder.proof.bordered import BorderedRecord
    from orbitfinder.proof.branch import ProvedBranch
    from orbitfinder.proof.connections import ConnectionRecord
    from orbitfinder.proof.equilibria import ProvedEquilibria
    from orbitfinder.proof.theorem import Options, Proof, RefinedOrbit
    from orbitfinder.records.family import Family
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
    results = []
    replays = {"branch-proof": verify_branch, "event-proof": verify_event, "equilibria-proof": verify_rest,
               "connection-proof": verify_connection}  # fmt: skip
    for file in (part for given in files for part in _each(given)):
        if proof and (replay := replays.get(held(file)[0])):
            results.append({"file": str(file)} | replay(file, trust))
            text(f"{file}: {results[-1]['message']}")
            continue
        results.append(verified(file, trust))
        interrupt.check()
        if proof:
            results[-1]["proof"] = verify_proof(file, trust)
            text(f"  {results[-1]['proof']['message']}")
    passed = all(result["passed"] and result.get("proof", result)["passed"] for result in results)
    finish("verify", {"passed": passed, "results": results}, passed)


def _each(file: Path) -> list[Path]:
    """FILE, or FILE#K of each of the tori or optima that are verified singly."""
    kind = held(file)[1]
    if kind.parts is None or not kind.apart or member(file)[1] is not None:
        return [file]
    return [Path(f"{file}#{k}") for k in range(len(kind.parts(load(file))))]


def verified(file: Path, trust: bool) -> Entries:
    """What of FILE or FILE#K was checked again, from the file alone."""
    from orbitfinder.families.verified import point_checks
    from orbitfinder.records.family import Family, FamilyPoint, load_family

    answers = answer("verify", file)
    record, model = orbit_and_model(file, trust, read=load)
    try:
        certificate = answers(record, model)
        if isinstance(record, Family):
            return _family(file, record, list(certificate))
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    if isinstance(record, FamilyPoint):
        family = load_family(member(file)[0])
        certificate = point_checks(family, record.index, certificate, model_of(family, file, trust))
    _print_certificate(f"{file} ({record.name})", certificate)
    return {"file": str(file), "name": record.name} | certificate_to_document(certificate)


def _family(file: Path, family: Family, placed: list[tuple[str, Check]]) -> Entries:
    """The checks of all events and ends of a family, made again."""
    wrong = [f"{where}: {check.name}" for where, check in placed if not check.passed]
    skipped = sum(check.skipped for _, check in placed)
    for where, check in placed:
        said = one_line(check.note)
        verdict = f"FAILED  {said}" if not check.passed else said if check.skipped else "passed"
        text(f"  {check.name:<18}{where:<42}{check.value:>9.1e} of {check.tolerance:<8.1e}  {verdict}")
    what = f"{plural(len(family.events), 'event')} and {plural(len(family.ends), 'end')}"
    verdict = f"REJECTED by {len(wrong)}" if wrong else "verified"
    text(f"{file} ({family.name}): {what} {verdict}{f', {skipped} of them not checked' if skipped else ''}")
    checks = [{"where": where} | entries_of(check) for where, check in placed]
    return {"file": str(file), "name": family.name, "passed": not wrong, "checks": checks}


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
    spread = {"shard": shard, "scheduler": scheduler, "workers": None if workers == 1 else workers}
    known = {kind_of(file) if file.is_file() else "" for file in files}
    if "equilibria" in known:
        _prove_rest(files, known, record, trust, given | spread | {"from": low, "to": high, "event": number})
        return
    if low is not None or high is not None:
        _prove_branch(files, low, high, record, trust, given | spread)
        return
    if "connection" in known:
        _prove_connections(files, known, record, trust, given | spread | {"event": number})
        return
    from orbitfinder.atlas.shard import WHOLE, shard_from
    from orbitfinder.proof.record import checked
    from orbitfinder.proof.theorem import Options

    usually = {} if number is None else {"order": 24, "tolerance": 1e-19}
    options, results = checked(Options(**usually | {k: v for k, v in given.items() if v is not None})), []
    if number is not None:
        _refuse(spread, "is for orbits; a single event is proved here")
        _prove_event(files, number, options, record, trust)
        return
    part = shard_from(shard) or WHOLE
    listed = [orbit for file in files for orbit in _orbits_in(file)][part.first :: part.parts]
    every = [file for file, proved in listed if not proved]  # left out now: shards have the same list at any time
    for file, orbit, proof, document in _proofs(every, options, record, trust, workers, scheduler):
        interrupt.check()
        _record(file, document, record, trust)
        results.append({"file": str(file), "name": orbit.name} | document)
        _print_proof(f"{file} ({orbit.name})", proof, document)
    _finish(results)


def _finish(results: list[Entries]) -> None:
    """The document of proofs, and whether all hold."""
    passed = all(result["proved"] for result in results)
    finish("proof", {"passed": passed, "results": results}, passed)


def _refuse(given: Table, why: str) -> None:
    """`InputError` for an option that is given and has no meaning."""
    for name, value in given.items():
        if value is not None:
            raise InputError(f"--{name}: {why}, leave it out")


def _orbits_in(file: Path) -> list[tuple[Path, bool]]:
    """The file, or of a whole atlas each orbit and whether it has a proof."""
    from orbitfinder.atlas.store import Atlas

    if member(file)[1] is not None or not file.is_file() or kind_of(file) != "atlas":
        return [(file, False)]
    with Atlas(file) as atlas:
        return [(Path(f"{file}#{row.id}"), bool(row.proof)) for row in atlas.rows()]


def _proofs(
    files: list[Path], options: Options, record: bool, trust: bool, workers: int, scheduler: str | None
) -> Iterator[tuple[Path, Orbit, Proof | None, Entries]]:
    """Each orbit with its proof and what is recorded of it; done elsewhere the proof itself stays there."""
    from orbitfinder.atlas.store import Atlas
    from orbitfinder.proof.record import entry, proved_entry
    from orbitfinder.proof.theorem import provable_model, prove

    orbits = []
    for file in files:
        orbits.append(load_orbit(file))
        if record:
            check_writable(file.parent, "--record")
            if _of_atlas(file):  # where it cannot be written to, that is said before the proof
                Atlas(member(file)[0], write=True, model=provable_model(orbits[-1], trusted(file, trust))).close()
    if workers == 1 and scheduler is None:
        for file, orbit in zip(files, orbits, strict=True):
            say = partial(_say, orbit.name)
            proof = prove(orbit, provable_model(orbit, trusted(file, trust)), options, say)
            yield file, orbit, proof, entry(proof)
        return
    home, left = trusted(files[0], trust) if files else None, time_left()
    with scheduler_at(scheduler, "prove", home) as far, crew(proved_entry, workers, "prove", far) as answers:
        folder = far.luggage.folder if far else None if home is None else str(home)
        for done, (k, document) in enumerate(answers([(orbit, folder, options) for orbit in orbits]), 1):
            note(f"{done} of {len(files)}: {files[k]}{left(done, len(files))}")
            yield files[k], orbits[k], None, document


def _of_atlas(file: Path) -> bool:
    """Whether FILE#K is an orbit of an atlas."""
    book, number = member(file)
    return number is not None and kind_of(book) == "atlas"


def _record(file: Path, document: Entries, record: bool, trust: bool) -> None:
    """Write what is proved into the atlas or the orbit.json that it is of."""
    from orbitfinder.atlas.store import Atlas
    from orbitfinder.proof.record import write_entry
    from orbitfinder.proof.theorem import provable_model

    if not (record and document["proved"]):
        return
    book, number = member(file)
    if _of_atlas(file) and number is not None:
        with Atlas(book, write=True, model=provable_model(load_orbit(file), trusted(file, trust))) as atlas:
            atlas.describe(number, document)
    elif file.exists():
        write_entry(file, document)
    else:
        note(f"{file}: the proof is not recorded, which only an orbit.json or an atlas can be given")


def _prove_branch(
    files: tuple[Path, ...], low: float | None, high: float | None, record: bool, trust: bool, given: Entries
) -> None:
    """`prove FAMILY.json --from A --to B`."""
    from orbitfinder.proof.branch import branch_document, prove_branch
    from orbitfinder.proof.theorem import provable_model
    from orbitfinder.records.family import load_family
    from orbitfinder.records.reading import write_json

    if low is None or high is None or len(files) != 1:
        raise InputError("--from, --to: give both, and one FAMILY.json")
    _refuse(given | {"symmetry": None}, "is for single orbits; a branch chooses its own")
    file = files[0]
    family = load_family(file)
    target = file.parent / "branch-proof.json"
    if record:
        check_writable(file.parent, "--record")
        # a proof that is there of more than this is kept
        known = None
        with suppress(InputError):  # damaged, of an older version, or none
            known = load(target)
        if known is not None and known.proved and not low <= known.low <= known.high <= high:
            there, wanted = (f"{ends[0]!r} to {ends[1]!r}" for ends in ((known.low, known.high), (low, high)))
            raise InputError(f"{target}: from: {there} is proved there, and {wanted} asked for; that is not written "
                             "over: give a wider range, --no-record, or move that file")  # fmt: skip
    model = provable_model(family.points[0], trusted(file, trust))
    branch = prove_branch(family, low, high, model, partial(_say, family.name), given.get("symmetry"))
    interrupt.check()
    if branch.proved and record:
        write_json(target, branch_document(branch))
    _print_branch(f"{file} ({family.name})", branch)
    passed = branch.proved and all(passage.proved for passage in branch.passages)
    finish("proof", {"passed": passed} | branch_document(branch), passed)


def _prove_rest(files: tuple[Path, ...], known: set[str], record: bool, trust: bool, given: Entries) -> None:
    """`prove EQUILIBRIA.json ...`."""
    from orbitfinder.families.equilibrium import load_equilibria
    from orbitfinder.proof.equilibria import CODEC, prove_equilibria
    from orbitfinder.proof.theorem import provable_system

    _refuse(given, "is for orbits and families; equilibria are proved whole")
    if len(known) > 1:
        raise InputError("FILE: equilibria and others together; prove them by a command each")
    results = []
    for file in files:
        equilibria = load_equilibria(file)
        if record:
            check_writable(file.parent, "--record")
        proof = prove_equilibria(equilibria, provable_system(equilibria.system, trusted(file, trust)), note)
        interrupt.check()
        if record and any(part.proved for part in proof.parts):
            CODEC.save(proof, file.with_name(f"{file.stem}-proof.json"))
        _print_rest(f"{file} ({proof.name})", proof)
        results.append({"file": str(file), "proved": proof.proved} | entries_of(proof))
    _finish(results)


def _prove_connections(files: tuple[Path, ...], known: set[str], record: bool, trust: bool, given: Entries) -> None:
    """`prove CONNECTION.json ...`."""
    from orbitfinder.proof.connections import CODEC, prove_connection
    from orbitfinder.proof.record import checked
    from orbitfinder.proof.theorem import Options, provable_system

    chosen = {name: given.pop(name) for name in ("order", "bits", "tolerance")}
    _refuse(given, "is for orbits and families")
    if len(known) > 1:
        raise InputError("FILE: connections and others together; prove them by a command each")
    options, results = checked(Options(**{k: v for k, v in chosen.items() if v is not None})), []
    for file in files:
        connection = load(file)
        if record:
            check_writable(file.parent, "--record")
        model, say = provable_system(connection.system, trusted(file, trust)), partial(_say, connection.name)
        proof = prove_connection(connection, model, options, say)
        interrupt.check()
        if proof.proved and record:
            CODEC.save(proof, file.with_name(f"{file.stem}-proof.json"))
        _print_words(f"{file} ({proof.name})", proof)
        results.append({"file": str(file)} | CODEC.document(proof))
    _finish(results)


def _say(name: str, line: str) -> None:
    note(f"{name}: {line}")


def _replayed(wrong: Sequence[str], again: Any, what: str) -> Entries:
    """What a proof made again says: `passed`, and `message`, a sentence."""
    proved = f"proof replayed in {again.wall_time:.1f} s: proved, {what}"
    return {"passed": not wrong, "message": f"proof REJECTED: {'; '.join(wrong)}" if wrong else proved}


def _print_words(heading: str, proof: BorderedRecord | ConnectionRecord) -> None:
    """What a record says line by line, or why nothing is proved."""
    if not proof.proved:
        text(f"{heading}: not proved: {proof.reason}")
        return
    text(f"{heading}: proved in {proof.wall_time:.1f} s")
    for name, said in proof.words:
        text(f"  {name:<12}{said}")


def verify_connection(file: Path, trust: bool) -> Entries:
    """Replay a recorded proof of a connection: `passed`, and `message`, a sentence."""
    from orbitfinder.proof.connections import read_connection_proof, replayed_connection, unproved_claims
    from orbitfinder.proof.theorem import provable_system

    recorded = read_connection_proof(file)
    again = replayed_connection(recorded, provable_system(recorded.system, trusted(file, trust)), note)
    return _replayed(unproved_claims(recorded, again), again, again.kind)


def _print_rest(heading: str, proof: ProvedEquilibria) -> None:
    """How many points are proved and what of each event."""
    points = [part for part in proof.parts if not part.event]
    verdicts = Counter(part.stability for part in points if part.proved)
    said = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    text(f"{heading}: {verdicts.total()} of {plural(len(points), 'point')} proved in "
         f"{proof.wall_time:.1f} s{f': {said}' if said else ''}")  # fmt: skip
    for part in proof.parts:
        if not part.proved:
            text(f"  {part.place}: not proved: {part.reason}")
        elif part.event and part.value:
            known = {proof.parameter: part.value} | dict(part.known or {})
            numbers = ", ".join(f"{name} {_shown(ball)}" for name, ball in known.items())
            said = f"{part.criticality} proved".strip()
            text(f"  {part.place}: {said}, alone within {part.radius:.0e} of its sizes; {numbers}")


def _shown(ball: Table) -> str:
    """A recorded ball with its digits."""
    value, within = float(ball["value"]), float(ball["radius"])
    places = 18 if not within else max(min(18, int(log10(abs(value) / within)) if value else 1), 1)
    return f"{Decimal(ball['value']):.{places}g} +/- {within:.0e}"


def verify_rest(file: Path, trust: bool) -> Entries:
    """Replay a recorded proof of equilibria: `passed`, and `message`, a sentence."""
    from orbitfinder.proof.equilibria import CODEC, replay_equilibria
    from orbitfinder.proof.theorem import provable_system

    recorded = CODEC.load(file)
    again, wrong = replay_equilibria(recorded, provable_system(recorded.system, trusted(file, trust)), note)
    events = [part for part in again.parts if part.event]
    what = f"{plural(len(again.parts) - len(events), 'point')}, {plural(len(events), 'event')}"
    return _replayed(wrong, again, what)


def _print_branch(heading: str, branch: ProvedBranch) -> None:
    if not branch.proved:
        text(f"{heading}: not proved: {branch.reason}")
        return
    text(f"{heading}: proved in {branch.wall_time:.1f} s")
    what = f"{branch.formulation.symmetry.name} orbit" if branch.formulation.symmetry.maps else "orbit"
    text(f"  {'branch':<12}exactly one {what} for each energy from {branch.low!r} to {branch.high!r} J in the boxes of "
         f"{plural(len(branch.pieces), 'piece')}, without a gap")  # fmt: skip
    for event in branch.passages:
        verdict = "proved" if event.proved else "NOT PROVED, no change of sign"
        more = f"; {event.kept} orbits branch off" if event.kept else ""
        said = f"{event.kind.replace('_', ' ')}, nu + 1/nu = {event.level:.6g}"
        text(f"  {'event':<12}{said}: {event.test} from {event.low} to {event.high}: {verdict}{more}")


def verify_branch(file: Path, trust: bool) -> Entries:
    """Replay a recorded proof of a branch: `passed`, and `message`, a sentence."""
    from orbitfinder.mechanics.kind import build_model
    from orbitfinder.proof.branch import contradictions, read_branch, replayed

    recorded = read_branch(file)
    again = replayed(recorded, build_model(dict(recorded.system), trusted(file, trust)), note)
    wrong = contradictions(recorded, again) if again.proved else [again.reason]
    borne = [passage for passage in again.passages if passage.proved]
    return _replayed(wrong, again, f"{plural(len(again.pieces), 'piece')}, {plural(len(borne), 'event')}")


def _prove_event(files: tuple[Path, ...], number: int, options: Options, record: bool, trust: bool) -> None:
    """`prove FAMILY.json --event K`."""
    from orbitfinder.proof.bordered import events, prove_event
    from orbitfinder.proof.theorem import provable_model
    from orbitfinder.records.family import load_family

    if len(files) != 1:
        raise InputError("--event: give a single FAMILY.json")
    file, family = files[0], load_family(files[0])
    if record:
        check_writable(file.parent, "--record")
    model = provable_model(family.points[0], trusted(file, trust))
    event = prove_event(family, number, model, options, partial(_say, family.name))
    interrupt.check()
    if event.proved and record:
        events.save(event, file.parent / f"event-{number}-proof.json")
    _print_words(f"{file} ({family.name}): event {number}", event)
    finish("proof", events.document(event), event.proved)


def verify_event(file: Path, trust: bool) -> Entries:
    """Replay a recorded proof of an event: `passed`, and `message`, a sentence."""
    from orbitfinder.mechanics.kind import build_model
    from orbitfinder.proof.bordered import false_claims, read_event, replayed_event

    recorded = read_event(file)
    again = replayed_event(recorded, build_model(dict(recorded.system), trusted(file, trust)), note)
    return _replayed(false_claims(recorded, again), again, again.kind.replace("_", " "))


def _print_proof(heading: str, proof: Proof | None, document: Entries) -> None:
    if not document["proved"]:
        text(f"{heading}: not proved: {document['reason']}")
        return
    text(f"{heading}: proved in {document['wall_time']:.1f} s")
    if proof is None:
        return
    assert proof.stability is not None
    what = "orbit" if proof.symmetry == "none" else f"{proof.symmetry} orbit"
    level = "" if proof.energy is None else " of this energy"
    rows = (
        ("box", f"exactly one {what}{level} within {proof.radius:.2g} of the nodes"),
        ("period", f"{proof.period.str(20)} s, minimal"),
        ("distance", f"record within {proof.distance:.1g} of the orbit, period within {proof.period_distance:.1g} s"),
        ("contraction", f"{proof.contraction:.2g} ({plural(proof.segments, 'segment')}, {plural(proof.steps, 'step')}, "
                        f"order {proof.settings.order}, {proof.settings.bits} bits)"),
        ("stability", f"{proof.stability.verdict}: {proof.stability.reason}"),
    )  # fmt: skip
    for name, said in rows:
        text(f"  {name:<12}{said}")
    for mu in proof.stability.multipliers:
        text(f"  {'multiplier':<12}{mu.str(12)}")


def verify_proof(file: Path, trust: bool) -> Entries:
    """Replay the proof recorded in a file: `passed`, and `message`, a sentence."""
    from orbitfinder.proof.record import read_entry, replay
    from orbitfinder.proof.theorem import provable_model

    orbit = load_orbit(file)
    proof, wrong = replay(orbit, read_entry(orbit, file), provable_model(orbit, trusted(file, trust)))
    return _replayed(wrong, proof, proof.stability.verdict if proof.stability else "")


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
    from orbitfinder.proof.theorem import provable_model, settings_for
    from orbitfinder.proof.theorem import refine as refined

    settings, orbit = settings_for(digits, order, bits), load_orbit(file)
    model = provable_model(orbit, trusted(file, trust))
    digitized = refined(orbit, settings, digits, model, symmetry, enclose, note)
    document = refined_document(digitized)
    proved = "enclosed" if digitized.enclosed else f"not enclosed ({digitized.reason})"
    text(f"{file}: {plural(digitized.digits, 'digit')}, {proved}, {digitized.wall_time:.1f} s")
    wide = max(map(len, ("period", *model.state_names))) + 2
    for name, ball in zip(("period", *model.state_names), (document["period"], *document["state"]), strict=True):
        within = f" +/- {ball['radius']:.1e}" if digitized.enclosed and float(ball["value"]) else ""
        text(f"  {name:<{wide}}{ball['value']}{within}{' s' if name == 'period' else ''}")
    finish("refined", document, digitized.enclosed or not enclose)


def refined_document(orbit: RefinedOrbit) -> Entries:
    """The JSON form of a refined orbit."""
    from orbitfinder.proof.balls import precision
    from orbitfinder.proof.record import enclosure

    with precision(orbit.settings.bits):
        places = orbit.digits + 4
        return {
            "digits": orbit.digits, "enclosed": orbit.enclosed,
            "reason": orbit.reason, "symmetry": orbit.symmetry,
            "energy": None if orbit.energy is None else enclosure(orbit.energy, places),
            "period": enclosure(orbit.period, places), "state": [enclosure(x, places) for x in orbit.state],
            "phase": float(orbit.phase), "order": orbit.settings.order, "bits": orbit.settings.bits,
            "wall_time": round(orbit.wall_time, 1),
        }  # fmt: skip
