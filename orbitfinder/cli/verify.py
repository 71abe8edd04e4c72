"""The command `verify`: recompute certificates, and replay proofs, from the files alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orbitfinder._runtime import interrupt
from orbitfinder.cli.options import finish, json_option, orbit_files, text, trust_option

if TYPE_CHECKING:
    from orbitfinder.records.orbit import Certificate


@click.command()
@orbit_files
@click.option("--proof", is_flag=True, help="Replay the recorded proof of each file too (see `orbitfinder prove`).")
@trust_option()
@json_option
def verify(files: tuple[Path, ...], proof: bool, trust: bool) -> None:
    """Recompute the certificate of each ORBIT.json from the file alone.

    Another integrator, another formulation, nothing taken on trust. Exit code 0: every check of
    every file passed; 1: some failed, and are named. The equations of a system that a Python module
    of yours makes are that module's; it is run only with --trust. FILE#K is point K of a family.json,
    counted from 0, or orbit K of an atlas.

    \b
    Examples:
      orbitfinder verify orbits/triple-1/orbit.json
      orbitfinder verify orbits/*/orbit.json --json
      orbitfinder verify families/triple-mode-2/family.json#17
    """
    from orbitfinder.cli.jobs import verify_file
    from orbitfinder.cli.prove import verify_proof
    from orbitfinder.records.orbit import certificate_to_document

    results = []
    for file in files:
        orbit, certificate = verify_file(file, trust)
        interrupt.check()
        results.append({"file": str(file), "name": orbit.name} | certificate_to_document(certificate))
        _print_certificate(f"{file} ({orbit.name})", certificate)
        if proof:
            results[-1]["proof"] = verify_proof(file, trust)
            text(f"  {results[-1]['proof']['message']}")
    passed = all(result["passed"] and result.get("proof", result)["passed"] for result in results)
    finish("verify", {"passed": passed, "results": results}, passed)


def _print_certificate(heading: str, certificate: Certificate) -> None:
    from orbitfinder.cli.jobs import one_line

    verdict = "certified" if certificate.passed else f"REJECTED by {', '.join(certificate.failures)}"
    text(f"{one_line(heading)}: {verdict}")
    text(f"  {'check':<22}{'value':>11}{'allowed':>11}  result  note")
    for check in certificate.checks:
        result, note = "passed" if check.passed else "FAILED", one_line(check.note)
        text(f"  {check.name:<22}{check.value:>11.2e}{check.tolerance:>11.2e}  {result}  {note}".rstrip())
