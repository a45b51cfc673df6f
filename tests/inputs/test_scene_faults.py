"""Scenes with a fault, as dicts and as XML: one clear line before anything is rendered."""

import functools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from helpers.bad_inputs import PLACES, listing, one_clear_line
from helpers.rooms import FILM, T, camera, floor, lamp, material, room

import tofrender

FILM |= {"start_opl": 0.0, "bin_width_opl": 1.0}
INDEPENDENT = {"type": "independent"}
NAN, INF = math.nan, math.inf


def film(**changes: Any) -> dict[str, Any]:
    return camera(film=FILM | changes)


def rgb(*values: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(values)}


def area(radiance: Any) -> dict[str, Any]:
    light = {"type": "area", "radiance": radiance}
    return room(lamp={"type": "rectangle", "emitter": light})


def placed(matrix: Any) -> dict[str, Any]:
    return floor(to_world=mi.ScalarTransform4f(np.asarray(matrix, float)))


def without(*names: str) -> dict[str, Any]:
    return {name: part for name, part in room().items() if name not in names}


def nested(depth: int) -> dict[str, Any]:
    inner: dict[str, Any] = {"type": "diffuse"}
    for _ in range(depth):
        inner = {"type": "twosided", "bsdf": inner}
    return floor(bsdf=inner)


def mesh(vertices: Any) -> dict[str, Any]:
    shape = mi.Mesh("mesh", 3, 1)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.ravel(vertices)
    parameters["faces"] = [0, 1, 2]
    parameters.update()
    return room(mesh=shape)


def painted(reflectance: Any) -> dict[str, Any]:
    return material(type="diffuse", reflectance=reflectance)


def each(what: str, make: Callable[[Any], Any], *values: Any) -> dict[str, Callable[[], Any]]:
    return {f"{what} of {value}"[:40]: functools.partial(make, value) for value in values}


