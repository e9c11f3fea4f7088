"""Commands that other programs start and talk to over standard input and output."""
