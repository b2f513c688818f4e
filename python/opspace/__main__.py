"""The command line `opspace`, also as `python -m opspace`."""

import signal
import sys

from opspace import _opspace


def main() -> None:
    """Runs the command line with the arguments of the process, and exits with its code."""
    # The program catches signals itself; where it does not, they end the process.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(_opspace.main(["opspace", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
