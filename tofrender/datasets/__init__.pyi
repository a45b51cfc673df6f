from .dataset_config import Config as Config, read_config as read_config
from .layout import DatasetPlan as DatasetPlan
from .making import make_dataset as make_dataset, plan_dataset as plan_dataset
from .record_access import (
    capture_of as capture_of,
    load_dataset as load_dataset,
    render_of as render_of,
)
