"""Where ``gibson-sim`` begins. Everything else is imported once Ctrl-C ends the process silently."""

from __future__ import annotations

import sys

from gibson_sim import interrupts


def main(argv: list[str] | None = None) -> None:
    """Runs a sub-command and ends the process with its exit code; errors are one line on stderr.

    Args:
        argv: words behind ``gibson-sim``; None = this process is ``gibson-sim``, and its command line has them.
    """
    if argv is None:
        interrupts.end_silently()
    from gibson_sim.cli.command_line import run

    code = run(sys.argv[1:] if argv is None else argv)
    if argv is None and code == interrupts.INTERRUPTED:
        interrupts.die()
    sys.exit(code)


if __name__ == "__main__":
    main()
