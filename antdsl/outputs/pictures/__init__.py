"""Pictures of a frame: their content (`Picture`), the view (`Camera`), the ray renderer (`Renderer`), sheets and films."""

from antdsl.outputs.pictures.cameras import camera_at_eye_level, camera_over
from antdsl.outputs.pictures.image_files import check_film_support, still, write_film
from antdsl.outputs.pictures.legend import contact_sheet, strip_width, with_strip
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
    "camera_at_eye_level",
    "camera_over",
    "check_film_support",
    "contact_sheet",
    "render_frame",
    "still",
    "strip_width",
    "with_strip",
    "write_film",
]
