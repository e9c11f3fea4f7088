"""What rounding may do to a crossing."""

CLOSED = 1e-9  # weight by which a crossing may lie outside of a face, so that none is lost between two of them
