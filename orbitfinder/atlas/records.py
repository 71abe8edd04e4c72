"""The records of this room, for the registry of records."""

from orbitfinder._runtime.rooms import loaded
from orbitfinder.records.orbit import AGAIN
from orbitfinder.records.reading import json_file
from orbitfinder.records.registry import KINDS, Kind

KINDS["atlas"] = Kind(
    "an atlas", "atlas.store:Atlas", one="atlas.store:stored", first=1,
    facts=lambda atlas: {"system": atlas.system, **loaded("atlas.report:summarise")(atlas).document()},
    plot=lambda atlas, folder, _: loaded("show.plot:save_atlas_figures")(atlas, folder),
    page="site.gather:add_atlas", studio="atlas",
)  # fmt: skip
KINDS["export"] = Kind(
    "an export of an atlas", lambda path: json_file(path, "atlas export", AGAIN), list,
    facts=lambda entries: {"orbits": len(entries)}, page="site.gather:add_export",
)  # fmt: skip
