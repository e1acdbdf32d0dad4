"""Options that several commands share."""

from __future__ import annotations

from cyclopts import validators

#: Seeds that a generator takes and a file keeps.
SEED = validators.Number(gte=0, lt=2**63)


def interval_of(
    nearest: str | None, farthest: str | None
) -> tuple[float, float] | None:
    """Return the limits of the slant range that two options state.

    Parameters
    ----------
    nearest, farthest : str, optional
        Lengths with a unit; both or none.

    Returns
    -------
    tuple of float, or None
        Nearest and farthest slant range [m].

    Raises
    ------
    CubeError
        If only one is given, or one is no length.
    """
    from amulor import units
    from amulor.errors import CubeError

    if (nearest is None) != (farthest is None):
        raise CubeError("--nearest and --farthest must be given together")
    if nearest is None or farthest is None:
        return None
    try:
        return units.parse(nearest, "length"), units.parse(farthest, "length")
    except ValueError as error:
        raise CubeError(f"--nearest, --farthest: {error}") from None
