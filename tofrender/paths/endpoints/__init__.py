"""What a path can connect to: the light strategies of `walk`.

A strategy offers

    connects                               whether next-event estimation happens at all
    finds_all                              whether it finds all light on its own, mirrors apart
    connect(si, path, sampler, active)     -> Connection from a surface point
    hit(si, previous, ray, active)         -> (radiance, solid-angle density of `connect`, length)
    remember(memory, si, active)           -> a mask that goes from vertex to vertex, in `path`
    nearest(p)                             -> length that no connection from p falls below

where `path` is the `PathState` at `si`.

| strategy | connects to |
|---|---|
| `SceneLights` | the scene's emitters; paths that run into one share its light with connections |
| `EmitterHits` | nothing: paths see light only where they run into it |
| `ConnectionsOnly` | the scene's emitters, which only mirrors and glass see otherwise |
| `OneSampleLights` | an emitter or, as often, what the material's sampling finds |
| `GatedLights` | points on emitters whose light comes when a gate is open |
| `PointSource`, `OpenSky` | a light that is not part of the scene |
| `LaserSpot` | the point of a wall that a laser lights |

Lengths end at the point that emits. An environment or directional light has none; its light starts
on the plane that touches the sphere around scene and sensor and faces the light, so that each
direction's wavefront is plane, all of it starts at OPL 0, and no length is negative.
"""

from __future__ import annotations

from .gated import GatedLights
from .one_sample import OneSampleLights
from .outside import OpenSky, PointSource
from .scene_lights import Connection, ConnectionsOnly, EmitterHits, PathState, SceneLights

__all__ = [
    "Connection",
    "ConnectionsOnly",
    "EmitterHits",
    "GatedLights",
    "OneSampleLights",
    "OpenSky",
    "PathState",
    "PointSource",
    "SceneLights",
]
