"""The records of this room, and its answers about orbits, for the registry of records."""

from orbitfinder.records.registry import KINDS, Kind, answers

answers("orbit", prove="proof.record:proving", replay="proof.record:replayed")
KINDS["branch-proof"] = Kind(
    "a proof of a family's branch (`verify --proof` replays it)", "proof.branch:read_branch",
    facts="proof.branch:branch_document", prove="proof.branch:proving", replay="proof.branch:replay",
)  # fmt: skip
KINDS["equilibria-proof"] = Kind(
    "a proof of equilibria, folds and Hopf points (`verify --proof` replays it)", "proof.equilibria:read_proof",
    prove="proof.equilibria:proving", replay="proof.equilibria:replay",
)  # fmt: skip
KINDS["event-proof"] = Kind(
    "a proof of an event of a family (`verify --proof` replays it)", "proof.bordered:read_event",
    prove="proof.bordered:proving", replay="proof.bordered:replay",
)  # fmt: skip
KINDS["connection-proof"] = Kind(
    "a proof of a connection (`verify --proof` replays it)", "proof.connections:read_connection_proof",
    prove="proof.connections:proving", replay="proof.connections:replay",
)  # fmt: skip
