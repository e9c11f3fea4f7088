"""Everything that commands print: progress, reports, tables and pages."""
