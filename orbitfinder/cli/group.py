"""The command line. Heavy modules are imported inside the commands, so that --help is quick.

Exit codes: 0 everything certified, 1 something did not converge or certify, 2 bad input, 130 Ctrl-C.
"""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.version import __version__
from orbitfinder.cli import atlas as cataloguing
from orbitfinder.cli import completion, doctor, pictures
from orbitfinder.cli import continue_ as following
from orbitfinder.cli import export as exporting
from orbitfinder.cli import guess as guessing
from orbitfinder.cli import page as paging
from orbitfinder.cli import prove as proving
from orbitfinder.cli import search as searching
from orbitfinder.cli.options import (
    FILES,
    JSON_KEY,
    compile_option,
    json_option,
    limit_option,
    print_json,
    trust_option,
)
from orbitfinder.errors import InputError, OrbitfinderError

if TYPE_CHECKING:
    from orbitfinder.records.orbit import Certificate

LIMITS = {"run": 600.0, "simulate": 600.0, "guess": 600.0, "verify": 3600.0}
"""s after which a command stops unless --limit says otherwise: the slowest search that we ship, 100 links, takes 46.
The others go on for as long as they are let."""
NOT_CERTIFIED, BAD_INPUT, INTERRUPTED = 1, 2, 130


class Commands(click.Group):
    """A group whose commands take --limit and end with a sentence and an exit code, never with a traceback."""

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """A command with the option --limit; what it starts with is how long it may take, see `LIMITS`."""
        if not isinstance(cmd, click.Group):
            cmd.params.append(limit_option(LIMITS.get(cmd.name or ""), "each search" if cmd.name == "run" else ""))
        super().add_command(cmd, name)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that is meant; a file in its place is answered with the command that takes it."""
        if args and args[0] not in self.commands and Path(args[0]).is_file():
            verb = "verify" if args[0].endswith(".json") else "run"
            meant = f"orbitfinder {verb} {args[0]}"
            raise click.UsageError(f"{args[0]!r} is a file, not a command. Did you mean: {meant}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; turn the exceptions made for people into messages."""
        with interrupt.watch():
            try:
                return super().invoke(ctx)
            except (KeyboardInterrupt, click.Abort):
                return _interrupted(ctx)
            except OrbitfinderError as error:
                if interrupt.seen:
                    return _interrupted(ctx)
                _complain(ctx, error)
                ctx.exit(BAD_INPUT if isinstance(error, InputError) else NOT_CERTIFIED)
            except Exception as error:
                if interrupt.seen:  # what CasADi makes of an interrupt
                    return _interrupted(ctx)
                if not isinstance(error, OSError):
                    raise
                _complain(ctx, _refused(error))
                ctx.exit(BAD_INPUT)


def _interrupted(ctx: click.Context) -> None:
    click.echo("Interrupted: finished results are kept, nothing half-written.", err=True)
    ctx.exit(INTERRUPTED)


def _refused(error: OSError) -> InputError:
    """What the system does not allow, in a sentence; without a name it is a standard stream."""
    where, why = error.filename or "standard output", error.strerror or error
    return InputError(f"{where}: {why}; free some space or choose a place that you can read and write")


def _complain(ctx: click.Context, error: OrbitfinderError) -> None:
    from orbitfinder.cli.jobs import one_line

    message = one_line(error)
    with contextlib.suppress(OSError):  # a stream that is full has been complained of
        click.echo(f"Error: {message}", err=True)
        if ctx.meta.get(JSON_KEY):
            print_json({"format": "orbitfinder/error", "error": message})


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="orbitfinder")
def cli() -> None:
    """Find periodic orbits of mechanical systems and certify them.

    \b
    Examples:
      orbitfinder init my-pendulum
      orbitfinder run my-pendulum.toml
      orbitfinder verify orbits/my-pendulum/orbit.json
    """


