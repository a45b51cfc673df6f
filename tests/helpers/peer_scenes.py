"""Scene files with the parameters and the structure of mitransient's own, and meshes for them.

Each function writes a file and the meshes that it needs into a folder and returns the file's path.
"""

import re
from pathlib import Path

import mitsuba as mi
import numpy as np

import tofrender
from tofrender.nlos.light.confocal import maker
from tofrender.scenes.meshes import letter_z

# Corners of a rectangle of half-width 1 that faces +z
SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])

TURNED = """
<rotate x="1" angle="180"/>
<rotate y="1" angle="45"/>
<rotate z="1" angle="180"/>
<translate value="-2 0 2"/>
"""


def tags(kind: str, **values: object) -> str:
    """One tag of a value for each name, such as `<integer name="width" value="4"/>`."""
    return "".join(f'<{kind} name="{name}" value="{value}"/>\n' for name, value in values.items())


def sampler(spp: object, **more: int) -> str:
    return f'<sampler type="independent">{tags("integer", sample_count=spp, **more)}</sampler>'


def film(kind: str, size: object, bins: int, width: float, start: float, more: str = "") -> str:
    return f"""
    <film type="{kind}">
      {tags("integer", width=size, height=size, temporal_bins=bins)}
      {tags("float", bin_width_opl=width, start_opl=start)}
      <rfilter type="box"/>{more}
    </film>"""


def written(path: Path, version: str, body: str) -> Path:
    path.write_text(f'<scene version="{version}">{body}</scene>', encoding="utf-8")
    return path


def give_names_back() -> None:
    """Let plugins' names mean ours again, once mitransient is imported and has taken them."""
    mi.register_integrator("transient_path", maker(tofrender.TransientPath))
    mi.register_integrator("transient_nlos_path", tofrender.TransientNLOSPath)
    mi.register_emitter("angulararea", tofrender.AngularArea)
    mi.register_sensor("nlos_capture_meter", tofrender.NLOSCaptureMeter)
    mi.register_film("transient_hdr_film", tofrender.TransientHDRFilm)
    mi.register_film("phasor_hdr_film", tofrender.PhasorHDRFilm)


