from .explorer.page import report as report
from .explorer.widget import explore as explore
