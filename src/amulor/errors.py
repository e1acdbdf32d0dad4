"""Exceptions and warnings of amulor; formulas raise `ValueError` instead."""


class AmulorError(Exception):
    """Base class of errors that a user can correct; the message says what to do.

    Examples
    --------
    >>> from amulor.errors import AmulorError, CubeError
    >>> issubclass(CubeError, AmulorError)
    True
    """


class AmulorWarning(UserWarning):
    """Warning of a result outside its formula's validity range; one-line message.

    Examples
    --------
    A program that refuses such results makes them errors:

    >>> import warnings
    >>> from amulor.errors import AmulorWarning
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", AmulorWarning)
    ...     try:
    ...         warnings.warn("the closure does not hold", AmulorWarning)
    ...     except AmulorWarning as warning:
    ...         print(warning)
    the closure does not hold
    """


class SurveyError(AmulorError):
    """A survey file, or a description in it, cannot be used.

    Examples
    --------
    >>> from amulor import Survey
    >>> from amulor.errors import SurveyError
    >>> try:
    ...     Survey.from_text("[water]")
    ... except SurveyError as error:
    ...     print(str(error)[:24])
    survey: name: is missing
    """


class CubeError(AmulorError):
    """A measurement cube lacks required content, or has content that is not allowed.

    Examples
    --------
    >>> from amulor import imaging, samples
    >>> from amulor.errors import CubeError
    >>> try:
    ...     imaging.range_image(samples.cube("ladder"))
    ... except CubeError as error:
    ...     print(str(error)[:64])
    the cube: is of level samples, but level target_signal is needed
    """


class FormatError(AmulorError):
    """A file is missing, or cannot be read or written in its format.

    Examples
    --------
    >>> from amulor import read_cube
    >>> from amulor.errors import FormatError
    >>> try:
    ...     read_cube("nowhere.nc")
    ... except FormatError as error:
    ...     print(error)
    nowhere.nc does not exist; check the name and the folder
    """


class InstrumentError(AmulorError):
    """An instrument did not answer, or gave an unexpected answer.

    Examples
    --------
    >>> from amulor.errors import InstrumentError
    >>> try:
    ...     raise InstrumentError("lock-in: no answer within 2 s; check its cable")
    ... except InstrumentError as error:
    ...     print(error)
    lock-in: no answer within 2 s; check its cable
    """


class MissingExtraError(AmulorError, ImportError):
    """An optional dependency is not installed.

    Examples
    --------
    >>> from amulor.errors import MissingExtraError
    >>> error = MissingExtraError("trimesh", extra="scene", purpose="a mesh")
    >>> str(error)[-27:]
    "pip install 'amulor[scene]'"
    """

    def __init__(self, package: str, *, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs {package}, not installed so far; install with: "
            f"pip install 'amulor[{extra}]'"
        )
