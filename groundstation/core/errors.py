"""The one exception that a user is meant to read.

Everything else that is raised is a programming error and may show a traceback.
"""

from __future__ import annotations


class UserError(Exception):
    """A wrong file, value or request, told in one sentence: subject, value, limit and remedy.

    The command line prints the message alone and exits with ``exit_code``.

    Attributes:
        exit_code: of the process.
        answered: the command has printed its JSON object already.
    """

    exit_code = 2
    answered = False


class CheckFailed(UserError):  # noqa: N818 - an outcome that is reported, not an error in the program
    """A check could not be made, so that it counts as failed; there is no result to print."""

    exit_code = 1


class MissionFailed(UserError):  # noqa: N818 - an outcome that is reported, not an error in the program
    """The mission or the check failed; vehicles were left safe. Raised after the result was printed."""

    exit_code = 1
    answered = True


class PreflightRefused(UserError):  # noqa: N818 - an outcome that is reported, not an error in the program
    """Preflight refused; nothing was armed. Raised after the result was printed."""

    exit_code = 3
    answered = True
