from . import (
    analysis as analysis,
)
from . import (
    course as course,
)
from . import (
    films as films,
)
from . import (
    integrators as integrators,
)
from . import (
    io as io,
)
from . import (
    nlos as nlos,
)
from . import (
    paths as paths,
)
from . import (
    samplers as samplers,
)
from . import (
    sampling as sampling,
)
from . import (
    scenes as scenes,
)
from . import (
    signals as signals,
)
from . import (
    vis as vis,
)
from .analysis import (
    four_bucket as four_bucket,
)
from .analysis import (
    from_four_bucket as from_four_bucket,
)
from .analysis import (
    multipath_error as multipath_error,
)
from .analysis import (
    sum_channels as sum_channels,
)
from .analysis import (
    transient_to_phasor as transient_to_phasor,
)
from .analysis import (
    true_depth as true_depth,
)
from .analysis import (
    unambiguous_range as unambiguous_range,
)
from .analysis import (
    unwrap as unwrap,
)
from .films.phasor import PhasorHDRFilm as PhasorHDRFilm
from .films.transient import TransientHDRFilm as TransientHDRFilm
from .integrators.amcw import (
    AMCWTransientPath as AMCWTransientPath,
)
from .integrators.amcw import (
    render_amcw_phasor as render_amcw_phasor,
)
from .integrators.amcw import (
    render_single_amcw as render_single_amcw,
)
from .integrators.ao import AmbientOcclusion as AmbientOcclusion
from .integrators.path_tracer_mats import PathTracerMats as PathTracerMats
from .integrators.path_tracer_mis import PathTracerMIS as PathTracerMIS
from .integrators.path_tracer_nee import PathTracerNEE as PathTracerNEE
from .integrators.simple import Simple as Simple
from .integrators.time_gated import (
    TimeGatedTransientPath as TimeGatedTransientPath,
)
from .integrators.time_gated import (
    render_at_time as render_at_time,
)
from .integrators.time_gated import (
    render_transient as render_transient,
)
from .integrators.transient_path import TransientPath as TransientPath
from .io import (
    load_capture as load_capture,
)
from .io import (
    load_exr_stack as load_exr_stack,
)
from .io import (
    load_npz as load_npz,
)
from .io import (
    save_capture as save_capture,
)
from .io import (
    save_exr_stack as save_exr_stack,
)
from .io import (
    save_npz as save_npz,
)
from .io import (
    save_png_frames as save_png_frames,
)
from .io import (
    save_video as save_video,
)
from .nlos import (
    capture as capture,
)
from .nlos import (
    depth_error as depth_error,
)
from .nlos import (
    depth_map as depth_map,
)
from .nlos import (
    focus_laser as focus_laser,
)
from .nlos import (
    hidden_depth as hidden_depth,
)
from .nlos import (
    make_capture as make_capture,
)
from .nlos import (
    max_projection as max_projection,
)
from .nlos import (
    reconstruct as reconstruct,
)
from .nlos.device.capture_meter import NLOSCaptureMeter as NLOSCaptureMeter
from .nlos.device.projector import ConfocalProjector as ConfocalProjector
from .nlos.device.relay_wall import (
    find_relay_wall as find_relay_wall,
)
from .nlos.device.relay_wall import (
    is_on_relay_wall as is_on_relay_wall,
)
from .nlos.device.retroreflector import Retroreflector as Retroreflector
from .nlos.light.confocal import ConfocalTransientIntegrator as ConfocalTransientIntegrator
from .nlos.light.transient_nlos import TransientNLOSPath as TransientNLOSPath
from .paths.endpoints import (
    ConnectionsOnly as ConnectionsOnly,
)
from .paths.endpoints import (
    EmitterHits as EmitterHits,
)
from .paths.endpoints import (
    GatedLights as GatedLights,
)
from .paths.endpoints import (
    OneSampleLights as OneSampleLights,
)
from .paths.endpoints import (
    OpenSky as OpenSky,
)
from .paths.endpoints import (
    PointSource as PointSource,
)
from .paths.endpoints import (
    SceneLights as SceneLights,
)
from .rendering.renderer import render as render
from .runtime import backend as backend
from .runtime import doctor as doctor
from .samplers.padded_sobol import PaddedSobolSampler as PaddedSobolSampler
from .scenes import (
    bust_ao as bust_ao,
)
from .scenes import (
    bust_simple as bust_simple,
)
from .scenes import (
    cornell_box as cornell_box,
)
from .scenes import (
    cornell_box_flash as cornell_box_flash,
)
from .scenes import (
    cornell_box_glass as cornell_box_glass,
)
from .scenes import (
    cornell_box_mirror as cornell_box_mirror,
)
from .scenes import (
    cornell_box_steady_state as cornell_box_steady_state,
)
from .scenes import (
    nlos_bunny as nlos_bunny,
)
from .scenes import (
    nlos_patch as nlos_patch,
)
from .scenes import (
    nlos_plane as nlos_plane,
)
from .scenes import (
    nlos_z as nlos_z,
)
from .scenes import (
    ourbox_confocal as ourbox_confocal,
)
from .scenes import (
    rectangle_light_quad as rectangle_light_quad,
)
from .scenes import (
    rectangle_light_triangles as rectangle_light_triangles,
)
from .scenes import (
    small_box as small_box,
)
from .scenes import (
    sphere_light_large as sphere_light_large,
)
from .scenes import (
    sphere_light_medium as sphere_light_medium,
)
from .scenes import (
    sphere_light_small as sphere_light_small,
)
from .scenes import (
    veach as veach,
)
from .scenes import (
    wall_box_behind as wall_box_behind,
)
from .scenes import (
    wall_box_hi_nlos as wall_box_hi_nlos,
)
from .scenes import (
    wall_box_sphere_nlos as wall_box_sphere_nlos,
)
from .scenes import (
    wall_box_spheres_nlos as wall_box_spheres_nlos,
)
from .scenes.loading import load_scene as load_scene
from .signals.modulations import (
    AMCWPulse as AMCWPulse,
)
from .signals.modulations import (
    HamiltonianCode as HamiltonianCode,
)
from .signals.modulations import (
    MSequence as MSequence,
)
from .signals.modulations import (
    SquareWave as SquareWave,
)
from .signals.phasors import phasor_parts as phasor_parts
from .signals.pulses import (
    BoxPulse as BoxPulse,
)
from .signals.pulses import (
    GaussianPulse as GaussianPulse,
)
from .signals.pulses import (
    SampledPulse as SampledPulse,
)
from .signals.units import (
    SPEED_OF_LIGHT as SPEED_OF_LIGHT,
)
from .signals.units import (
    ns_to_opl as ns_to_opl,
)
from .signals.units import (
    opl_to_ns as opl_to_ns,
)
from .vis import (
    light_in_flight as light_in_flight,
)
from .vis import (
    phasor_panel as phasor_panel,
)
from .vis import (
    plan_figure as plan_figure,
)
from .vis import (
    plot_pixel_transient as plot_pixel_transient,
)
from .vis import (
    reconstruction_figure as reconstruction_figure,
)
from .vis import (
    summary_figure as summary_figure,
)
from .vis import (
    tonemap as tonemap,
)
from .vis import (
    unwarp_camera as unwarp_camera,
)
from .vis import (
    visualize_transient as visualize_transient,
)

__version__: str
