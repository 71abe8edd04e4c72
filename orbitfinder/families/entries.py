"""Every kind of event that families know: what happens, its check, how it looks, what leads on from it."""

from __future__ import annotations

from functools import partial

from orbitfinder.families import checks
from orbitfinder.families.changes import nearest_margin
from orbitfinder.families.codimension_two import (
    along_circle,
    along_collisions,
    at_level,
    beside_level,
    doublings_turn,
    folds_turn,
    grazed,
    indices_meet,
    neutral,
    pair_at_circle,
)
from orbitfinder.families.events import extrema
from orbitfinder.families.registry import (
    FOLLOWED,
    KINDS,
    LOOKS,
    SWITCHABLE,
    EventKind,
    Followed,
    Look,
    is_kind,
    kind_of,
)

__all__ = ["FOLLOWED", "KINDS", "LOOKS", "SWITCHABLE", "is_kind", "kind_of"]

KINDS.update({
    "fold": EventKind(
        checks.check_fold,
        "a multiplier is +1 and the parameter turns back: two orbits come together and vanish",
        Look("v", "triangle-down", "#7B3294", pixels=11),
        extremal=True, critical=True, followed=Followed(at_level, beside_level, folds_turn), side=checks.fold_side,
    ),
    "turn": EventKind(
        checks.check_turn, "the period or a momentum is extremal, and no multiplier is +1",
        Look("1", "triangle-left", "#C2A5CF", pixels=9), extremal=True, critical=True,
    ),
    "extremum": EventKind(
        checks.check_watched, "a number that is watched is extremal",
        Look("2", "triangle-right", "#E7298A", pixels=9), test=extrema, extremal=True,
    ),
    "branch_point": EventKind(
        checks.check_crossing, "a multiplier is +1 and another family crosses, as a rule of less symmetry",
        Look("o", "circle-open", series=2, pixels=12, hollow=True, numbered=True, across=True),
        crosses=True, critical=True, branches=True, followed=Followed(at_level, beside_level),
    ),
    "avoided_crossing": EventKind(
        checks.check_avoided, "another family comes near and turns away: it was crossed over to, or this one followed",
        Look("|", "line-ns-open", "#666666", series=4, pixels=9),
    ),
    "period_doubling": EventKind(
        checks.check_passage, "a multiplier is -1: a family of twice the period is born",
        Look("s", "square", "#B2182B", series=3, pixels=9, numbered=True, across=True),
        critical=True, branches=True, followed=Followed(at_level, beside_level, doublings_turn), side=checks.birth_side,
    ),
    "resonance": EventKind(
        checks.check_passage, "a pair of multipliers is at a root of unity: a family of q times the period is born",
        Look(".", "circle", "#8C8C8C", series=4, size=3.5, pixels=7, line=0.0, many=True),
        branches=True, followed=Followed(at_level),
    ),
    "torus": EventKind(
        checks.check_torus, "a complex pair crosses the unit circle (Neimark and Sacker): tori are born",
        Look("P", "cross", "#01665E", series=4), critical=True,
        followed=Followed(pair_at_circle, along_circle, refused=neutral, beyond="a neutral saddle"),
        side=checks.birth_side,
    ),
    "collision": EventKind(
        checks.check_collision, "two pairs of multipliers meet and leave the circle, or come back to it (Krein)",
        Look("x", "x", "#8C510A", pixels=9, across=True), critical=True,
        followed=Followed(indices_meet, along_collisions, beyond="real multipliers that meet"),
    ),
    "stability_change": EventKind(  # the verdict changes where something else happens as well
        checks.check_stability, "the verdict on stability changes, at another event",
        Look("D", "diamond", "#4D4D4D", series=5, size=9.0, hollow=True), verdict=True,
    ),
    "grazing": EventKind(
        checks.check_margin, "a guard is only just reached (hybrid systems)",
        Look("*", "star"), followed=Followed(grazed, margin=nearest_margin),
    ),
    "cycle_change": EventKind(
        checks.check_margin, "events of the cycle swap or merge (hybrid systems)", Look("X", "hourglass", series=3)
    ),
    "holds": EventKind(
        checks.check_margin, "what must hold does no longer, such as a contact that would pull (hybrid systems)",
        Look("X", "bowtie", series=3),
    ),
    "cusp": EventKind(
        checks.check_cusp, "two folds meet: the curve stops in the plane of its parameters and turns back",
        Look("^", "triangle-up", series=3, pixels=11), second=True,
    ),
    "isola_centre": EventKind(
        partial(checks.check_extremal, True), "a fold's parameter is extremal: an isola shrinks to a point",
        Look("h", "hexagon", series=4), second=True,
    ),
    "transcritical": EventKind(
        partial(checks.check_extremal, False), "a fold's parameter is extremal: two families cross",
        Look("d", "diamond-tall", series=2, pixels=11), second=True,
    ),
    "strong_resonance": EventKind(
        checks.check_second, "the critical multipliers are at a root of unity of order 1 to 4, or two are at +1 or -1",
        Look("p", "pentagon", series=2), second=True, leaves=True,
    ),
    "fold_doubling": EventKind(
        checks.check_second, "a multiplier is +1 and another -1",
        Look("D", "diamond-wide", series=5, pixels=11), second=True,
    ),
    "fold_torus": EventKind(
        checks.check_second, "a multiplier is +1 beside the pair of a torus",
        Look("<", "triangle-left", series=4), second=True,
    ),
    "doubling_torus": EventKind(
        checks.check_second, "a multiplier is -1 beside the pair of a torus",
        Look(">", "triangle-right", series=4), second=True,
    ),
    "degenerate_doubling": EventKind(
        checks.check_bending, "the doubled orbit is born to the other side from there on",
        Look("H", "hexagon2", series=3), second=True,
    ),
})  # fmt: skip
