"""Probes: functions that the tests call with a submission, in the submission's process."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

# ------------------------------------------------------------------------------------ warps


def warp(theirs, name, points, parameters=()):
    """Warped points, shape (n, 2 or 3), from points of shape (n, 2); arrays are Dr.Jit floats."""
    p = _of_drjit(name, getattr(theirs, name)(_point2(points), *_floats(parameters)))
    return _rows(p, len(points))


def warp_pdf(theirs, name, points, parameters=()):
    """A warp's density at points of shape (n, 2 or 3)."""
    points = np.asarray(points)
    p = _point2(points) if points.shape[1] == 2 else _vector3(points)
    return _lanes(_of_drjit(name, getattr(theirs, name)(p, *_floats(parameters))), len(points))


def _of_drjit(name, values):
    """Refuse what no kernel can hold."""
    if isinstance(values, np.ndarray | np.generic):
        raise TypeError(f"{name} gave a NumPy {type(values).__name__}, must be one of Dr.Jit")
    return values


def triangle(theirs, corners, points):
    """Points on a triangle, shape (n, 3)."""
    return _rows(theirs.sample_triangle(*_lists(corners), _point2(points)), len(points))


def triangle_pdf(theirs, corners, p):
    """Density of the triangle's points."""
    density = theirs.sample_triangle_pdf(mi.Point3f(_vector3(p)), *_lists(corners))
    return _lanes(density, len(p))


def hierarchical(theirs, image, points):
    """Points that are distributed like an image."""
    return _rows(theirs.HierarchicalWarp(np.asarray(image)).sample(_point2(points)), len(points))


def hierarchical_pdf(theirs, image, p):
    """Density of these points."""
    return _lanes(theirs.HierarchicalWarp(np.asarray(image)).pdf(_point2(p)), len(p))


# ----------------------------------------------------------------------------------- lights


def light_sample(theirs, light, o, points):
    """All fields of the records of sampled directions, from points `o` of shape (n, 3)."""
    record = _light(theirs, light).sample(mi.Point3f(_vector3(o)), _point2(points))
    return _fields(record, len(points))


def light_record(theirs, light, o, v):
    """All fields of the records of given directions of shape (n, 3)."""
    shape = _light(theirs, light)
    o, v, count = mi.Point3f(_vector3(o)), _vector3(v), max(len(o), len(v))
    fields = _fields(shape.record(o, v), count)
    return fields | {"pdf_method": _lanes(shape.pdf(o, v), count)}


def emissive(theirs, lights):
    """Whether each light emits anything."""
    return np.array([_light(theirs, light).is_emissive for light in lights])


def _light(theirs, light):
    """A light from ["Sphere", arguments, keywords] or ["SurfaceGroup", [lights], {}]."""
    name, arguments, keywords = light
    if name == "SurfaceGroup":
        arguments = [[_light(theirs, each) for each in arguments]]
    return getattr(theirs, name)(*arguments, **keywords)


def _fields(record, count):
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    dr.eval(values)
    return {
        name: _lanes(value, count) if dr.depth_v(value) == 1 else _rows(mi.Vector3f(value), count)
        for name, value in values.items()
    }


# -------------------------------------------------------------------------------- renderers


def radiance(theirs, integrator, parameters, scene, o, d, seeds, spp, seed):
    """Means of `spp` calls of an integrator's `sample`, shape (seeds, n, 3), along n rays."""
    plugin = _integrator(theirs, integrator, parameters)
    return _answer(plugin, scene, o, d, seeds, spp, seed)["radiance"]


def answer(theirs, integrator, name, parameters, scene, o, d, seeds, spp, seed):
    """All that the plugin `name` answers: see `radiance`; the other two elements, and the noise.

    `met` is the share of samples that met a surface, `empty` whether nothing else came, and
    `deviation` the standard deviation of one sample, shape (n, 3).
    """
    kind = getattr(theirs, integrator)
    plugin = mi.load_dict({"type": name, **parameters})
    if not isinstance(plugin, kind):
        raise TypeError(f"the plugin {name} is not a {integrator}; check mi.register_integrator")
    return _answer(plugin, scene, o, d, seeds, spp, seed)


