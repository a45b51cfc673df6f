from .cases import bsdf_case as bsdf_case, light_case as light_case, warp_case as warp_case
from .chi_square import (
    Case as Case,
    chi_square_suite as chi_square_suite,
    chi_square_test as chi_square_test,
)
from .emitter_records import EmitterRecord as EmitterRecord, visible as visible
from .hierarchical import EnvironmentWarp as EnvironmentWarp, HierarchicalWarp as HierarchicalWarp
from .patches import Quad as Quad, Triangle as Triangle
from .points import (
    POINT_SETS as POINT_SETS,
    grid as grid,
    independent as independent,
    point_set as point_set,
    stratified as stratified,
)
from .scene_emitters import emitters_of as emitters_of
from .shapes import SurfaceGroup as SurfaceGroup
from .spheres import Sphere as Sphere
from .table import WARPS as WARPS, Warp as Warp
from .triangles_and_caps import (
    sample_sphere_cap as sample_sphere_cap,
    sample_sphere_cap_pdf as sample_sphere_cap_pdf,
    sample_triangle as sample_triangle,
    sample_triangle_pdf as sample_triangle_pdf,
)
from .verdicts import Moment as Moment, SuiteVerdict as SuiteVerdict, Verdict as Verdict
from .warps import (
    square_to_beckmann as square_to_beckmann,
    square_to_beckmann_pdf as square_to_beckmann_pdf,
    square_to_cosine_hemisphere as square_to_cosine_hemisphere,
    square_to_cosine_hemisphere_pdf as square_to_cosine_hemisphere_pdf,
    square_to_tent as square_to_tent,
    square_to_tent_pdf as square_to_tent_pdf,
    square_to_uniform_disk as square_to_uniform_disk,
    square_to_uniform_disk_pdf as square_to_uniform_disk_pdf,
    square_to_uniform_hemisphere as square_to_uniform_hemisphere,
    square_to_uniform_hemisphere_pdf as square_to_uniform_hemisphere_pdf,
    square_to_uniform_sphere as square_to_uniform_sphere,
    square_to_uniform_sphere_pdf as square_to_uniform_sphere_pdf,
)
