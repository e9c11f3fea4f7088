"""Reads agent definitions from glTF files, and writes them."""
