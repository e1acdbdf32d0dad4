"""Sites: registration of scans, merged clouds, change between visits."""

from amulor.site.description import Site

__all__ = ["Site"]


def __dir__() -> list[str]:
    """Return the public names of the package only."""
    return sorted(__all__)
