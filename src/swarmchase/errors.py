"""The one error a user is meant to read: what was given, what is allowed, what to do."""


class InputError(ValueError):
    """Bad input from outside. The command line prints it in one line and exits with code 2."""
