"""Everything that commands print: progress, reports, tables, pages."""
