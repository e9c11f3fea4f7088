"""Proposes the properties of a body that a model's file lacks: legs, gaits, axes, units, clip speeds, the idle clip and the
capsule.

Input: a definition as read from glTF or USD. Output: a definition file to correct by hand, with a reason for each guess. Order:

1. `joint_motion`: joints and points in the standing pose, and joints over the samples of clips.
2. `leg_search`: chains of joints from the trunk to the ground. Clips are judged by the feet, so legs come first.
3. `clip_gaits`: clips in which feet move backward on the ground. They give speed, stride, phases and the front.
4. `study`: all of these for one body.
5. `proposal`: all other properties, and the text of the file."""
