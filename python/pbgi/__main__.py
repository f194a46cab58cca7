"""The program `pbgi` with its commands bake, shade, info and demo: `pbgi` on the PATH, or `python -m pbgi`."""

import sys

from . import _pbgi


def main():
    """Runs the program with the arguments of this process; its exit code."""
    return _pbgi.run_program(["pbgi", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
