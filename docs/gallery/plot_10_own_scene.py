"""
Your own scene
==============

A Mitsuba scene with a steady film, here a lamp, a floor and three balls, gets a time axis from
``window`` and ``bins``.
"""

import mitsuba as mi

import tofrender

look = mi.ScalarTransform4f().look_at([0, 1.6, 5], [0, 0.5, 0], [0, 1, 0])
lay = mi.ScalarTransform4f().scale(5).rotate([1, 0, 0], -90)
scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 5},
    "sensor": {
        "type": "perspective",
        "fov": 40,
        "to_world": look,
        "film": {"type": "hdrfilm", "width": 160, "height": 96},
    },
    "lamp": {"type": "point", "position": [-1, 3, 2], "intensity": {"type": "rgb", "value": 20}},
    "floor": {"type": "rectangle", "to_world": lay},
}
for number, color in enumerate(([0.8, 0.2, 0.1], [0.9, 0.9, 0.9], [0.1, 0.3, 0.8])):
    scene[f"ball_{number}"] = {
        "type": "sphere",
        "center": [1.2 * (number - 1), 0.5, 0],
        "radius": 0.5,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}},
    }

dataset = tofrender.render(scene, spp=64, window="auto", bins=100)
figure = tofrender.light_in_flight(dataset, style="rainbow", period_ns=2.0)
