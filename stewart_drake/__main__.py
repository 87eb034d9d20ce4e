"""`python -m stewart_drake`, and where the command `stewart-drake` begins."""

import sys


def main() -> None:
    """`app.main`; Ctrl-C while that loads ends in one line too."""
    try:
        from stewart_drake.cli.app import main as run
    except KeyboardInterrupt:
        sys.stderr.write("stewart-drake: interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