@cli.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="FILE...")
@click.option("--out", default="orbits", show_default=True, type=FILES, help="Folder for DIR/<name>/orbit.json.")
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(1, 256), help="Processes side by side.")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw the certified orbits.")
@compile_option
@trust_option()
@json_option
def run(
    files: tuple[Path, ...], out: Path, jobs: int, figures: bool, limit: float | None, trust: bool, as_json: bool
) -> None:
    """Find and certify the orbit of each problem FILE.

    Writes DIR/<name>/orbit.json, orbit.npz and figures. A result that fails its certificate is
    written as rejected.json and named as such. Exit code 0: all certified; 1: some were not.

    \b
    Examples:
      orbitfinder run problems/report/triple-1.toml
      orbitfinder run problems/examples/*.toml --jobs 2 --out orbits --no-figures
    """
    from orbitfinder.cli.console import display
    from orbitfinder.cli.jobs import prepare, run_jobs

    todo = prepare(files, out, figures, trust, limit)
    outcomes = []
    with display() as shown:
        for outcome in run_jobs(todo, jobs, shown):
            interrupt.check()  # CasADi makes a failed search of Ctrl-C
            outcomes.append(outcome)
            shown.say(f"{outcome.name}: {outcome.message}, {outcome.wall_time:.1f} s")
    if as_json:
        passed = all(outcome.passed for outcome in outcomes)
        results = [outcome.document() for outcome in outcomes]
        print_json({"format": "orbitfinder/run", "passed": passed, "results": results})
    else:
        for outcome in outcomes:
            _print_outcome(outcome)
    if not all(outcome.passed for outcome in outcomes):
        click.get_current_context().exit(NOT_CERTIFIED)


def _print_outcome(outcome: Any) -> None:
    if outcome.period is None:
        click.echo(f"{outcome.name}: {outcome.status}: {outcome.message}")
        return
    click.echo(
        f"{outcome.name}: {outcome.status}, period {outcome.period!r} s, energy {outcome.energy!r} J, "
        f"closure {outcome.closure:.1e}, {outcome.stability}, symmetry {outcome.symmetry}"
        + "".join(f", {name} = {value!r}" for name, value in outcome.chosen.items())
    )
    if outcome.failures:
        click.echo(f"  failed checks: {', '.join(outcome.failures)}")
    click.echo(f"  {outcome.written[0]}" + (f" and {len(outcome.written) - 1} figures" * (len(outcome.written) > 1)))


@cli.command()
@click.argument("files", nargs=-1, required=True, type=FILES, metavar="ORBIT.json...")
@click.option("--proof", is_flag=True, help="Replay the recorded proof of each file too (see `orbitfinder prove`).")
@trust_option()
@json_option
def verify(files: tuple[Path, ...], proof: bool, trust: bool, as_json: bool) -> None:
    """Recompute the certificate of each ORBIT.json from the file alone.

    Another integrator, another formulation, nothing taken on trust. Exit code 0: every check of
    every file passed; 1: some failed, and are named. The equations of a system that a Python module
    of yours makes are that module's; it is run only with --trust.

    \b
    Examples:
      orbitfinder verify orbits/triple-1/orbit.json
      orbitfinder verify orbits/*/orbit.json --json
    """
    from orbitfinder.cli.jobs import verify_file
    from orbitfinder.records.orbit import certificate_to_document

    results = []
    for file in files:
        orbit, certificate = verify_file(file, trust)
        interrupt.check()
        results.append({"file": str(file), "name": orbit.name} | certificate_to_document(certificate))
        if not as_json:
            _print_certificate(f"{file} ({orbit.name})", certificate)
        if proof:
            results[-1]["proof"] = proving.verify_proof(file, trust)
            if not as_json:
                click.echo(f"  {results[-1]['proof']['message']}")
    passed = all(result["passed"] and result.get("proof", result)["passed"] for result in results)
    if as_json:
        print_json({"format": "orbitfinder/verify", "passed": passed, "results": results})
    if not passed:
        click.get_current_context().exit(NOT_CERTIFIED)


