"""`python -m antdsl` is the command `antdsl`."""

from antdsl.cli import main

if __name__ == "__main__":
    main()
