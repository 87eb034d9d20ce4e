"""`python -m stewart_drake`, and where the command `stewart-drake` begins."""

import sys


def main() -> None:
    """`app.main`; Ctrl-C while that loads or ends, too, ends in a line."""
    try:
        from stewart_drake.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("stewart-drake: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
