"""The one exception that a user may see."""


class InputError(ValueError):
    """Bad input: the message says what was expected, what was found, where, and what to do.

    Commands and nodes print the message alone, without a traceback.
    """
