"""Blur of pictures: layers of static surfaces and moving bodies → one picture, as a lens and a shutter see it.

`shutter` and `motion_blur` spread samples along their motion while the shutter is open. `depth_of_field` then spreads them over
discs. `spreading` has the loops of both."""
