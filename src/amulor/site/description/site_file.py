"""The site file: reads TOML, and says what is wrong in one line each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from amulor.errors import SurveyError
from amulor.site.description.parts import (
    Comparison,
    Control,
    Epoch,
    Registration,
    ScaleBar,
    SiteFrame,
    SiteScan,
    SiteTarget,
)
from amulor.survey import toml_file
from amulor.survey.quantity import Description


class Site(Description):
    """Scans of one place, and all that ties them to each other and to the world."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """What the site is; the title of all that comes of it."""
    frame: SiteFrame = SiteFrame()
    """Axes that all scans come into."""
    epoch: Annotated[tuple[Epoch, ...], Field(min_length=1)]
    """Visits, in the order of time."""
    scan: Annotated[tuple[SiteScan, ...], Field(min_length=1)]
    """Scans."""
    target: tuple[SiteTarget, ...] = ()
    """Targets that were set up, or points that are recognized."""
    control: tuple[Control, ...] = ()
    """Targets with known places."""
    registration: Registration = Registration()
    """How scans are put together."""
    comparison: Comparison = Comparison()
    """How epochs are compared."""

    @model_validator(mode="after")
    def _names_hold(self) -> Self:
        found = list(_slips(self))
        if found:
            raise ValueError("; ".join(found))
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a site file.

        Parameters
        ----------
        path : str or pathlib.Path
            TOML file; the files that it names are looked for beside it.

        Returns
        -------
        Site
            In SI units, with whole paths of files.

        Raises
        ------
        SurveyError
            With one line for each thing that is wrong: file, field, what was found,
            what is allowed.
        """
        path = Path(path)
        text = toml_file.text_of(path, error=SurveyError)
        return cls.from_text(text, name=str(path), folder=path.parent)

    @classmethod
    def from_text(
        cls, text: str, *, name: str = "site", folder: Path | None = None
    ) -> Self:
        """Read a site from the text of its file.

        Parameters
        ----------
        text : str
            TOML.
        name : str
            What messages call it.
        folder : pathlib.Path, optional
            Where the files that it names are looked for; the working folder by
            default.

        Returns
        -------
        Site
            In SI units, with whole paths of files.

        Raises
        ------
        SurveyError
            As `from_toml`.
        """
        site = toml_file.described(
            text, cls, name=name, what="a site", error=SurveyError
        )
        return site._settled(folder or Path(), where=name)

    def scans_of(self, epoch: str) -> tuple[SiteScan, ...]:
        """Return the scans of one visit, in the order of the file.

        Parameters
        ----------
        epoch : str
            Name of the visit.

        Returns
        -------
        tuple of SiteScan
            None for a name that no scan has.
        """
        return tuple(one for one in self.scan if one.epoch == epoch)

    def _settled(self, folder: Path, *, where: str) -> Self:
        """Return the same with whole paths, or say which files are not there."""
        lacking = []
        scans = []
        for number, one in enumerate(self.scan):
            paths: dict[str, Any] = {}
            for field in ("file", "water", "simulated_from"):
                stated = getattr(one, field)
                if stated is None:
                    continue
                paths[field] = (folder / stated).resolve()
                made_later = field == "file" and one.simulated_from is not None
                if not paths[field].is_file() and not made_later:
                    lacking.append(
                        f"{where}: scan.{number}.{field}: found {str(stated)!r}, but "
                        f"there is no such file in {folder.resolve()}"
                    )
            scans.append(one.model_copy(update=paths))
        if lacking:
            raise SurveyError("\n".join(lacking))
        return self.model_copy(update={"scan": tuple(scans)})


def _slips(site: Site) -> Iterator[str]:
    """Yield what names of a site file contradict each other."""
    scans = [one.name for one in site.scan]
    targets = [one.name for one in site.target]
    epochs = [one.name for one in site.epoch]
    for what, names in (("scan", scans), ("target", targets), ("epoch", epochs)):
        for name, count in Counter(names).items():
            if count > 1:
                yield f"{count} {what}s are called {name!r}; give each its own name"
    for one in site.scan:
        if one.epoch not in epochs:
            yield f"scan {one.name!r}: epoch {_unknown(one.epoch, epochs, 'epoch')}"
    seen = [one.name for one in site.target if not isinstance(one, ScaleBar)]
    for target in site.target:
        if isinstance(target, ScaleBar):
            for end in target.ends:
                if end not in seen:
                    yield f"target {target.name!r}: end {_unknown(end, seen, 'target')}"
            continue
        places = Counter(place.scan for place in target.places)
        for name, count in places.items():
            if name not in scans:
                yield f"target {target.name!r}: scan {_unknown(name, scans, 'scan')}"
            if count > 1:
                yield (
                    f"target {target.name!r}: scan {name!r} has {count} places; one "
                    "target is in one place of a scan"
                )
    for name, count in Counter(one.target for one in site.control).items():
        if name not in seen:
            yield f"control: target {_unknown(name, seen, 'target')}"
        if count > 1:
            yield f"control: target {name!r} has {count} positions; state one"
    for control in site.control:
        of = next((one for one in site.target if one.name == control.target), None)
        if of is not None and not isinstance(of, ScaleBar) and of.moved:
            yield (
                f"control: target {control.target!r} is set up anew at each epoch "
                "(moved = true), so that it has no one position"
            )


def _unknown(name: str, allowed: Sequence[str], what: str) -> str:
    listed = ", ".join(repr(one) for one in allowed) or "none"
    return f"{name!r} is no {what} of this file; there are {listed}"


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of site files, for editors that check while typing.

    Returns
    -------
    dict
        JSON Schema, draft 2020-12.
    """
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Site.model_json_schema(),
        "title": "amulor site",
    }
