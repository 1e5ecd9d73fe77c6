"""Entry point of ``gibson-sim``. Configures Ctrl-C to end the process silently before it imports other modules."""

from __future__ import annotations

import os
import sys

from gibson_sim import interrupts


def main(argv: list[str] | None = None) -> None:
    """Runs a sub-command and ends the process with its exit code; errors are one line on stderr.

    Args:
        argv: arguments of ``gibson-sim``; None = those of this process.
    """
    if argv is None:
        interrupts.end_silently()
        if "_ARGCOMPLETE" in os.environ:  # a shell completes a command line
            from gibson_sim.cli.commands.completion import answer

            answer()
    from gibson_sim.cli.command_line import run

    code = run(sys.argv[1:] if argv is None else argv)
    if argv is None and code == interrupts.INTERRUPTED:
        interrupts.die()
    sys.exit(code)


if __name__ == "__main__":
    main()
