"""The answers of this room about orbits and families, for the registry of records."""

from orbitfinder.records.registry import answers

answers("orbit", plot="show.plot:save_figures", animate="show.animate:orbit_clip")
answers("family", plot="show.plot:save_figures")
answers("equilibria", plot="show.equilibria:save_equilibria_figure")
answers("diagram", plot="show.equilibria:save_diagram_figure")
answers("map", plot="show.maps:save_map_figure")