def mesh(path: Path, vertices: np.ndarray, faces: np.ndarray = SQUARE_FACES) -> None:
    """Write a mesh as PLY or as OBJ, as the suffix says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in vertices]
        lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
        path.write_text("\n".join(lines) + "\n", encoding="ascii")
        return
    written = mi.Mesh(path.stem, len(vertices), len(faces))
    parameters = mi.traverse(written)
    parameters["vertex_positions"] = np.ravel(vertices)
    parameters["faces"] = np.ravel(faces)
    parameters.update()
    written.write_ply(str(path))


def camera(spp: int, size: int) -> str:
    """Looks at the origin from (-2, 0, 2), by the transforms and names of an exporter."""
    inner = sampler(spp) + film("transient_hdr_film", size, 300, 0.006, 5.25)
    inner = re.sub("<(sampler|film|rfilter)", r'<\1 name="\1"', inner)
    return f"""
    <sensor type="perspective" id="elm__1" name="elm__1">
      <string name="fov_axis" value="x"/>
      {tags("float", fov=40, principal_point_offset_x=0, principal_point_offset_y="-0")}
      {tags("float", near_clip=0.1, far_clip=100)}
      <transform name="to_world">{TURNED}</transform>
      {inner}
    </sensor>"""


HIDDEN_GEOMETRY = {
    "nlos_laser_sampling": "true",
    "nlos_hidden_geometry_sampling": "true",
    "nlos_hidden_geometry_sampling_do_rroulette": "false",
    "nlos_hidden_geometry_sampling_includes_relay_wall": "false",
}


def integrator(capture_type: int | None = None, more: str = "") -> str:
    kind = "" if capture_type is None else tags("integer", capture_type=capture_type)
    direct = {"discard_direct_paths": "False", "account_first_and_last_bounces": "False"}
    return f"""
    <integrator type="transient_nlos_path">
      {tags("boolean", **HIDDEN_GEOMETRY, **direct)}
      <string name="temporal_filter" value="box"/>
      {kind}
      {more}
    </integrator>"""


PROJECTOR = f"""
    <emitter type="projector">
      <rgb name="irradiance" value="100"/>
      <float name="fov" value="0.2"/>
      <transform name="to_world">{TURNED}</transform>
    </emitter>
    <bsdf type="twosided" id="default-bsdf" name="default-bsdf">
      <bsdf type="diffuse" name="bsdf"/>
    </bsdf>"""


def plate(name: str, file: str, with_id: bool, flat: bool = True) -> str:
    known = f'id="{name}" ' if with_id else ""
    normals = '<boolean name="face_normals" value="true"/>' if flat else ""
    return f"""
    <shape type="ply" {known}name="{name}">
      <string name="filename" value="meshes/{file}"/>
      {normals}
      <ref id="default-bsdf" name="bsdf"/>
    </shape>"""


def z_simple(
    folder: Path, *, spp: int = 25000, size: int = 32, flat: bool = False, **options
) -> Path:
    """A camera, no word about which shape is the wall; wall and letter of one material.

    With `flat`, the letter has face normals as the wall has, so that Mitsuba merges the two.
    """
    vertices, faces = letter_z()
    mesh(folder / "meshes/Plane.ply", SQUARE)
    mesh(folder / "meshes/hidden_geometry_Z.ply", vertices + np.array([0, 0, 2.6]), faces)
    shapes = plate("elm__3", "Plane.ply", True) + plate(
        "elm__4", "hidden_geometry_Z.ply", True, flat
    )
    parts = camera(spp, size) + integrator(**options) + PROJECTOR + shapes
    return written(folder / "nlos-z-simple.xml", "2.1.0", parts)


# Center, and the axes along a plane's own x and y (half of its sides), of the room's six planes
ROOM = {
    "Plane_001.ply": ((0, 0, 0), (3, 0, 0), (0, 2, 0)),  # the relay wall
    "Plane_002.ply": ((0, -2, 2), (3, 0, 0), (0, 0, -2)),
    "Plane_003.ply": ((0, 2, 2), (3, 0, 0), (0, 0, 2)),
    "Plane_004.ply": ((-3, 0, 2), (0, 0, -2), (0, 2, 0)),
    "Plane_005.ply": ((3, 0, 2), (0, 0, 2), (0, 2, 0)),
    "Plane_006.ply": ((0, 0, 4), (-3, 0, 0), (0, 2, 0)),
}


def z_room(folder: Path, *, spp: int = 250000, size: int = 32, **options) -> Path:
    """The letter in a closed room; its shapes have names, and no ids."""
    vertices, faces = letter_z()
    mesh(folder / "meshes/hidden_geometry_Z.ply", vertices + np.array([0, 0, 2.6]), faces)
    shapes = plate("elm__3", "hidden_geometry_Z.ply", False, False)
    for number, (file, (center, u, v)) in enumerate(ROOM.items(), start=4):
        corners = np.asarray(center) + SQUARE[:, :1] * np.asarray(u) + SQUARE[:, 1:2] * np.array(v)
        mesh(folder / "meshes" / file, corners)
        shapes += plate(f"elm__{number}", file, False)
    parts = camera(spp, size) + integrator(**options) + PROJECTOR + shapes
    return written(folder / "nlos-z-room.xml", "2.1.0", parts)


CORNELL = {  # Corners of each rectangle, as in the box that is 5.6 m wide, in decimeters
    "floor": [(0, 0, 0), (0, 0, 56), (56, 0, 56), (56, 0, 0)],
    "ceiling": [(0, 55, 0), (56, 55, 0), (56, 55, 56), (0, 55, 56)],
    "back": [(0, 0, 56), (0, 55, 56), (56, 55, 56), (56, 0, 56)],
    "greenwall": [(0, 0, 0), (0, 55, 0), (0, 55, 56), (0, 0, 56)],
    "redwall": [(56, 0, 0), (56, 0, 56), (56, 55, 56), (56, 55, 0)],
    "luminaire": [(21, 54.9, 23), (34, 54.9, 23), (34, 54.9, 33), (21, 54.9, 33)],
}
BOXES = {"smallbox": ((18, 8, 17), 8), "largebox": ((37, 16.5, 35), 16.5)}
CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
CUBE_FACES = np.array([face for a, b, c, d in SIDES for face in ((a, b, c), (a, c, d))])


def color(value: str) -> str:
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{value}"/></bsdf>'


def cornell(folder: Path, kind: str = "diffuse") -> Path:
    """The Cornell box with `<default>` names, an integrator that is one, and OBJ meshes.

    Args:
        folder: Where to write.
        kind: "diffuse", "mirror" (a metal wall and a box of water) or "freq" (a phasor film).
    """
    for name, corners in CORNELL.items():
        mesh(folder / f"meshes/cbox_{name}.obj", 10.0 * np.array(corners))
    for name, (center, half) in BOXES.items():
        corners = 10.0 * (np.array(center) + CUBE * [8, half, 8])
        mesh(folder / f"meshes/cbox_{name}.obj", corners, CUBE_FACES)
    bsdfs = dict.fromkeys(("floor", "ceiling", "back"), '<ref id="white"/>')
    bsdfs |= {"greenwall": color("0.1, 0.4, 0.1"), "redwall": color("0.6, 0.04, 0.04")}
    bsdfs |= dict.fromkeys(BOXES, '<ref id="gray"/>')
    more = tags("float", gaussian_stddev=2.0)
    if kind == "mirror":
        metal = '<string name="material" value="none"/>'
        bsdfs["back"] = f'<bsdf type="conductor">{metal}</bsdf>'
        water = tags("string", int_ior="water", ext_ior="air")
        bsdfs["largebox"] = f'<bsdf type="dielectric">{water}</bsdf>'
    window = film("transient_hdr_film", "$res", 400, 6.5, 1000)
    if kind == "freq":
        more += tags("boolean", discard_direct_light="true")
        wavelengths = tags("float", wl_mean=100, wl_sigma=100)
        window = film("phasor_hdr_film", "$res", 4000, 1, 0, wavelengths)
    shapes = "".join(
        f"""
  <shape type="obj" id="{name}">
    <string name="filename" value="meshes/cbox_{name}.obj"/>
    {bsdf}
  </shape>"""
        for name, bsdf in bsdfs.items()
    )
    body = f"""
  <default name="spp" value="256"/>
  <default name="res" value="400"/>
  <default name="integrator" value="transient_path"/>
  <integrator type='$integrator'>
    <boolean name="camera_unwarp" value="false"/>
    <integer name="max_depth" value="8"/>
    <string name="temporal_filter" value="box"/>
    {more}
  </integrator>
  <sensor type="perspective" id="sensor">
    <string name="fov_axis" value="smaller"/>
    {tags("float", near_clip=10, far_clip=2800, focus_distance=1000, fov=39.3077)}
    <transform name="to_world">
      <lookat origin="280, 275, -800" target="280, 275, -799" up="  0,   1,    0"/>
    </transform>
    {sampler("$spp")}
    {window}
  </sensor>
  <bsdf type="diffuse" id="gray"><rgb name="reflectance" value="0.85, 0.85, 0.85"/></bsdf>
  <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.9, 0.7, 0.7"/></bsdf>
  <shape type="obj" id="light">
    <string name="filename" value="meshes/cbox_luminaire.obj"/>
    <transform name="to_world"><translate x="0" y="-0.5" z="0"/></transform>
    <ref id="white"/>
    <emitter type="area"><rgb name="radiance" value="18.4, 11, 2.8"/></emitter>
  </shape>{shapes}"""
    return written(folder / f"cbox_{kind}.xml", "3.3.0", body)


def placed(z: float) -> str:
    """A shape's transform and white material."""
    turns = "".join(f'<rotate {axis}="1" angle="0.0"/>' for axis in "xyz")
    return f"""<transform name="to_world">
      <scale x="1" y="1" z="1"/>{turns}<translate x="0.0" y="0.0" z="{z}"/></transform>
      {color("1.0, 1.0, 1.0")}"""


