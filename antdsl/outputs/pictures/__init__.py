"""Pictures of a frame: their content (`Picture`), the view (`Camera`), the renderer (`Renderer`), sheets of pictures, and
films."""

from antdsl.outputs.pictures.cameras import make_eye_level_camera, make_overview_camera
from antdsl.outputs.pictures.image_files import check_film_support, write_film, write_still
from antdsl.outputs.pictures.legend import add_legend, compute_legend_width, make_contact_sheet
from antdsl.outputs.pictures.model import Camera, Crowd, Item, LegendRow, Picture, Solid, Trail
from antdsl.outputs.pictures.render import DISPLAY_OPTIONS, Renderer, render_frame

__all__ = [
    "DISPLAY_OPTIONS",
    "Camera",
    "Crowd",
    "Item",
    "LegendRow",
    "Picture",
    "Renderer",
    "Solid",
    "Trail",
    "add_legend",
    "check_film_support",
    "compute_legend_width",
    "make_contact_sheet",
    "make_eye_level_camera",
    "make_overview_camera",
    "render_frame",
    "write_film",
    "write_still",
]
