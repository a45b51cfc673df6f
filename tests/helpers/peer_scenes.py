"""Scene files with the parameters and the structure of mitransient's own, and meshes for them.

Each function writes a file and the meshes that it needs into a folder and returns the file's path.
"""

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


def give_names_back() -> None:
    """Let plugins' names mean ours again, once mitransient is imported and has taken them."""
    mi.register_integrator("transient_path", maker(tofrender.TransientPath))
    mi.register_integrator("transient_nlos_path", tofrender.TransientNLOSPath)
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
    """Looks at the origin from (-2, 0, 2), by the transforms of an exporter."""
    return f"""
    <sensor type="perspective" id="elm__1" name="elm__1">
      <string name="fov_axis" value="x"/>
      <float name="fov" value="40"/>
      <float name="principal_point_offset_x" value="0"/>
      <float name="principal_point_offset_y" value="-0"/>
      <float name="near_clip" value="0.1"/>
      <float name="far_clip" value="100"/>
      <transform name="to_world">{TURNED}</transform>
      <sampler type="independent" name="sampler">
        <integer name="sample_count" value="{spp}"/>
      </sampler>
      <film type="transient_hdr_film" name="film">
        <integer name="width" value="{size}"/>
        <integer name="height" value="{size}"/>
        <integer name="temporal_bins" value="300"/>
        <float name="bin_width_opl" value="0.006"/>
        <float name="start_opl" value="5.25"/>
        <rfilter type="box" name="rfilter"/>
      </film>
    </sensor>"""


def integrator(capture_type: int = 1, more: str = "") -> str:
    names = {
        "nlos_laser_sampling": "true",
        "nlos_hidden_geometry_sampling": "true",
        "nlos_hidden_geometry_sampling_do_rroulette": "false",
        "nlos_hidden_geometry_sampling_includes_relay_wall": "false",
        "discard_direct_paths": "False",
        "account_first_and_last_bounces": "False",
    }
    lines = "".join(f'<boolean name="{name}" value="{value}"/>' for name, value in names.items())
    return f"""
    <integrator type="transient_nlos_path">
      {lines}
      <string name="temporal_filter" value="box"/>
      <integer name="capture_type" value="{capture_type}"/>
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
    path = folder / "nlos-z-simple.xml"
    parts = camera(spp, size) + integrator(**options) + PROJECTOR + shapes
    path.write_text(f'<scene version="2.1.0">{parts}</scene>', encoding="utf-8")
    return path


# Centre, and the axes along a plane's own x and y (half of its sides), of the room's six planes
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
    for number, (file, (centre, u, v)) in enumerate(ROOM.items(), start=4):
        corners = np.asarray(centre) + SQUARE[:, :1] * np.asarray(u) + SQUARE[:, 1:2] * np.array(v)
        mesh(folder / "meshes" / file, corners)
        shapes += plate(f"elm__{number}", file, False)
    path = folder / "nlos-z-room.xml"
    parts = camera(spp, size) + integrator(**options) + PROJECTOR + shapes
    path.write_text(f'<scene version="2.1.0">{parts}</scene>', encoding="utf-8")
    return path


CORNELL = {  # Corners of each rectangle, as in the box that is 5.6 m wide, in decimetres
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


def colour(value: str) -> str:
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{value}"/></bsdf>'


def cornell(folder: Path, kind: str = "diffuse") -> Path:
    """The Cornell box with `<default>` names, an integrator that is one, and OBJ meshes.

    Args:
        folder: Where to write.
        kind: "diffuse", "mirror" (a metal wall and a box of water) or "freq" (a phasor film).
    """
    for name, corners in CORNELL.items():
        mesh(folder / f"meshes/cbox_{name}.obj", 10.0 * np.array(corners))
    for name, (centre, half) in BOXES.items():
        corners = 10.0 * (np.array(centre) + CUBE * [8, half, 8])
        mesh(folder / f"meshes/cbox_{name}.obj", corners, CUBE_FACES)
    bsdfs = dict.fromkeys(("floor", "ceiling", "back"), '<ref id="white"/>')
    bsdfs |= {"greenwall": colour("0.1, 0.4, 0.1"), "redwall": colour("0.6, 0.04, 0.04")}
    bsdfs |= dict.fromkeys(BOXES, '<ref id="gray"/>')
    more = '<float name="gaussian_stddev" value="2.0"/>'
    window = """
        <integer name="temporal_bins" value="400"/>
        <float name="start_opl" value="1000"/>
        <float name="bin_width_opl" value="6.5"/>"""
    if kind == "mirror":
        metal = '<string name="material" value="none"/>'
        bsdfs["back"] = f'<bsdf type="conductor">{metal}</bsdf>'
        water = '<string name="int_ior" value="water"/><string name="ext_ior" value="air"/>'
        bsdfs["largebox"] = f'<bsdf type="dielectric">{water}</bsdf>'
    film = "transient_hdr_film"
    if kind == "freq":
        film, more = "phasor_hdr_film", more + '<boolean name="discard_direct_light" value="true"/>'
        window = """
        <float name="wl_mean" value="100"/>
        <float name="wl_sigma" value="100"/>
        <integer name="temporal_bins" value="4000"/>
        <float name="bin_width_opl" value="1"/>
        <float name="start_opl" value="0"/>"""
    shapes = "".join(
        f"""
  <shape type="obj" id="{name}">
    <string name="filename" value="meshes/cbox_{name}.obj"/>
    {bsdf}
  </shape>"""
        for name, bsdf in bsdfs.items()
    )
    path = folder / f"cbox_{kind}.xml"
    path.write_text(
        f"""
