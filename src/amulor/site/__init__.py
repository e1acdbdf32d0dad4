"""Sites: registration of scans, merged clouds, change between visits."""

from amulor.site.description import Site

__all__ = ["Site"]


def __dir__() -> list[str]:
    """List the public names, not the modules that they come from."""
    return sorted(__all__)