def _answer(plugin, scene, o, d, seeds, spp, seed):
    o = np.asarray(o)
    d = np.asarray(d)
    scene = mi.load_dict(_scene(scene))
    count = len(o) * seeds * spp
    each = dr.arange(mi.UInt32, count) // (seeds * spp)
    lanes = [
        mi.Vector3f(*(dr.gather(mi.Float, mi.Float(np.ascontiguousarray(x)), each) for x in a.T))
        for a in (o, d)
    ]
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    ray = mi.RayDifferential3f(mi.Point3f(lanes[0]), lanes[1])
    color, met, others = plugin.sample(scene, sampler, ray, None, mi.Bool(True))
    dr.eval(color, met)
    values = _rows(mi.Color3f(color), count).reshape(len(o), seeds, spp, 3)
    return {
        "radiance": values.mean(axis=2).swapaxes(0, 1),
        "deviation": values.reshape(len(o), -1, 3).std(axis=1),
        "met": _lanes(met, count).reshape(len(o), -1).mean(axis=1),
        "empty": isinstance(others, list | tuple) and len(others) == 0,
    }


def moments(theirs, integrator, parameters, scene, o, d, spp, seed):
    """Mean and standard deviation of single samples of the green channel along one ray."""
    values = radiance(theirs, integrator, parameters, scene, [o], [d], spp, 1, seed)[:, 0, 1]
    return {"mean": float(values.mean()), "deviation": float(values.std())}


def image(theirs, integrator, parameters, scene, spp, seed):
    """A picture by `mi.render`."""
    plugin = _integrator(theirs, integrator, parameters)
    return mi.render(mi.load_dict(_scene(scene)), integrator=plugin, spp=spp, seed=seed)


def _integrator(theirs, name, parameters):
    mi.register_integrator("a1_judged", getattr(theirs, name))
    return mi.load_dict({"type": "a1_judged", **parameters})


def _scene(value):
    """A dict for `mi.load_dict`: arrays of 4 x 4 become transforms."""
    if isinstance(value, dict) and value.get("type") == "with normals":
        return _mesh(value)
    if isinstance(value, dict):
        return {key: _scene(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.shape == (4, 4):
        return mi.ScalarTransform4f(value)
    return value


def _mesh(value):
    """A mesh with a given normal at each corner."""
    corners = np.asarray(value["corners"])
    normals = np.asarray(value["normals"])
    faces = np.asarray(value["faces"], np.uint32)
    bsdf = mi.Properties()
    bsdf["bsdf"] = mi.load_dict(value["bsdf"])
    mesh = mi.Mesh("mesh", len(corners), len(faces), has_vertex_normals=True, props=bsdf)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(corners.ravel().astype(np.float32))
    parameters["vertex_normals"] = mi.Float(normals.ravel().astype(np.float32))
    parameters["faces"] = mi.UInt32(faces.ravel())
    parameters.update()
    return mesh


# -------------------------------------------------------------------------------- conversions


def _floats(parameters):
    """Convert arrays to Dr.Jit floats, and keep numbers."""
    return [mi.Float(np.float32(p)) if isinstance(p, np.ndarray) else p for p in parameters]


def _point2(points):
    x, y = np.asarray(points, np.float32).T.copy()
    return mi.Point2f(mi.Float(x), mi.Float(y))


def _vector3(points):
    x, y, z = np.asarray(points, np.float32).T.copy()
    return mi.Vector3f(mi.Float(x), mi.Float(y), mi.Float(z))


def _lists(corners):
    return np.asarray(corners, np.float64).tolist()


def _lanes(value, count):
    """Convert to one number per lane; a single number is repeated."""
    return np.broadcast_to(np.atleast_1d(np.array(value, np.float64)), (count,))


def _rows(value, count):
    """A row a lane."""
    dr.eval(value)
    return np.stack([_lanes(each, count) for each in value], axis=1)
