"""Built-in systems: each function returns a Model, and problem files name them with kind = "python"."""

from orbitfinder.mechanics.library import (
    FUNCTIONS,
    cart_chain,
    double_well,
    duffing,
    forced_duffing,
    forced_pendulum,
    henon_heiles,
    pendulum_on_cart,
    planar_oscillator,
    restricted_three_body,
    rotating_hoop,
    spring_pendulum,
    three_bodies,
    van_der_pol,
    vibrated_pendulum,
)

__all__ = [
    "FUNCTIONS",
    "cart_chain",
    "double_well",
    "duffing",
    "forced_duffing",
    "forced_pendulum",
    "henon_heiles",
    "pendulum_on_cart",
    "planar_oscillator",
    "restricted_three_body",
    "rotating_hoop",
    "spring_pendulum",
    "three_bodies",
    "van_der_pol",
    "vibrated_pendulum",
]
