"""Problem a2.transient_path: path tracing into the time bins of a film."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from film_integrator import FilmIntegrator
from gaussian_pulse import GaussianPulse


class TransientPath(FilmIntegrator):
    """Path tracer whose film says when light arrives. Start from `PathTracer` in `path_tracer.py`.

    `render` is given (`film_integrator.py`): it makes camera rays, calls `sample`, and develops the
    film. Besides the parameters of `FilmIntegrator`:

    | parameter | default | meaning |
    |---|---|---|
    | `pulse_width_opl` | none | standard deviation of the light's Gaussian pulse [m] |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if "pulse_width_opl" in props:
            self.pulse = GaussianPulse(props["pulse_width_opl"])

    def sample(self, scene, sampler, ray, deposit, origin, active=True):
        """Follow paths, and hand every contribution to `deposit`.

        Args:
            scene: The scene.
            sampler: Random numbers.
            ray: Camera rays.
            deposit: Call `deposit(spectrum, opl, active)` for each connection and each emitter
                that a ray runs into: the radiance that this path carries to the sensor, its length
                [m], and the lanes that have such a contribution. It may be called in a loop.
            origin: Points of the sensor where lengths start.
            active: Lanes to trace.

        Returns:
            Radiance summed over all lengths, also of those that the film has no bin for; and the
            lanes whose ray met a surface.
        """
        raise NotImplementedError("a2.transient_path: TransientPath.sample")

    def spread(self, film, put, sampler, spectrum, opl, active):
        """Put a contribution into the film, spread over time as `self.pulse` says.

        Light of the length `opl` arrives as a pulse around it: the bin from a to b gets the part
        of the energy that lies between the offsets a - opl and b - opl. Either that part is
        computed for every bin that the pulse reaches, or an offset is drawn from the pulse, which
        is right on average and noisier. (Energy before `film.start_opl` and beyond the last bin is
        lost.)

        Args:
            film: The film: `start_opl` [m], `bin_width_opl` [m], `temporal_bins`.
            put: Call `put(spectrum, opl, active)` to add to the bin that the length falls into;
                outside of the film's window nothing happens.
            sampler: Random numbers, if you need any.
            spectrum: Radiance of the contribution.
            opl: Its length [m].
            active: Lanes that have a contribution.
        """
        raise NotImplementedError("a2.transient_path: TransientPath.spread")


mi.register_integrator("transient_path", TransientPath)
