"""Built-in systems, for problem files with kind = "python" and for Python: each function returns a Model.

Only what is listed in `FUNCTIONS` can be named in a problem file without --trust.
"""

from __future__ import annotations

from collections.abc import Callable

from orbitfinder.mechanics.library.mechanisms import (
    cart_chain,
    henon_heiles,
    pendulum_on_cart,
    planar_oscillator,
    restricted_three_body,
    spring_pendulum,
)
from orbitfinder.mechanics.library.oscillators import (
    double_well,
    duffing,
    forced_duffing,
    forced_pendulum,
    rotating_hoop,
    van_der_pol,
    vibrated_pendulum,
)
from orbitfinder.mechanics.model import Model

FUNCTIONS: dict[str, Callable[..., Model]] = {
    one.__name__: one
    for one in (
        cart_chain, double_well, duffing, forced_duffing, forced_pendulum, henon_heiles, pendulum_on_cart,
        planar_oscillator, restricted_three_body, rotating_hoop, spring_pendulum, van_der_pol, vibrated_pendulum,
    )
}  # fmt: skip
