"""The one exception a user meets for bad input."""


class InputError(ValueError):
    """An argument, file or setting that cannot be used.

    The message is one sentence that names the argument, file, line or column and the remedy;
    the command line prints it alone and exits with status 2.
    """