def _print_certificate(heading: str, certificate: Certificate) -> None:
    from orbitfinder.cli.jobs import one_line

    verdict = "certified" if certificate.passed else f"REJECTED by {', '.join(certificate.failures)}"
    click.echo(f"{one_line(heading)}: {verdict}")
    click.echo(f"  {'check':<22}{'value':>11}{'allowed':>11}  result  note")
    for check in certificate.checks:
        result = "passed" if check.passed else "FAILED"
        note = one_line(check.note)
        click.echo(f"  {check.name:<22}{check.value:>11.2e}{check.tolerance:>11.2e}  {result}  {note}".rstrip())


@cli.command()
@click.argument("file", type=FILES)
@click.option("--duration", type=float, default=None, help="Time in s; default: [simulate] duration or 10.")
@click.option("--out", default=None, type=FILES, help="Write DIR/<name>/simulation.csv.")
@trust_option()
@json_option
def simulate(file: Path, duration: float | None, out: Path | None, trust: bool, as_json: bool) -> None:
    """Simulate the system of a problem FILE from its state and report what becomes of the energy.

    \b
    Examples:
      orbitfinder simulate problems/report/triple-1.toml --duration 20
      orbitfinder simulate problems/examples/double.toml --out runs
    """
    from orbitfinder.cli.jobs import check_writable
    from orbitfinder.exports.table import csv_text
    from orbitfinder.orbits.simulate import simulate as simulated
    from orbitfinder.problemfile.read import load_problem_file
    from orbitfinder.records.orbit import write_atomically

    loaded = load_problem_file(file, trust)
    if out is not None:
        check_writable(out)
        check_writable(out / loaded.name)
    span = loaded.duration if duration is None else duration
    if not (math.isfinite(span) and span > 0):
        raise InputError(f"--duration: must be positive and finite, got {span}; give a time in s")
    if loaded.start is None:
        raise InputError(f"{file}: simulate.state: missing; give it, or a [guess] to start from")
    result = simulated(loaded.model, loaded.start, span)
    document = {"name": loaded.name} | result.document()
    if out is not None:
        written = out / loaded.name / "simulation.csv"
        write_atomically(written, csv_text(result.state_names, result.times, result.states).encode())
        document["written"] = str(written)
    if as_json:
        print_json({"format": "orbitfinder/simulation"} | document)
        return
    click.echo(f"{loaded.name}: {result.times[-1]:g} s simulated")
    click.echo(f"  {'energy':<22}{document['energy']:.12g} J")
    kind, more = ("drift", "") if result.conserved else ("change", ", which this system does not conserve")
    click.echo(f"  {f'energy {kind}':<22}{document[f'energy_{kind}']:.2e} J{more}")
    click.echo(f"  {'relative to exchanged':<22}{document[f'relative_energy_{kind}']:.2e}")
    click.echo(f"  {'end state':<22}" + ", ".join(f"{name} = {x:.9g}" for name, x in document["end"].items()))
    if out is not None:
        click.echo(f"  {document['written']}")


@cli.command()
@click.argument("name")
def init(name: str) -> None:
    """Write NAME.toml, a commented problem file to start from.

    \b
    Example:
      orbitfinder init my-pendulum && orbitfinder run my-pendulum.toml
    """
    from orbitfinder.problemfile.template import write_template

    path = write_template(name.removesuffix(".toml"))
    click.echo(f"{path}: written; next: orbitfinder run {path}")


for command in (
    pictures.reproduce,
    pictures.plot,
    pictures.animate,
    paging.page,
    following.follow,
    guessing.guess,
    searching.search,
    cataloguing.atlas,
    exporting.export,
    doctor.doctor,
    completion.completion,
    proving.prove_command,
    proving.refine_command,
):
    cli.add_command(command)
