"""What an editor asks for, one file a feature: completion, hover, definitions, symbols, hints, colours of words, actions."""