def nlos_z(
    folder: Path,
    *,
    spp: int = 25000,
    size: int = 64,
    path_options: str = "",
    meter_options: str = "",
    lookat: str = '<point name="laser_lookat_pixel" x="32" y="32" z="0"/>',
) -> Path:
    """A meter that says where the laser is; the emitter has no transform of its own."""
    mesh(folder / "Z.obj", *letter_z())
    body = f"""
  <integrator type="transient_nlos_path">
    {tags("integer", block_size=1, max_depth=-1, filter_depth=-1)}
    {tags("boolean", discard_direct_paths="false", **HIDDEN_GEOMETRY)}
    <string name="temporal_filter" value="box"/>
    {path_options}
  </integrator>
  <shape type="obj">
    <string name="filename" value="./Z.obj"/>
    {placed(1.0)}
  </shape>
  <emitter type="projector">
    <rgb name="irradiance" value="1.0, 1.0, 1.0"/>
    <float name="fov" value="0.2"/>
  </emitter>
  <shape type="rectangle" id="relay_wall">
    {placed(0.0)}
    <sensor type="nlos_capture_meter">
      {sampler(spp, seed=0)}
      {tags("boolean", confocal="false", account_first_and_last_bounces="false")}
      <point name="sensor_origin" x="-0.5" y="0.0" z="0.25"/>
      <point name="laser_origin" x="-0.5" y="0.0" z="0.25"/>
      {lookat}
      {meter_options}
      {film("transient_hdr_film", size, 300, 0.006, 1.85)}
    </sensor>
  </shape>"""
    return written(folder / "nlos_Z.xml", "3.3.0", body)
