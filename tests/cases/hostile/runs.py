"""."""
from cases.hostile.rows import Row
ROWS: list[Row] = []
