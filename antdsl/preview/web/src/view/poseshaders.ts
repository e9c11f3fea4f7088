// How agents are posed: one pixel for each bone of each agent, which is the matrix that its vertices go by. What is played is
// blended joint by joint as antdsl/bodies/agents/machine_clips.py says: the two clips of a machine to their mean, and each
// machine over those before it. All rotations go by normalised linear interpolation on the shorter way.

import { TEXELS } from "./plays";
import { WIDE } from "./rig";

export const POSE_VERTEX = /* glsl */ `
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;

export const POSE_FRAGMENT = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
layout(location = 0) out vec4 first;
layout(location = 1) out vec4 second;
layout(location = 2) out vec4 third;
uniform sampler2D samples;
uniform sampler2D table;
uniform sampler2D bones;
uniform sampler2D plays;
uniform int joints;
uniform int texels;
uniform int boneCount;
uniform int machines;
uniform int clips;
uniform int groups;
uniform int perRow;
uniform int count;
uniform float t;
uniform mat3 base;

struct Joint { vec3 move; vec4 turn; vec3 scale; vec3 shear; };

vec4 at(sampler2D list, int number) { return texelFetch(list, ivec2(number % ${WIDE}, number / ${WIDE}), 0); }
vec4 unit(vec4 q) { float square = dot(q, q); return square > 0.0 ? q * inversesqrt(square) : vec4(0.0, 0.0, 0.0, 1.0); }

Joint sampled(int row, int joint) {
  int k = (row * joints + joint) * texels;
  Joint made = Joint(at(samples, k).xyz, at(samples, k + 1), vec3(1.0), vec3(0.0));
  if (texels > 2) made.scale = at(samples, k + 2).xyz;
  if (texels > 3) made.shear = at(samples, k + 3).xyz;
  return made;
}

Joint between(Joint a, Joint b, float share) {
  return Joint(mix(a.move, b.move, share), unit(mix(a.turn, b.turn, share)), mix(a.scale, b.scale, share), mix(a.shear, b.shear, share));
}

Joint played(vec4 clip, float turn, int joint) {
  float last = clip.y - 1.0;
  float moment = (clip.z > 0.5 ? fract(turn) : clamp(turn, 0.0, 1.0)) * last;
  float whole = min(floor(moment), max(last - 1.0, 0.0));
  int row = int(clip.x + whole + 0.5);
  return between(sampled(row, joint), sampled(min(row + 1, int(clip.x + last + 0.5)), joint), moment - whole);
}

/** How much of a clip there is at a joint. */
float share(vec4 clip, float weight, int joint) {
  return clip.x < 0.0 || weight <= 0.0 ? 0.0 : weight * at(table, groups + int(clip.w + 0.5) * joints + joint).x;
}

vec4 clipOf(float number) { return number > 65534.5 ? vec4(-1.0, 1.0, 0.0, 0.0) : at(table, clips + int(number + 0.5)); }

void add(inout Joint sum, Joint more, float part) {
  sum.move += more.move * part;
  sum.scale += more.scale * part;
  sum.shear += more.shear * part;
  sum.turn += more.turn * (dot(sum.turn, more.turn) < 0.0 ? -part : part);
}

Joint blended(int agent, int joint) {
  Joint pose = sampled(0, joint);
  pose.turn = unit(pose.turn);
  for (int machine = 0; machine < machines; machine++) {
    int k = (agent * machines + machine) * ${TEXELS};
    vec4 a = at(plays, k), b = at(plays, k + 1), c = at(plays, k + 2);
    vec4 clip = clipOf(a.x), before = clipOf(a.y);
    float clipShare = share(clip, mix(b.z, b.w, t), joint), beforeShare = share(before, mix(c.x, c.y, t), joint);
    float total = clipShare + beforeShare;
    if (total < 1e-6) continue;
    Joint mean = Joint(vec3(0.0), vec4(0.0), vec3(0.0), vec3(0.0));
    if (beforeShare > 0.0) add(mean, played(before, mix(b.x, b.y, t), joint), beforeShare / total);
    if (clipShare > 0.0) add(mean, played(clip, mix(a.z, a.w, t), joint), clipShare / total);
    mean.turn = unit(mean.turn);
    float over = min(total, 1.0);
    Joint sum = Joint(pose.move * (1.0 - over), pose.turn * (1.0 - over), pose.scale * (1.0 - over), pose.shear * (1.0 - over));
    add(sum, mean, over);
    sum.turn = unit(sum.turn);
    pose = sum;
  }
  return pose;
}

mat4 local(Joint of) {
  vec4 q = of.turn;
  mat3 turn = mat3(
    1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y),
    2.0 * (q.x * q.y - q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z + q.w * q.x),
    2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y));
  vec3 x = turn[0], y = turn[1] + turn[0] * of.shear.x, z = turn[2] + turn[0] * of.shear.y + turn[1] * of.shear.z;
  return mat4(vec4(x * of.scale.x, 0.0), vec4(y * of.scale.y, 0.0), vec4(z * of.scale.z, 0.0), vec4(of.move, 1.0));
}

void main() {
  ivec2 here = ivec2(gl_FragCoord.xy);
  int agent = here.y * perRow + here.x / boneCount;
  if (here.x >= perRow * boneCount || agent >= count) discard;
  int bone = 4 * (here.x % boneCount);
  mat4 made = transpose(mat4(at(bones, bone + 1), at(bones, bone + 2), at(bones, bone + 3), vec4(0.0, 0.0, 0.0, 1.0)));
  int joint = int(round(at(bones, bone).x));
  for (int depth = 0; depth < 256 && joint >= 0; depth++) {
    made = local(blended(agent, joint)) * made;
    joint = int(round(at(table, joint).x));
  }
  mat4 whole = transpose(mat4(base) * made);
  first = whole[0];
  second = whole[1];
  third = whole[2];
}`;
