from .cases import (
    Case as Case,
)
from .cases import (
    SuiteVerdict as SuiteVerdict,
)
from .cases import (
    bsdf_case as bsdf_case,
)
from .cases import (
    chi_square_suite as chi_square_suite,
)
from .cases import (
    light_case as light_case,
)
from .cases import (
    warp_case as warp_case,
)
from .chi_square import chi_square_test as chi_square_test
from .hierarchical import EnvironmentWarp as EnvironmentWarp
from .hierarchical import HierarchicalWarp as HierarchicalWarp
from .points import (
    POINT_SETS as POINT_SETS,
)
from .points import (
    grid as grid,
)
from .points import (
    independent as independent,
)
from .points import (
    point_set as point_set,
)
from .points import (
    stratified as stratified,
)
from .scene_emitters import emitters_of as emitters_of
from .shapes import (
    EmitterRecord as EmitterRecord,
)
from .shapes import (
    Quad as Quad,
)
from .shapes import (
    Sphere as Sphere,
)
from .shapes import (
    SurfaceGroup as SurfaceGroup,
)
from .shapes import (
    Triangle as Triangle,
)
from .shapes import (
    sample_sphere_cap as sample_sphere_cap,
)
from .shapes import (
    sample_sphere_cap_pdf as sample_sphere_cap_pdf,
)
from .shapes import (
    sample_triangle as sample_triangle,
)
from .shapes import (
    sample_triangle_pdf as sample_triangle_pdf,
)
from .shapes import (
    visible as visible,
)
from .verdicts import Moment as Moment
from .verdicts import Verdict as Verdict
from .warps import (
    WARPS as WARPS,
)
from .warps import (
    Warp as Warp,
)
from .warps import (
    square_to_beckmann as square_to_beckmann,
)
from .warps import (
    square_to_beckmann_pdf as square_to_beckmann_pdf,
)
from .warps import (
    square_to_cosine_hemisphere as square_to_cosine_hemisphere,
)
from .warps import (
    square_to_cosine_hemisphere_pdf as square_to_cosine_hemisphere_pdf,
)
from .warps import (
    square_to_tent as square_to_tent,
)
from .warps import (
    square_to_tent_pdf as square_to_tent_pdf,
)
from .warps import (
    square_to_uniform_disk as square_to_uniform_disk,
)
from .warps import (
    square_to_uniform_disk_pdf as square_to_uniform_disk_pdf,
)
from .warps import (
    square_to_uniform_hemisphere as square_to_uniform_hemisphere,
)
from .warps import (
    square_to_uniform_hemisphere_pdf as square_to_uniform_hemisphere_pdf,
)
from .warps import (
    square_to_uniform_sphere as square_to_uniform_sphere,
)
from .warps import (
    square_to_uniform_sphere_pdf as square_to_uniform_sphere_pdf,
)
