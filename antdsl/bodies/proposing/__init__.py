"""Proposes the properties of a body that a model's file lacks: legs, gaits, axes, units, clip speeds, the idle clip and the
capsule.

Input: a definition as read from glTF or USD. Output: a definition file to correct by hand, with a reason for each guess. Order:

1. `joint_motion`: joints and points in the standing pose, and joints over the samples of clips.
2. `leg_search`: chains of joints from the trunk to the ground. They are found first, because feet show what a clip does.
3. `clip_gaits`: clips in which feet on the ground move backward. They reveal speed, stride, phases and the front axis.
4. `study`: all these measurements for one body.
5. `proposal`: all other properties, and the text of the file."""
