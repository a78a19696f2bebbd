"""The one error that a user's input can raise."""


class InputError(ValueError):
    """Bad input: says what came, what was expected and what to do.

    The command line prints the message and exits with status 2.
    """
