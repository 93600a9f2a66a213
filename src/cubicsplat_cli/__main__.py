"""The `cubicsplat` command: our errors end as one line and an exit code, all others as a traceback."""

from __future__ import annotations

import sys

from cubicsplat_cli.errors import CubicSplatError
from cubicsplat_cli.words import one_line

# Messages quote names from files, which may be of any length.
MAX_MESSAGE = 1000


def main() -> None:
    """Run the command line; never returns (SystemExit carries the exit code: 0, 1, 2 or 130)."""
    if sys.argv[1:] == ["--version"]:
        # Scripts ask for it often: answered before the command line is built.
        from cubicsplat_cli._version import __version__

        print(f"cubicsplat {__version__}")
        sys.exit(0)
    try:
        from cubicsplat_cli.cli.app import app

        app(prog_name="cubicsplat")
    except CubicSplatError as error:
        message = one_line(error)[:MAX_MESSAGE]
        print(f"cubicsplat: error: {message}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
