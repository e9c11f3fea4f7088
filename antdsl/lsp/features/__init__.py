"""Editor features, one per file: completion, hover, definitions, symbols, hints, semantic colours, actions."""
