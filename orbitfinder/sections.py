"""Poincare sections, bifurcation diagrams of samples, invariant manifolds, connections of orbits: their records, files,
certificates and pictures."""

from orbitfinder._runtime.front import fronted_all
from orbitfinder.proof.connections import ConnectionRecord, prove_connection
from orbitfinder.show.bifurcation import draw_bifurcation
from orbitfinder.show.frequencies import draw_frequencies
from orbitfinder.show.sections import draw_manifolds, draw_section
from orbitfinder.structures.bifurcation import Bifurcation, load_bifurcation, save_bifurcation
from orbitfinder.structures.connections import certify_connection, follow_connection
from orbitfinder.structures.manifold import (
    Connection,
    Manifold,
    load_connection,
    load_manifold,
    save_connection,
    save_manifold,
)
from orbitfinder.structures.manifolds import ManifoldSettings
from orbitfinder.structures.section import Section, load_section, save_section

__all__ = [
    "Bifurcation", "Connection", "ConnectionRecord", "Manifold", "ManifoldSettings", "Section", "certify_connection",
    "draw_bifurcation", "draw_frequencies", "draw_manifolds", "draw_section", "follow_connection", "load_bifurcation",
    "load_connection", "load_manifold", "load_section", "prove_connection", "save_bifurcation", "save_connection",
    "save_manifold", "save_section",
]  # fmt: skip
fronted_all(globals())
