"""The errors a user is meant to read."""


class InputError(ValueError):
    """Bad input from outside: what was given, what is allowed. The command line prints it in one line, exit code 2."""


def reason_of(error: Exception) -> str:
    """Why the system refused, in words: without the number that ``str`` of its errors begins with."""
    return str(getattr(error, "strerror", None) or error)


class WorkerDiedError(RuntimeError):
    """A process of a training or an evaluation ended unexpectedly; the message holds its traceback or its exit code.

    The command line prints it and exits with code 1.
    """
