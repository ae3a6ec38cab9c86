"""Ctrl-C before a program has handlers of its own."""

import signal


def end_silently() -> None:
    """Let Ctrl-C end this process as it ends any other program, without a word: Python's own handler would raise an
    exception in the midst of whatever is being imported.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