<scene version="3.3.0">
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
    <float name="near_clip" value="10"/>
    <float name="far_clip" value="2800"/>
    <float name="focus_distance" value="1000"/>
    <float name="fov" value="39.3077"/>
    <transform name="to_world">
      <lookat origin="280, 275, -800" target="280, 275, -799" up="  0,   1,    0"/>
    </transform>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    <film type="{film}">
        <integer name="width" value="$res"/>
        <integer name="height" value="$res"/>
        {window}
        <rfilter type="box"/>
    </film>
  </sensor>
  <bsdf type="diffuse" id="gray"><rgb name="reflectance" value="0.85, 0.85, 0.85"/></bsdf>
  <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.9, 0.7, 0.7"/></bsdf>
  <shape type="obj" id="light">
    <string name="filename" value="meshes/cbox_luminaire.obj"/>
    <transform name="to_world"><translate x="0" y="-0.5" z="0"/></transform>
    <ref id="white"/>
    <emitter type="area"><rgb name="radiance" value="18.4, 11, 2.8"/></emitter>
  </shape>{shapes}
</scene>""".lstrip(),
        encoding="utf-8",
    )
    return path


def white(more: str = "") -> str:
    return '<bsdf type="diffuse"><rgb name="reflectance" value="1.0, 1.0, 1.0"/></bsdf>' + more


def placed(z: float) -> str:
    turns = "".join(f'<rotate {axis}="1" angle="0.0"/>' for axis in "xyz")
    return f"""<transform name="to_world">
      <scale x="1" y="1" z="1"/>{turns}<translate x="0.0" y="0.0" z="{z}"/></transform>"""


def nlos_z(
    folder: Path,
    *,
    spp: int = 25000,
    size: int = 64,
    path_options: str = "",
    meter_options: str = "",
    film_options: str = "",
    lookat: str = '<point name="laser_lookat_pixel" x="32" y="32" z="0"/>',
) -> Path:
    """A meter that says where the laser is; the emitter has no transform of its own."""
    vertices, faces = letter_z()
    mesh(folder / "Z.obj", vertices, faces)
    path = folder / "nlos_Z.xml"
    path.write_text(
        f"""
<scene version="3.3.0">
  <integrator type="transient_nlos_path">
    <integer name="block_size" value="1"/>
    <integer name="max_depth" value="-1"/>
    <integer name="filter_depth" value="-1"/>
    <boolean name="discard_direct_paths" value="false"/>
    <boolean name="nlos_laser_sampling" value="true"/>
    <boolean name="nlos_hidden_geometry_sampling" value="true"/>
    <boolean name="nlos_hidden_geometry_sampling_do_rroulette" value="false"/>
    <boolean name="nlos_hidden_geometry_sampling_includes_relay_wall" value="false"/>
    <string name="temporal_filter" value="box"/>
    {path_options}
  </integrator>
  <shape type="obj">
    <string name="filename" value="./Z.obj"/>
    {white(placed(1.0))}
  </shape>
  <emitter type="projector">
    <rgb name="irradiance" value="1.0, 1.0, 1.0"/>
    <float name="fov" value="0.2"/>
  </emitter>
  <shape type="rectangle" id="relay_wall">
    {white(placed(0.0))}
    <sensor type="nlos_capture_meter">
      <sampler type="independent">
        <integer name="sample_count" value="{spp}"/>
        <integer name="seed" value="0"/>
      </sampler>
      <boolean name="confocal" value="false"/>
      <boolean name="account_first_and_last_bounces" value="false"/>
      <point name="sensor_origin" x="-0.5" y="0.0" z="0.25"/>
      <point name="laser_origin" x="-0.5" y="0.0" z="0.25"/>
      {lookat}
      {meter_options}
      <film type="transient_hdr_film">
        <integer name="width" value="{size}"/>
        <integer name="height" value="{size}"/>
        <integer name="temporal_bins" value="300"/>
        <float name="bin_width_opl" value="0.006"/>
        <float name="start_opl" value="1.85"/>
        <rfilter type="box"/>
        {film_options}
      </film>
    </sensor>
  </shape>
</scene>""".lstrip(),
        encoding="utf-8",
    )
    return path
