"""Every error that amulor raises on purpose, except `ValueError` for formulas."""


class AmulorError(Exception):
    """Base of all errors that a user can mend; its text is one line."""


class SurveyError(AmulorError):
    """A survey file or a description in it cannot be used."""


class CubeError(AmulorError):
    """A measurement cube lacks something, or has something it must not have."""


class FormatError(AmulorError):
    """A file cannot be read or written in the format asked for."""


class InstrumentError(AmulorError):
    """An instrument did not answer, or not as it must."""


class MissingExtraError(AmulorError, ImportError):
    """An optional dependency is not installed."""

    def __init__(self, package: str, *, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs {package}, not installed so far; install with: "
            f"pip install 'amulor[{extra}]'"
        )
