"""The question whether an output is up to date, asked of a step that is not to make anything."""

_asked = False


class NotUpToDate(Exception):  # noqa: N818 - an answer, not an error
    """The output of a step is to be made; raised by `roomeq.core.build.Build.done` where only that is asked."""


def only_ask(asked: bool) -> None:
    """Let the steps of this process tell whether their output is up to date, and make nothing; or not."""
    global _asked
    _asked = asked


def only_asked() -> bool:
    """Tell whether that is the only question."""
    return _asked
