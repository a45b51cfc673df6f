from . import (
    analysis as analysis,
    apps as apps,
    course as course,
    datasets as datasets,
    denoising as denoising,
    films as films,
    fitting as fitting,
    integrators as integrators,
    io as io,
    motion as motion,
    nlos as nlos,
    paths as paths,
    samplers as samplers,
    sampling as sampling,
    scanning as scanning,
    scenes as scenes,
    sensors as sensors,
    signals as signals,
    vis as vis,
)
from .analysis import (
    angle_of_linear_polarization as angle_of_linear_polarization,
    degree_of_circular_polarization as degree_of_circular_polarization,
    degree_of_linear_polarization as degree_of_linear_polarization,
    degree_of_polarization as degree_of_polarization,
    four_bucket as four_bucket,
    from_four_bucket as from_four_bucket,
    multipath_error as multipath_error,
    rebin as rebin,
    sum_channels as sum_channels,
    transient_to_phasor as transient_to_phasor,
    true_depth as true_depth,
    true_normals as true_normals,
    unambiguous_range as unambiguous_range,
    unwrap as unwrap,
)
from .apps import explore as explore, report as report
from .apps.warptest import warptest as warptest
from .datasets import load_dataset as load_dataset, make_dataset as make_dataset
from .denoising import denoise_film as denoise_film
from .films.phasor import PhasorHDRFilm as PhasorHDRFilm
from .films.transient import TransientHDRFilm as TransientHDRFilm
from .fitting import (
    Fit as Fit,
    fit as fit,
    l2_loss as l2_loss,
    phase_loss as phase_loss,
    phasor_loss as phasor_loss,
    scale_free_loss as scale_free_loss,
    wasserstein_loss as wasserstein_loss,
)
from .integrators.amcw import (
    AMCWTransientPath as AMCWTransientPath,
    render_amcw_phasor as render_amcw_phasor,
    render_single_amcw as render_single_amcw,
)
from .integrators.ao import AmbientOcclusion as AmbientOcclusion
from .integrators.bdpt import TransientBDPT as TransientBDPT
from .integrators.differentiable import VisibilityWarning as VisibilityWarning
from .integrators.light_tracer import TransientLightTracer as TransientLightTracer
from .integrators.one_sample import OneSampleLights as OneSampleLights
from .integrators.outside_lights import OpenSky as OpenSky, PointSource as PointSource
from .integrators.path_tracer_mats import PathTracerMats as PathTracerMats
from .integrators.path_tracer_mis import PathTracerMIS as PathTracerMIS
from .integrators.path_tracer_nee import PathTracerNEE as PathTracerNEE
from .integrators.simple import Simple as Simple
from .integrators.time_gated import (
    TimeGatedTransientPath as TimeGatedTransientPath,
    render_at_time as render_at_time,
    render_transient as render_transient,
)
from .integrators.transient_path import TransientPath as TransientPath
from .integrators.transient_volpath import TransientVolpath as TransientVolpath
from .io import (
    load_capture as load_capture,
    load_exr_stack as load_exr_stack,
    load_npz as load_npz,
    save_capture as save_capture,
    save_exr_stack as save_exr_stack,
    save_matlab_capture as save_matlab_capture,
    save_npz as save_npz,
    save_png_frames as save_png_frames,
    save_point_cloud as save_point_cloud,
    save_video as save_video,
)
from .motion import (
    Fmcw as Fmcw,
    doppler as doppler,
    doppler_rate as doppler_rate,
    range_rate as range_rate,
    render_frames as render_frames,
)
from .nlos import (
    capture as capture,
    depth_error as depth_error,
    depth_map as depth_map,
    focus_laser as focus_laser,
    hidden_depth as hidden_depth,
    make_capture as make_capture,
    max_projection as max_projection,
    reconstruct as reconstruct,
)
from .nlos.device.capture_meter import NLOSCaptureMeter as NLOSCaptureMeter
from .nlos.device.projector import ConfocalProjector as ConfocalProjector
from .nlos.device.relay_wall import (
    find_relay_wall as find_relay_wall,
    is_on_relay_wall as is_on_relay_wall,
)
from .nlos.device.retroreflector import Retroreflector as Retroreflector
from .nlos.light.confocal import ConfocalTransientIntegrator as ConfocalTransientIntegrator
from .nlos.light.transient_nlos import TransientNLOSPath as TransientNLOSPath
from .paths.endpoints import (
    ConnectionsOnly as ConnectionsOnly,
    EmitterHits as EmitterHits,
    GatedLights as GatedLights,
    SceneLights as SceneLights,
)
from .rendering.denoised import denoise as denoise
from .rendering.films_on_disk import load_zarr as load_zarr
from .rendering.merging import merge as merge
from .rendering.path_list import paths_of as paths_of
from .rendering.renderer import render as render
from .rendering.stored_film import save_zarr as save_zarr
from .rendering.strategies import strategy_pyramid as strategy_pyramid
from .rendering.workers import local_workers as local_workers
from .runtime import backend as backend, doctor as doctor
from .runtime.canvas import figure_style as figure_style, save_figure as save_figure
from .runtime.checkpoints import Checkpoint as Checkpoint
from .samplers.padded_sobol import PaddedSobolSampler as PaddedSobolSampler
from .scanning import (
    lidar as lidar,
    point_cloud as point_cloud,
    scan_pattern as scan_pattern,
    true_points as true_points,
)
from .scenes import (
    brewster_window as brewster_window,
    bust_ao as bust_ao,
    bust_simple as bust_simple,
    caustic as caustic,
    cornell_box as cornell_box,
    cornell_box_flash as cornell_box_flash,
    cornell_box_fog as cornell_box_fog,
    cornell_box_glass as cornell_box_glass,
    cornell_box_mirror as cornell_box_mirror,
    cornell_box_steady_state as cornell_box_steady_state,
    corridor as corridor,
    fan as fan,
    headlight_in_fog as headlight_in_fog,
    lamp_in_fixture as lamp_in_fixture,
    lamp_in_milk as lamp_in_milk,
    light_through_hole as light_through_hole,
    mirror_and_glass as mirror_and_glass,
    moving_mirror as moving_mirror,
    nlos_behind_fog as nlos_behind_fog,
    nlos_bunny as nlos_bunny,
    nlos_patch as nlos_patch,
    nlos_plane as nlos_plane,
    nlos_z as nlos_z,
    ourbox_confocal as ourbox_confocal,
    rectangle_light_quad as rectangle_light_quad,
    rectangle_light_triangles as rectangle_light_triangles,
    small_box as small_box,
    smoke_corridor as smoke_corridor,
    sphere_light_large as sphere_light_large,
    sphere_light_medium as sphere_light_medium,
    sphere_light_small as sphere_light_small,
    strained_mirror_corridor as strained_mirror_corridor,
    veach as veach,
    wall_box_behind as wall_box_behind,
    wall_box_hi_nlos as wall_box_hi_nlos,
    wall_box_sphere_nlos as wall_box_sphere_nlos,
    wall_box_spheres_nlos as wall_box_spheres_nlos,
)
from .scenes.angular_area import AngularArea as AngularArea
from .scenes.loading import load_scene as load_scene
from .scenes.motion import (
    Motion as Motion,
    motions_of as motions_of,
    moving as moving,
    posed as posed,
)
from .signals.modulations import (
    AMCWPulse as AMCWPulse,
    HamiltonianCode as HamiltonianCode,
    MSequence as MSequence,
    SquareWave as SquareWave,
)
from .signals.phasors import phasor_parts as phasor_parts
from .signals.pulses import (
    BoxPulse as BoxPulse,
    GaussianPulse as GaussianPulse,
    KnotPulse as KnotPulse,
    SampledPulse as SampledPulse,
)
from .signals.units import (
    SPEED_OF_LIGHT as SPEED_OF_LIGHT,
    ns_to_opl as ns_to_opl,
    opl_to_ns as opl_to_ns,
)
from .vis import (
    gate_figure as gate_figure,
    light_in_flight as light_in_flight,
    phasor_panel as phasor_panel,
    plan_figure as plan_figure,
    plot_pixel_transient as plot_pixel_transient,
    polarization_figure as polarization_figure,
    polarization_picture as polarization_picture,
    pyramid_figure as pyramid_figure,
    range_velocity_map as range_velocity_map,
    reconstruction_figure as reconstruction_figure,
    summary_figure as summary_figure,
    tonemap as tonemap,
    unwarp_camera as unwarp_camera,
    velocity_map as velocity_map,
    visualize_transient as visualize_transient,
)

__version__: str
