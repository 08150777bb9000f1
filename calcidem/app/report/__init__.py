"""What a campaign says, for people: a page, a folder of figures and tables, and a closer look at one sample."""

from calcidem.app.report.folder import analyse
from calcidem.app.report.one_cell import show_cell
from calcidem.app.report.page import write_report

__all__ = ["analyse", "show_cell", "write_report"]
