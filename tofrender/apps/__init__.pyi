from .explorer.single_page import report as report
from .explorer.widget import explore as explore
