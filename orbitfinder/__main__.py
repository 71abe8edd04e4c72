"""`python -m orbitfinder` and the `orbitfinder` command."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import warnings

from orbitfinder._runtime import interrupt, streams

INTERRUPTED = 130


def main() -> None:
    """Run the command line; Ctrl-C at any moment, even during imports, is exit code 130."""
    streams.leave_current_folder_out()
    os.environ["MPLBACKEND"] = "agg"  # pictures are files; what the environment says may be no backend at all
    if os.path.exists("matplotlibrc"):  # Matplotlib would read its settings there before any others
        with contextlib.chdir(os.path.dirname(os.path.abspath(__file__))):
            import orbitfinder.show.style  # noqa: F401
    streams.sound()
    warnings.formatwarning = lambda message, category, *_, **__: f"{category.__name__}: {message}\n"
    try:
        with interrupt.watch():
            from orbitfinder._runtime import guard

            with guard.guarded():
                from orbitfinder.cli.group import cli

                cli(prog_name="orbitfinder")
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted.\n")
        _leave_interrupted()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            _leave_interrupted()
        raise
    finally:
        streams.abandoned()


def _leave_interrupted() -> None:
    """Exit with 130, or by SIGTERM where that was the cause, once everything else has been cleaned up.

    CPython remembers an interrupt that passed through exec() (as in the making of a dataclass) and
    would end by killing itself with SIGINT, however well the interrupt was handled.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    if signal.SIGTERM in interrupt.seen:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.raise_signal(signal.SIGTERM)
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