SCENES: dict[str, Callable[[], Any]] = {
    # ------------------------------------------------------------------------- what is no scene
    **each("a type", lambda x: room(type=x), "sphere", 3),
    **each("nothing", dict, {}, {"type": "sphere"}, {"type": "scene"}),
    # -------------------------------------------------------------------------- what is missing
    **each("lack", without, "type", "sensor", "lamp", "integrator"),
    **each("a part", lambda x: room(floor=x), {"radius": 1.0}, None, {"type": None}, {"type": 3}),
    "a deep None": lambda: painted({"type": "rgb", "value": None}),
    # ------------------------------------------------------------------------- what is unknown
    **each("a part", lambda x: room(floor=x), {"type": "rectangel"}, [1, 2]),
    "unknown integrator": lambda: room(integrator={"type": "transient_paht"}),
    "unknown film": lambda: camera(film={"type": "transient_film"}),
    "unknown material": lambda: material(type="difuse"),
    "unknown parameter": lambda: floor(radus=1.0),
    "unknown parameter of ours": lambda: room(integrator={"type": "transient_path", "depth": 3}),
    "unknown parameter of the film": lambda: film(bins=3),
    **each("a reference", lambda x: material(type="ref", **x), {"id": "paint"}, {}),
    **each("a value", lambda x: floor(flip_normals=x), {1}, b"x"),
    "a number as a name": lambda: room() | {3: {"type": "sphere"}},
    # ------------------------------------------------------------------------- steady and others
    "a steady integrator": lambda: room(integrator={"type": "path"}),
    "a film of phasors": lambda: camera(
        film={"type": "phasor_hdr_film", "width": 4, "height": 4, "frequencies_hz": "2e7"}
    ),
    "a deep nest": lambda: nested(300),
    "a bright medium": lambda: floor(interior={"type": "homogeneous", "albedo": 1.5}),
    "a camera in no medium": lambda: camera(medium={"type": "homogeneous", "sigma_t": -1.0}),
    # --------------------------------------------------------------------------- lights
    **each("an intensity", lambda x: lamp(intensity=rgb(1, x, 1)), -1.0, NAN, INF),
    **each("a radiance", lambda x: area(rgb(x, 1, 1)), -1.0, NAN, INF),
    **each("a place", lambda x: lamp(position=x), [NAN, 0, 0], [INF, 0, 0], [0, 0], "here"),
    "a light without a shape": lambda: room(lamp={"type": "area", "radiance": rgb(1, 1, 1)}),
    # --------------------------------------------------------------------------- shapes
    **each("a scale", lambda x: placed(np.diag([*x, 1])), [0, 1, 1], [0, 0, 0]),
    **each("a scale", lambda x: placed(np.diag([*x, 1])), [NAN, 1, 1], [INF, 1, 1]),
    "moved to NaN": lambda: placed([[1, 0, 0, NAN], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
    **each("a mesh", lambda x: mesh([[0, 0, 0], [1, 0, 0], [x, 1, 0]]), NAN, INF),
    "a mesh in a point": lambda: mesh(np.ones((3, 3))),
    **each("a file", lambda x: room(floor={"type": "ply", "filename": x}), "no.ply", "."),
    "a mesh without a file": lambda: room(floor={"type": "ply"}),
    "no such object": lambda: room(floor={"type": "obj", "filename": "no.obj"}),
    "a transform of text": lambda: floor(to_world="left"),
    **each("a sphere", lambda x: room(floor={"type": "sphere", "radius": x}), "big", NAN, 0.0),
    # ------------------------------------------------------------------------- materials
    **each("a reflectance", painted, rgb(NAN, 0, 0), rgb(INF, 0, 0), rgb(1, 1), "white"),
    "no such texture": lambda: painted({"type": "bitmap", "filename": "no.png"}),
    "glass of text": lambda: material(type="dielectric", int_ior="unobtainium"),
    "roughness of NaN": lambda: material(type="roughconductor", alpha=NAN),
    # ------------------------------------------------------------------------- cameras
    **each("a fov", lambda x: camera(fov=x), 0.0, -5.0, 180.0, NAN, "wide"),
    **each("clips", lambda x: camera(near_clip=x, far_clip=1.0), 5.0, 0.0),
    "a camera nowhere": lambda: camera(to_world=T().translate([NAN, 0, 0])),
    "a flat camera": lambda: camera(to_world=T().scale([1, 1, 0])),
    "two films": lambda: camera(other=FILM),
    "an unknown sampler": lambda: camera(sampler={"type": "halton"}),
    **each("samples", lambda x: camera(sampler=INDEPENDENT | {"sample_count": x}), -1, "many"),
    # ------------------------------------------------------------------------- films
    **each("a width", lambda x: film(width=x), 0, -4, 1 << 20, "wide"),
    **each("a crop", lambda x: film(crop_width=x, crop_height=1), 0, 1.5),
    "a crop beside": lambda: film(crop_offset_x=9, crop_width=4),
    "a film beyond memory": lambda: film(width=60000, height=60000, temporal_bins=1000),
    "too many bins": lambda: film(temporal_bins=1 << 30),
    **each("a start", lambda x: film(start_opl=x), 1e6, -1e6),
}


def refused(source: Any, **options: Any) -> str:
    with pytest.raises((ValueError, TypeError, MemoryError, OSError)) as error:
        tofrender.render(source, spp=1, progress=False, **options)
    said = str(error.value)
    return "" if _tells(said) else one_clear_line(error.value, "scene")


def _tells(said: str) -> bool:
    """Whether a line has a word of its own, not of Python's, for what is wrong."""
    return not one_clear_line(ValueError(f"{said} must scene"), "scene") and len(said) < 600


def test_the_room_is_right():
    assert tofrender.render(room(), spp=1, progress=False)["steady"].values.max() > 0


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("what", SCENES)
def test_scenes(tmp_path, monkeypatch, what):
    monkeypatch.chdir(tmp_path)
    assert not refused(SCENES[what]())


GOOD = """<scene version="3.0.0">
<default name="width" value="4"/>
<integrator type="transient_path"/>
<sensor type="perspective">
<transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
<film type="transient_hdr_film"><integer name="width" value="$width"/>
<integer name="height" value="4"/><integer name="temporal_bins" value="8"/>
<float name="start_opl" value="0"/><float name="bin_width_opl" value="1"/></film>
</sensor>
<shape type="rectangle" id="floor"/>
<emitter type="point"><point name="position" x="0" y="0" z="2"/></emitter>
</scene>
"""
LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10 if k else "ha" * 50}">' for k in range(9))


def changed(old: str, new: str) -> bytes:
    assert old in GOOD
    return GOOD.replace(old, new, 1).encode()


def added(text: str) -> bytes:
    return changed("</scene>", f"{text}\n</scene>")


def ball(inside: str) -> str:
    return f'<shape type="sphere">{inside}</shape>'


def moved(text: str) -> str:
    transform = f'<transform name="to_world">{text}</transform>'
    return f'<shape type="rectangle">{transform}</shape>'


HEIGHT, HEIGHTS = 'name="height" value="4"', ("4.5", "99999999999999999999", "-4")
FLOOR, TRANSFORMS = (
    '<shape type="rectangle" id="floor"/>',
    ('<matrix value="1 2 3"/>', '<scale value="0"/>'),
)
LAMP = '<emitter type="area"><rgb name="radiance" value="{}"/></emitter>'
XML: dict[str, bytes] = {
    **{"empty": b"", "blank": b"  \n", "text": b"a scene"},
    "a comment alone": b"<!-- scene -->",
    "zeros": bytes(100),
    "random": bytes(range(256)) * 4,
    "a NUL": GOOD.encode().replace(b"floor", b"fl\0or"),
    "invalid utf-8": GOOD.encode().replace(b"rectangle", b"rect\xff\xfeangle"),
    "another root": b'<shape type="sphere" version="3.0.0"/>',
    "two roots": GOOD.encode() + GOOD.encode(),
    "no version": changed(' version="3.0.0"', ""),
    "a version of text": changed("3.0.0", "three"),
    "an open tag": changed("</scene>", ""),
    "a wrong end": changed("</scene>", "</shape>"),
    "an open quote": changed('id="floor"', 'id="floor'),
    "an unknown tag": added("<lamp/>"),
    "a tag of ours": added('<wall type="rectangle"/>'),
    "no type": added("<shape/>"),
    **{f"a type of {x}": added(f'<shape type="{x}"/>') for x in ("", "rectangel")},
    "an unknown attribute": added('<shape type="sphere" size="3"/>'),
    "no name": added(ball('<float value="1"/>')),
    "no value": added(ball('<float name="radius"/>')),
    "a name twice": added(ball('<float name="radius" value="1"/><float name="radius" value="2"/>')),
    "an id twice": added('<shape type="sphere" id="floor"/>'),
    **{f"a float of {x}": added(ball(f'<float name="radius" value="{x}"/>')) for x in ("x", "nan")},
    **{f"a height of {text}": changed(HEIGHT, HEIGHT.replace("4", text)) for text in HEIGHTS},
    "a boolean of text": added(ball('<boolean name="flip_normals" value="maybe"/>')),
    "a point of two": changed('y="0" z="2"', 'y="0"'),
    "a point of text": changed('x="0"', 'x="left"'),
    "a reference to nothing": added(ball('<ref id="paint"/>')),
    "a reference to itself": added('<bsdf type="twosided" id="a"><ref id="a"/></bsdf>'),
    "a parameter without a value": changed('value="$width"', 'value="$wdth"'),
    "a default without a name": changed('<default name="width"', "<default"),
    "a default without a value": changed('name="width" value="4"/>\n<int', 'name="width"/>\n<int'),
    "a default that is text": changed('name="width" value="4"', 'name="width" value="x"'),
    **{f"include {x}": added(f'<include filename="{x}"/>') for x in ("no.xml", ".", "scene.xml")},
    "no such mesh": added('<shape type="ply"><string name="filename" value="no.ply"/></shape>'),
    "a deep nest": added('<bsdf type="twosided">' * 300 + "</bsdf>" * 300),
    "a very deep nest": added('<bsdf type="twosided">' * 100_000),
    "another's file": (
        b'<!DOCTYPE scene [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
        + changed(
            'id="floor"', 'id="floor"><string name="x" value="&x;"/></shape><shape type="&x;"'
        )
    ),
    "a transform of nothing": changed('origin="0,0,4"', 'origin="0,0,0"'),
    "a lookat of two": changed('origin="0,0,4"', 'origin="0,0"'),
    **{f"moved by {text}": changed(FLOOR, moved(text)) for text in TRANSFORMS},
    **{f"a color of {text}": added(ball(LAMP.format(text))) for text in ("red", "-1")},
}


def test_the_xml_is_right(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(GOOD)
    assert tofrender.render(path, spp=1, progress=False)["steady"].values.max() > 0


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("what", XML, ids=lambda what: re.sub(r"\W+", " ", what).strip())
def test_xml(tmp_path, monkeypatch, what):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.xml"
    path.write_bytes(XML[what])
    before = listing(tmp_path)
    assert not refused(path)
    assert listing(tmp_path) == before


def test_entities_are_not_multiplied(tmp_path):
    """A hundred million of them, in a file of a kilobyte."""
    path = tmp_path / "scene.xml"
    path.write_bytes(f"<!DOCTYPE scene [{LAUGHS}]>".encode() + changed('id="floor"', 'id="&l8;"'))
    scene = tofrender.load_scene(path)
    assert [shape.id() for shape in scene.shapes()] == ["&l8;"]


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("kind", PLACES)
def test_xml_that_is_no_file(tmp_path, kind):
    path = tmp_path / "scene.xml"
    PLACES[kind](path)
    for source in (path, str(path)):
        assert not refused(source)


BAD_PARAMETERS = [{"wdth": 3}, {"": 3}, {"a b": 3}]
BAD_PARAMETERS += [{"width": value} for value in ("x", -1, None, [1])]


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("parameters", BAD_PARAMETERS)
def test_xml_parameters(tmp_path, parameters):
    path = tmp_path / "scene.xml"
    path.write_text(GOOD)
    with pytest.raises((ValueError, TypeError, OSError)) as error:
        tofrender.load_scene(path, parameters=parameters)
    assert _tells(str(error.value)), str(error.value)


@pytest.mark.usefixtures("no_work")
def test_xml_that_is_cut_or_flipped(tmp_path, pytestconfig):
    path: Path = tmp_path / "scene.xml"
    content = GOOD.encode()
    step = 1 if pytestconfig.getoption("--all-inputs") else 29
    broken = [content[:size] for size in range(0, len(content), step)]
    for bit in range(0, 8 * len(content), 3 * step):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        broken.append(bytes(flipped))
    wrong = {}
    for number, each in enumerate(broken):
        path.write_bytes(each)
        try:
            tofrender.load_scene(path)
        except Exception as error:
            if not (isinstance(error, ValueError | TypeError | OSError) and _tells(str(error))):
                wrong[number] = repr(error)[:300]
    assert not wrong
