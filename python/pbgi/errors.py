"""Why a call ends without its result. Every class has the exit code of the tools for the same reason."""


class Error(Exception):
    """A run failed for a reason of its own; the base of all others."""

    exit_code = 1


class UsageError(Error, ValueError):
    """The call cannot be carried out as given."""

    exit_code = 2


class InputError(Error):
    """An input cannot be read, is damaged, or nothing can be made of it."""

    exit_code = 3


class BudgetError(Error):
    """Disk or memory limit do not suffice."""

    exit_code = 4


class Interrupted(Error):
    """A progress callback returned False. (Ctrl-C raises KeyboardInterrupt.)"""

    exit_code = 130
