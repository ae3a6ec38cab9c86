"""Where every command begins: ``swarmchase``, and ``python -m swarmchase``."""

import signal


def main() -> None:
    """Run the command of the command line.

    Until it has handlers of its own, Ctrl-C ends it as it ends any other program, without a word: Python's would raise
    an exception in the midst of whatever is being imported.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .cli import main as run

    run()


if __name__ == "__main__":
    main()
