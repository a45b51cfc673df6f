"""Vertices and world transforms by the interface of Mitsuba 3.10, whose stand-ins are here."""

import re
from pathlib import Path
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.datasets import changes
from tofrender.paths import surfaces
from tofrender.runtime import interface
from tofrender.runtime.interface import NORMALS, POSITIONS
from tofrender.vis import plans

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 2, 3]])
FACES = np.array([[0, 1, 2], [1, 3, 2]])


class Params(dict):
    """Parameters of an object, as `mi.traverse` returns them."""

    def update(self, *args):
        """As Mitsuba's, without arguments."""


class NextMesh:
    """A mesh as that of Mitsuba 3.10, built in one call."""

    def __init__(self, name, *, faces, positions, normals=None, props=None):
        self.name, self.parameters = name, Params(faces=faces.array, positions=positions)
        self.parameters["normals"] = mi.TensorXf(np.zeros((0, 3))) if normals is None else normals

    def is_mesh(self):
        """As Mitsuba's."""
        return True


class Animated:
    """A transform whose translation grows with time."""

    def eval(self, time):
        """The transform at a time."""
        return mi.Transform4f().translate([1.0 + float(time), 2, 3])


@pytest.fixture
def next_mitsuba(monkeypatch):
    traverse = mi.traverse

    def of(thing):
        return thing.parameters if isinstance(thing, NextMesh) else traverse(thing)

    monkeypatch.setattr(mi, "Mesh", NextMesh)
    monkeypatch.setattr(mi, "traverse", of)


def flat(values):
    return mi.Float(np.float32(values).ravel())


def tensor(values):
    return mi.TensorXf(np.float32(values))


@pytest.mark.parametrize(("form", "at"), [(flat, 0), (tensor, 1)])
def test_vertices_of_both_interfaces(form, at):
    params = Params({f"mesh.{POSITIONS[at]}": form(POINTS), POSITIONS[at]: form(POINTS)})
    assert interface.name_of(params, POSITIONS, "mesh.") == f"mesh.{POSITIONS[at]}"
    assert interface.name_of(params, POSITIONS, "other.") is None
    np.testing.assert_array_equal(interface.rows(params, POSITIONS), POINTS)
    assert interface.rows(params, NORMALS).shape == (0, 3)
    interface.set_rows(params, POSITIONS, 2 * POINTS)
    np.testing.assert_array_equal(interface.rows(params, POSITIONS), 2 * POINTS)
    assert type(params[POSITIONS[at]]) is type(form(POINTS))


@pytest.mark.parametrize("form", [flat, tensor])
def test_vertices_move_with_derivatives(form):
    value, shift = form(POINTS), mi.Float(0.0)
    dr.enable_grad(shift)
    moved = mi.Transform4f().translate([shift, 0, 0]) @ interface.vectors(value, mi.Point3f)
    again = interface.like(value, dr.ravel(moved))
    assert again.shape == value.shape
    dr.forward(shift)
    rates = np.array(dr.grad(again)).reshape(-1, 3)
    np.testing.assert_array_equal(rates, np.broadcast_to([1, 0, 0], (4, 3)))


@pytest.mark.parametrize("normals", [None, np.broadcast_to([0.0, 0, 1], (4, 3))])
def test_meshes_are_made_and_changed(next_mitsuba, normals):
    mesh = interface.make_mesh("mesh", POINTS, FACES, normals)
    assert isinstance(mesh, NextMesh)
    params = mi.traverse(mesh)
    assert params["positions"].shape == (4, 3)
    np.testing.assert_array_equal(np.array(params["faces"]).reshape(-1, 3), FACES)
    assert len(interface.rows(params, NORMALS)) == (0 if normals is None else 4)
    np.testing.assert_array_equal(plans._points(mesh), POINTS)
    twin = surfaces.flat_twin(mesh)
    assert (twin is None) == (normals is None)
    turn = np.array([[0.0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    changes._transform_mesh(mesh, turn)
    moved = POINTS @ turn[:3, :3].T + turn[:3, 3]
    np.testing.assert_allclose(interface.rows(params, POSITIONS), moved)


def test_poses_may_be_animated():
    still = SimpleNamespace(world_transform=lambda: mi.Transform4f().translate([1, 2, 3]))
    moving = SimpleNamespace(world_transform=Animated)
    for part in (still, moving):
        np.testing.assert_array_equal(interface.pose(part)[:3, 3], [1, 2, 3])
        p = interface.world_transform(part) @ mi.Point3f(0)
        np.testing.assert_array_equal(np.array(p).ravel(), [1, 2, 3])
    assert interface.pose_name({"to_world": 1}) == "to_world"
    assert interface.pose_name({"a.to_world.value": 1}, "a.") == "a.to_world.value"
    assert interface.pose_name({"a.to_worldly": 1}, "a.") is None


def test_nobody_else_asks_mitsuba_for_them():
    package = Path(tofrender.__file__).parent
    asked = re.compile(r"\.world_transform\(\)|\[\W*vertex_(positions|normals)\W*\]|mi\.Mesh\(")
    users = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if asked.search(path.read_text("utf-8"))
    }
    assert users == {"runtime/interface.py"}
