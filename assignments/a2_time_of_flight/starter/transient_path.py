"""Problem a2.transient_path: path tracing into the time bins of a film."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from film_integrator import FilmIntegrator
from gaussian_pulse import GaussianPulse


class TransientPath(FilmIntegrator):
    """Path tracer into a film with time bins. Start from `PathTracer` in `path_tracer.py`.

    `render` is given (`film_integrator.py`): it makes camera rays, calls `sample`, and develops the
    film. Parameters in addition to those of `FilmIntegrator`:

    | parameter | default | meaning |
    |---|---|---|
    | `pulse_width_opl` | none | standard deviation of the light's Gaussian pulse [m] |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if "pulse_width_opl" in props:
            self.pulse = GaussianPulse(props["pulse_width_opl"])

    def sample(self, scene, sampler, ray, deposit, origin, active=True):
        """Trace paths, and pass every contribution to `deposit`.

        Args:
            scene: The scene.
            sampler: Random numbers.
            ray: Camera rays.
            deposit: Call `deposit(spectrum, opl, active)` for each connection and each emitter
                that a ray hits: the radiance that this path carries to the sensor, its length [m],
                and the lanes that have such a contribution. It may be called in a loop.
            origin: Points of the sensor where lengths start.
            active: Lanes to trace.

        Returns:
            Radiance summed over all lengths, including lengths outside the film's bins; and the
            mask of the rays that hit a surface.
        """
        raise NotImplementedError("a2.transient_path: TransientPath.sample")

    def spread(self, film, put, sampler, spectrum, opl, active):
        """Add a contribution to the film, spread over time by `self.pulse`.

        Light of the length `opl` arrives as a pulse around `opl`. The bin from a to b gets the part
        of the energy that lies between the offsets a - opl and b - opl. Either compute this part
        for every bin that the pulse reaches, or draw an offset from the pulse, which is right on
        average but noisier. (Energy before `film.start_opl` and beyond the last bin is lost.)

        Args:
            film: The film: `start_opl` [m], `bin_width_opl` [m], `temporal_bins`.
            put: Call `put(spectrum, opl, active)` to add to the bin that contains the length;
                lengths outside of the film's window are ignored.
            sampler: Random numbers, if you need any.
            spectrum: Radiance of the contribution.
            opl: Length of the contribution's path [m].
            active: Lanes that have a contribution.
        """
        raise NotImplementedError("a2.transient_path: TransientPath.spread")


mi.register_integrator("transient_path", TransientPath)
