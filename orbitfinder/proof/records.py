"""The records of this room, for the registry of records."""

from orbitfinder.records.registry import KINDS, Kind

KINDS["branch-proof"] = Kind(
    "a proof of a family's branch (`verify --proof` replays it)", "proof.branch:read_branch",
    facts="proof.branch:branch_document",
)  # fmt: skip
KINDS["equilibria-proof"] = Kind(
    "a proof of equilibria, folds and Hopf points (`verify --proof` replays it)", "proof.equilibria:read_proof",
)  # fmt: skip
KINDS["event-proof"] = Kind(
    "a proof of an event of a family (`verify --proof` replays it)", "proof.bordered:read_event",
)  # fmt: skip
KINDS["connection-proof"] = Kind(
    "a proof of a connection (`verify --proof` replays it)", "proof.connections:read_connection_proof",
)  # fmt: skip
