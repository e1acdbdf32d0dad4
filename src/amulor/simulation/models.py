"""Forward models of target and water light for simulations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import (
    small_angle,
    small_angle_closure,
    small_angle_diffusion,
    target_echo,
)
from amulor.optics.small_angle import gaussian_receiver, sharp_receiver
from amulor.optics.small_angle.gaussian_receiver import SharedLight
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import (
    View,
    has_sharp_receiver,
    kernel_arguments,
    refuse_beam_and_edges,
    refuse_layers,
)
from amulor.survey.waters.whole_function import whole_function_arguments

Complex = NDArray[np.complex128]
Error = NDArray[np.float64]


class SignalModel(Protocol):
    """Interface of forward models: optical responses before any polarizer.

    Examples
    --------
    Any object with these four will do, such as one that dims an other:

    >>> from dataclasses import dataclass
    >>> from amulor.simulation import SignalModel, SmallAngleModel
    >>> @dataclass(frozen=True)
    ... class Dimmed:
    ...     inner: SignalModel = SmallAngleModel()
    ...     title: str = "half of the echo"
    ...     late_echo: str = "absent"
    ...
    ...     def echo(self, modulation_frequency, **others):
    ...         return 0.5 * self.inner.echo(modulation_frequency, **others)
    ...
    ...     def column(self, modulation_frequency, **others):
    ...         return self.inner.column(modulation_frequency, **others)
    >>> model: SignalModel = Dimmed()
    >>> print(model.title)
    half of the echo
    """

    @property
    def title(self) -> str:
        """Name of the model for cube attributes."""
        ...

    @property
    def late_echo(self) -> str:
        """Late arrival of scattered light in the model: "present" or "absent"."""
        ...

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return the ratio of target echo power to launched power [1].

        Parameters
        ----------
        modulation_frequency : ndarray
            Frequencies, with axes for the shape of the view [Hz].
        survey : Survey
            Instrument and water.
        water : WaterProperties
            Optical properties of the water.
        view : View
            Geometry of the receiver relative to each beam.
        surface : dict
            `depth`, `optical_path`, `return_path`, `reflectance`, `cosine` of
            `amulor.optics.target_echo.target_response`, over the beams.

        Returns
        -------
        ndarray of complex
            Over frequencies and beams.
        """
        ...

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return backscatter power of water in front of `end`, over launched power [1].

        Parameters
        ----------
        modulation_frequency : ndarray
            Frequencies, with axes for the shape of the view [Hz].
        survey : Survey
            Instrument and water.
        water : WaterProperties
            Optical properties of the water.
        view : View
            Geometry of the receiver relative to each beam.
        end : array_like
            Depth at which the column ends, over the beams or one for all [m].

        Returns
        -------
        ndarray of complex
            Ratio over frequencies and beams, with phases from the start of the water.
        """
        ...


@runtime_checkable
class FittedModel(Protocol):
    """Interface of forward models with scan-wide precomputation, such as a table.

    It is a `SignalModel`, too. A model that wraps another must call its `fit`; else
    a scan by rows differs from the whole scan by the error of such a table.
    """

    def fit(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
        farthest: float,
    ) -> SignalModel:
        """Return the model fitted to all water columns of a scan.

        Parameters
        ----------
        modulation_frequency, survey, water, view, end
            As in `SignalModel.column`, of all beams of the scan or of a sample.
        farthest : float
            Depth up to which any column of the scan reaches, perhaps infinite [m].

        Returns
        -------
        SignalModel
            For any rows of the scan.
        """
        ...


@runtime_checkable
class UncertainModel(Protocol):
    """Interface of forward models with standard errors."""

    def echo_with_error(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> tuple[Complex, Error]:
        """Return `echo` with its standard error, real and imaginary part combined."""
        ...

    def column_with_error(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> tuple[Complex, Error]:
        """Return `column` with its standard error, real and imaginary part combined."""
        ...


@dataclass(frozen=True)
class DiffusionModel:
    """Diffusion model, eqs. (43) and (46) of Ricci et al. 2010.

    It uses the coefficients b_f and b_d and the second moment of the water. All light
    is spread alike, including light that was never scattered. With a split angle of 90
    degrees its cut-off is some 1.5 times that of photon transport, and a distant echo a
    quarter as strong.

    Examples
    --------
    >>> from amulor.simulation import DiffusionModel
    >>> print(DiffusionModel().title)
    small-angle diffusion model, the paper's form
    """

    title: str = "small-angle diffusion model, the paper's form"
    """Name of the model for cube attributes."""
    late_echo: str = "absent"
    """Late light is "absent", as all light is assumed to take the straight path."""

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return target echo power over launched power; see `SignalModel`."""
        _refuse_for_diffusion(survey, water)
        return target_echo.target_response(
            modulation_frequency, **surface, **kernel_arguments(survey, water, view)
        )

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return water backscatter power over launched power; see `SignalModel`."""
        _refuse_for_diffusion(survey, water)
        return small_angle_diffusion.water_response(
            modulation_frequency,
            backscatter_vsf=water.backscatter_vsf,
            group_index=water.group_index,
            end=end,
            **kernel_arguments(survey, water, view),
        )


@dataclass(frozen=True)
class SmallAngleModel:
    """Small-angle model, eq. (29) of Ricci et al. 2010; the default model.

    It uses the whole phase function of the water, and treats unscattered light
    separately. It agrees with photon transport within some percent, and takes half a
    millisecond for each pixel.

    Examples
    --------
    >>> from amulor.simulation import SmallAngleModel
    >>> print(SmallAngleModel().title)
    small-angle model with the whole phase function
    """

    title: str = "small-angle model with the whole phase function"
    """Name of the model for cube attributes."""
    late_echo: str = "absent"
    """Late light is "absent", as all light is assumed to take the straight path."""
    shared_light: SharedLight | None = None
    """Table of scattered light for all columns of a scan, created by `fit`; by default
    each call creates its own."""

    def fit(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
        farthest: float,
    ) -> SmallAngleModel:
        """Return the model with a table of scattered light, for Gaussian receivers."""
        if has_sharp_receiver(survey):
            return self
        shared_light = gaussian_receiver.fit(
            modulation_frequency,
            farthest=farthest,
            backscatter_vsf=water.backscatter_vsf,
            group_index=water.group_index,
            end=end,
            **whole_function_arguments(survey, water, view),
        )
        return replace(self, shared_light=shared_light)

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return target echo power over launched power; see `SignalModel`."""
        echo = (
            target_echo.sharp_receiver_target_response
            if has_sharp_receiver(survey)
            else target_echo.small_angle_target_response
        )
        return echo(
            modulation_frequency,
            **surface,
            **whole_function_arguments(survey, water, view),
        )

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return water backscatter power over launched power; see `SignalModel`."""
        column = (
            sharp_receiver.water_response
            if has_sharp_receiver(survey)
            else partial(small_angle.water_response, shared_light=self.shared_light)
        )
        return column(
            modulation_frequency,
            backscatter_vsf=water.backscatter_vsf,
            group_index=water.group_index,
            end=end,
            **whole_function_arguments(survey, water, view),
        )


@dataclass(frozen=True)
class ClosureModel:
    """Closure model, a fast approximation of the small-angle model.

    It uses the whole phase function, as `SmallAngleModel` does, and approximates the
    light at each depth by one Gaussian. Where it is valid, the cut-off is at most 30 %
    higher than that of eq. (29), and the echo at most 30 % lower. Elsewhere, as for
    receivers with a small acceptance angle far from the beam, an `AmulorWarning`
    recommends `SmallAngleModel`.

    Examples
    --------
    >>> from amulor.simulation import ClosureModel
    >>> print(ClosureModel().title, "-", ClosureModel().late_echo)
    closure of the small-angle model - absent
    """

    title: str = "closure of the small-angle model"
    """Name of the model for cube attributes."""
    late_echo: str = "absent"
    """Late light is "absent", as all light is assumed to take the straight path."""

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return target echo power over launched power; see `SignalModel`."""
        return target_echo.closure_target_response(
            modulation_frequency,
            **surface,
            **_closure_arguments(survey, water, view),
        )

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return water backscatter power over launched power; see `SignalModel`."""
        return small_angle_closure.water_response(
            modulation_frequency,
            backscatter_vsf=water.backscatter_vsf,
            group_index=water.group_index,
            end=end,
            **_closure_arguments(survey, water, view),
        )


#: Forward model of simulations by default.
DEFAULT_MODEL: SignalModel = SmallAngleModel()


def _closure_arguments(
    survey: Survey, water: WaterProperties, view: View
) -> dict[str, Any]:
    if has_sharp_receiver(survey):
        raise SurveyError(
            'receiver.edge = "sharp" is stated, which the closure does not know: leave '
            "it out, or choose the small-angle model"
        )
    return whole_function_arguments(survey, water, view)


def _refuse_for_diffusion(survey: Survey, water: WaterProperties) -> None:
    refuse_layers(water, model="the diffusion form")
    refuse_beam_and_edges(survey, model="the diffusion form")
