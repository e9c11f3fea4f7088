"""What commands print: progress, reports, tables, pages."""
