"""Blur of pictures by lens and shutter: combines layers of static surfaces and moving bodies to one picture.

`shutter` and `motion_blur` spread samples along their motion while the shutter is open. `depth_of_field` then spreads them over
discs. `spreading` contains the loops of both."""
