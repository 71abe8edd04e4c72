"""The certificate's evidence for a long chain: Lagrange's equations in closed form, O(n^2) numbers a step.

Hamilton's equations of any Model go through a dense inverse mass matrix as one CasADi graph, and their
momenta (2000 kg m^2/s at 100 links, on which velocities depend through the inverse of a matrix of
condition 5e4) would lose the digits that a closure of 1e-12 needs. The closed form keeps velocities, is
derived from the energies alone, and shares neither code nor formulation with the recursion that found
the orbit.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder.mechanics.chain_lagrange import ChainLagrange, chain_lagrange
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.periodic.certify import SAMPLES, Evidence, gap, symplectic_defect, trivial_defect
from orbitfinder.periodic.floquet import analyse, reduce_monodromy
from orbitfinder.reference import SECOND, STEPS_PER_PERIOD, ReferenceSettings, integrate

FEWEST_LINKS = 11
"""Chains from this length on are long; shorter ones are quick in every formulation."""
