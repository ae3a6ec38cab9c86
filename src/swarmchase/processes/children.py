"""Children that end with the process that started them, whatever kills it, and leave signals to it."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker

from .stop_request import STOP_SIGNALS, StopRequest, noted_signals

PR_SET_PDEATHSIG = 1
"""Of prctl(2): the signal that the kernel sends a process when the thread that started it ends."""
LOOK_S = 0.5
"""How often a process looks whether its parent lives, where the kernel does not."""


def start_helper() -> None:
    """Start the process that Python has beside whoever shares locks or queues with children; to be called before any is
    made. It is deaf to SIGINT and SIGTERM of itself, and to SIGHUP only if it begins with that held back.
    """
    if hasattr(signal, "pthread_sigmask"):
        before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def starting_children() -> Iterator[None]:
    """Processes of ``multiprocessing`` that start inside the block have signals held back until ``begin_child``, and so
    has this one until the block's end: a terminal's Ctrl-C, ``timeout`` and systemd send them to all at once.

    The thread that starts them must outlive them.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    start_helper()  # otherwise it would come with the first of them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_child() -> StopRequest:
    """What a process of ``multiprocessing`` does first: it ends with its parent, and until then goes on.

    A signal makes the request that it gives, which the child is to pass on to its parent; so a signal to any process of
    a command stops the command.
    """
    end_with_parent()
    return noted_signals()


def end_with_parent() -> None:
    """The same for a process whose parent ends it by SIGTERM, as Python's pools do."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    assert parent.pid is not None
    end_with(parent.pid)


def child_command(words: Sequence[str]) -> list[str]:
    """The command line of ``swarmchase`` with these words, as a process that ends with this one."""
    return [sys.executable, "-m", "swarmchase.processes.child_command", str(os.getpid()), *words]


def end_with(parent: int) -> None:
    """This process is killed when its parent, ``parent``, has ended, or at once if it has: even one that stands still,
    on Linux.
    """
    if not _kernel_ends_it():
        threading.Thread(target=_watch, args=(parent,), name="parent watch", daemon=True).start()
    if os.getppid() != parent:
        os._exit(1)


def _kernel_ends_it() -> bool:
    """Not every system can."""
    return sys.platform == "linux" and not ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os._exit(1)
