"""All strategies by their densities: every factor of every product is written down.

A path is x_0, on the light, to x_(k-1), the lens. Its points have the densities L_i by area if they
are found from the light, and C_i if they are found from the camera.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex, camera_path


def cosine(si, d):
    """Cosine between a surface and a direction."""
    return dr.abs(dr.dot(si.n, d))


def density_back(si, d, active):
    """Density of the direction that this path has come from, for one that comes from d."""
    seen = mi.SurfaceInteraction3f(si)
    seen.wi = si.to_local(d)
    return si.bsdf().pdf(mi.BSDFContext(), seen, si.wi, active)


def light_path(scene, sampler, emitted, count):
    """Surface vertices of a light path, by steps that use only the previous step."""
    ray = mi.Ray3f(emitted.ray)
    before = emitted.origin
    opl = mi.Float(0)
    η = mi.Float(1)
    β = mi.Color3f(emitted.weight)
    chosen = (emitted.density, mi.Float(0), mi.Bool(False))
    active = mi.Bool(emitted.active)
    path = []
    while True:
        si = scene.ray_intersect(ray, active)
        active = active & si.is_valid() & (dr.max(β) > 0)
        opl = opl + η * dr.norm(si.p - before)
        smooth = active & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        path.append(Vertex(si, β, opl, η, *chosen, smooth, active))
        dr.eval(path[-1])
        if len(path) == count:
            return path
        bs, weight = si.bsdf().sample(
            mi.BSDFContext(mi.TransportMode.Importance),
            *(si, sampler.next_1d(), sampler.next_2d(), active),
        )
        d = si.to_world(bs.wo)
        mirrored = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        chosen = bs.pdf, density_back(si, d, active & ~mirrored), mirrored
        β = β * weight
        η = η * bs.eta
        before = si.p
        ray = si.spawn_ray(d)


def unoccluded(scene, si, point, active):
    """Lanes in which nothing is between a surface point and another point."""
    return active & ~scene.ray_test(si.spawn_ray_to(point), active)


def over(a, b):
    """Quotient; 0 for a denominator of 0."""
    return dr.select(b > 0, a / b, 0)


class TransientBDPT(BothEnds):
    """Bidirectional path tracing in time, without the strategy (1, 1)."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        text = str(props.get("strategy", ""))
        self.only = tuple(int(n) for n in text.split(",")) if text else None
        self.mis = str(props.get("mis", "power"))

    def counts(self, s, t):
        """Whether a strategy has light."""
        return s + t - 1 <= self.max_depth and self.only in (None, (s, t))

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Paths from both ends, and then all pairs of their vertices."""
        emitted = emission.sample(sampler, camera.ray)
        lights = light_path(scene, sampler, emitted, self.max_depth - 1)
        density = lens.density(camera.ray.d)
        eyes = camera_path(scene, sampler, camera, density, self.max_depth)
        way = Ways(scene, sampler, camera, lens, emission, emitted, lights, eyes)
        for t in range(1, self.max_depth + 2):
            for s in range(self.max_depth + 1):
                if s + t < 2 or not self.counts(s, t) or (s, t) == (1, 1):
                    continue
                light, opl, position, active, ratios = way.connect(s, t)
                exponent = {"power": 2, "balance": 1, "none": 0}[self.mis]
                if exponent:
                    light = light / (1 + sum((r**exponent for r in ratios), mi.Float(0)))
                land(light, opl, position, active)
                dr.eval()


class Ways:
    """A path from the light and one from the camera, and what connects them."""

    def __init__(self, scene, sampler, camera, lens, emission, emitted, lights, eyes):
        self.scene = scene
        self.sampler = sampler
        self.camera = camera
        self.lens = lens
        self.emission = emission
        self.emitted = emitted
        self.lights = lights
        self.eyes = eyes
        self.radiance = mi.BSDFContext()
        self.importance = mi.BSDFContext(mi.TransportMode.Importance)

    def connect(self, s, t):
        """Light, length, position and lanes of a strategy, and its rivals' densities over its."""
        if s == 0:
            return self.run_into(t)
        if s == 1:
            return self.next_event(t)
        return self.to_lens(s) if t == 1 else self.to_each_other(s, t)

    # ------------------------------------------------------------------------- strategies

    def run_into(self, t):
        """(0, t): the last vertex is on a light."""
        last = self.eyes[t - 2]
        emitter = last.si.emitter(self.scene)
        active = last.active & (emitter != None)  # noqa: E711 (a mask)
        light = last.β * emitter.eval(last.si, active)
        if t == 2:
            return light, last.opl, self.camera.position, active, []
        before = self.eyes[t - 3]
        ds = mi.DirectionSample3f(self.scene, last.si, before.si)
        pdf = self.scene.pdf_emitter_direction(before.si, ds, active)
        chosen = dr.select(last.mirrored, 1, last.pdf)
        ratio = self.emission.ratio(ds.emitter, ds, pdf, ds.dist)
        ratios = self.rivals(0, t, last.si.p, ratio, over(chosen, pdf))
        return light, last.opl, self.camera.position, active, ratios

    def next_event(self, t):
        """(1, t): a point on a light is chosen."""
        last = self.eyes[t - 2]
        si = last.si
        active = last.smooth
        ds, weight = self.scene.sample_emitter_direction(si, self.sampler.next_2d(), True, active)
        active = active & (ds.pdf > 0)
        f, pdf = si.bsdf().eval_pdf(self.radiance, si, si.to_local(ds.d), active)
        ratio = self.emission.ratio(ds.emitter, ds, ds.pdf, ds.dist)
        hit = dr.select(ds.delta, 0, over(pdf, ds.pdf))
        back = density_back(si, ds.d, active)
        light = last.β * f * weight
        opl = last.opl + last.η * ds.dist
        ratios = self.rivals(1, t, ds.p, ratio, hit, back_b=back)
        return light, opl, self.camera.position, active, ratios

    def to_lens(self, s):
        """(s, 1): the last vertex of light is connected to the lens."""
        last = self.lights[s - 2]
        si = last.si
        arrival = self.lens.arrive(si.p, self.lens.sample(self.sampler))
        active = unoccluded(self.scene, si, arrival.near, last.smooth & arrival.seen)
        f = si.bsdf().eval(self.importance, si, si.to_local(arrival.direction), active)
        light = last.β * f * (arrival.density / dr.square(arrival.distance))
        opl = last.opl + last.η * arrival.distance
        back = density_back(si, arrival.direction, active)
        ratio, hit = self.light_end(back if s == 2 else None)
        origin = self.emitted.origin
        ratios = self.rivals(s, 1, origin, ratio, hit, arrival, back)
        return light, opl, arrival.position, active, ratios

    def to_each_other(self, s, t):
        """(s, t): two surface points."""
        a = self.lights[s - 2]
        b = self.eyes[t - 2]
        way = b.si.p - a.si.p
        distance = dr.norm(way)
        d = way / distance
        active = unoccluded(self.scene, a.si, b.si.p, a.smooth & b.smooth & (distance > 0))
        wo_a = a.si.to_local(d)
        wo_b = b.si.to_local(-d)
        f_a = a.si.bsdf().eval(self.importance, a.si, wo_a, active)
        f_b = b.si.bsdf().eval(self.radiance, b.si, wo_b, active)
        light = a.β * f_a * f_b * b.β / dr.square(distance)
        opl = a.opl + b.opl + a.η * distance
        onwards = a.si.bsdf().pdf(self.radiance, a.si, wo_a, active)
        towards = b.si.bsdf().pdf(self.radiance, b.si, wo_b, active)
        back_a, back_b = density_back(a.si, d, active), density_back(b.si, -d, active)
        ratio, hit = self.light_end(back_a if s == 2 else None)
        ratios = self.rivals(
            *(s, t, self.emitted.origin, ratio, hit),
            *((onwards, towards), back_a, back_b),
        )
        return light, opl, self.camera.position, active, ratios

    # --------------------------------------------------------------------------- densities

    def light_end(self, back):
        """Density ratios at the light end: connection over emission, and hit over connection.

        `back` is the density from the first surface to the light, if no vertex came after it.
        """
        emitted = self.emitted
        first = self.lights[0]
        ds = dr.zeros(mi.DirectionSample3f, dr.width(first.opl))
        ds.p = emitted.origin
        ds.n = emitted.normal
        ds.uv = emitted.uv
        ds.emitter = emitted.emitter
        ds.d = -emitted.ray.d
        ds.dist = first.opl
        pdf = self.scene.pdf_emitter_direction(first.si, ds, first.active & ~emitted.delta)
        ratio = self.emission.ratio(emitted.emitter, ds, pdf, first.opl)
        if back is None:
            back = dr.select(self.lights[1].mirrored, 1, self.lights[1].back)
        return ratio, dr.select(emitted.delta, 0, over(back, pdf))

    def rivals(self, s, t, origin, ratio, hit, between=None, back_a=None, back_b=None):
        """Densities of all other strategies over the density of (s, t).

        `between` is an arrival at the lens, or densities from a to b and from b to a; `back_a` and
        `back_b` are densities from a and from b to the vertices before them.
        """
        k = s + t
        one = mi.Float(1)
        lights = self.lights[: max(s - 1, 0)]
        eyes = self.eyes[: t - 1 if s else t - 2]
        points = [*lights, *reversed(eyes)]  # x_1 to x_(k-2)
        p = [origin, *(v.si.p for v in points)]
        smooth = [v.smooth for v in points]
        # Solid-angle densities: from_light[i] of x_i from x_(i-1), from_eye[i] from x_(i+1)
        from_light = {}
        from_eye = {}
        for i, v in enumerate(lights, 1):
            from_light[i] = dr.select(v.mirrored, one, v.pdf)
            from_eye[i - 2] = dr.select(v.mirrored, one, v.back)
        for j in range(1, t):
            v = self.eyes[j - 1]
            from_eye[k - 1 - j] = dr.select(v.mirrored, one, v.pdf)
            from_light[k + 1 - j] = dr.select(v.mirrored, one, v.back)
        if s >= 2:
            from_eye[s - 2] = back_a
            if t == 1:
                from_eye[s - 1] = between.density
                end = between.lens
            else:
                from_light[s], from_eye[s - 1] = between
        if t >= 2:
            end = self.camera.origin
            if s >= 1:
                from_light[s + 1] = back_b
        p.append(end)

        def density(i, direction):
            """Density by area of x_i, from the light's side (-1) or from the camera's (+1)."""
            way = p[i] - p[i + direction]
            cos = cosine(points[i - 1].si, dr.normalize(way))
            chosen = from_light[i] if direction < 0 else from_eye[i]
            return chosen * cos / dr.squared_norm(way)

        def step(i):
            """p_(i+1) / p_i as a pair of numerator and denominator."""
            if i == 0:
                return one, hit
            if i == 1:
                cos = cosine(points[0].si, dr.normalize(p[1] - p[0]))
                return cos, ratio * density(1, +1)
            return density(i, -1), density(i, +1)

        def possible(i):
            """Whether strategy i can make such a path: it connects no mirrors."""
            if i == 0:
                return mi.Bool(True)
            if i == 1:
                return smooth[0]
            if i == k - 1:
                return smooth[-1]
            return smooth[i - 2] & smooth[i - 1]

        found = []
        up = one
        down = one
        for i in range(s, k - 1):
            above, below = step(i)
            up = over(up * above, below)
            found.append(dr.select(possible(i + 1), up, 0))
        for i in range(s - 1, -1, -1):
            above, below = step(i)
            down = over(down * below, above)
            found.append(dr.select(possible(i), down, 0))
        return found
