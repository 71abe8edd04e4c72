"""The records of this room, for the registry of records."""

from dataclasses import replace

from orbitfinder._runtime.rooms import loaded
from orbitfinder.records.registry import KINDS, Kind
from orbitfinder.structures.bifurcation import CODEC as BIFURCATION
from orbitfinder.structures.manifold import load_connection, load_manifold
from orbitfinder.structures.phase_response import CODEC as PHASE
from orbitfinder.structures.section import load_section
from orbitfinder.structures.torus import load_tori

KINDS["tori"] = Kind(
    "a family of tori", load_tori, lambda tori: [replace(tori, tori=(torus,)) for torus in tori.tori], holds="tori",
    apart=True, verify=lambda tori, model: loaded("structures.tori:certify_torus")(tori.tori[-1], model).certificate,
    plot="show.tori:save_torus_figures", page="laid", export="exports.tables:export_table",
)  # fmt: skip
KINDS["section"] = Kind("a section", load_section, plot="show.figures:section_figures", page="sections")
KINDS["manifold"] = Kind("a manifold", load_manifold, plot="show.figures:section_figures", page="laid")
KINDS["connection"] = Kind(
    "a connection", load_connection, verify="structures.connections:certify_connection",
    plot="show.figures:section_figures", page="laid",
)  # fmt: skip
KINDS[PHASE.name] = Kind(
    "a phase response", PHASE.load, verify="structures.phase_response:certify_phase_response",
    plot="show.phase:save_phase_figure",
)  # fmt: skip
KINDS[BIFURCATION.name] = Kind(
    "a brute-force bifurcation diagram", BIFURCATION.load, verify="structures.bifurcation:verified",
    plot="show.bifurcation:save_bifurcation_figure", export="exports.tables:export_table",
)  # fmt: skip
