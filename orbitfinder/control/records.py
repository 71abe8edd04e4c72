"""The records of this room, for the registry of records."""

from operator import attrgetter

from orbitfinder._runtime.rooms import loaded
from orbitfinder.control.controller import load_controller
from orbitfinder.control.optimum import load_optima
from orbitfinder.records.registry import KINDS, Kind

KINDS["optima"] = Kind(
    "a family of optima", load_optima, attrgetter("points"), apart=True, verify="orbits.certify:certify",
    plot=lambda optima, folder, _: [loaded("show.optima:save_optima_figure")(optima, folder)],
    page="site.gather:add_optima", export="exports.tables:export_table",
)  # fmt: skip
KINDS["controller"] = Kind(
    "a controller", load_controller, verify="control.feedback:certify_controller",
    plot="show.figures:controller_figures", export="control.export:export_program",
)  # fmt: skip
