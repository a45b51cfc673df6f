from ..runtime.atomic import replacing as replacing
from ..runtime.canvas import save_figure as save_figure
from .capture_files import load_capture as load_capture
from .exr import (
    load_exr_stack as load_exr_stack,
    save_exr_layers as save_exr_layers,
    save_exr_stack as save_exr_stack,
)
from .hdf5 import save_capture as save_capture
from .histogram_files import load_histograms as load_histograms, load_poses as load_poses
from .matlab_captures import save_matlab_capture as save_matlab_capture
from .npz import load_npz as load_npz, save_npz as save_npz
from .output import check_output as check_output, output_folder as output_folder
from .pictures import save_png_frames as save_png_frames, save_video as save_video
from .point_clouds import save_point_cloud as save_point_cloud
from .stl import load_stl as load_stl
