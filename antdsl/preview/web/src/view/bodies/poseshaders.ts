// The shaders that pose agents, pass by pass, one pixel for each joint, leg or bone of each agent:
// - joints: the clips, blended for each joint as in antdsl/bodies/agents/machine_clips.py: the mean of the clips of a machine,
// each machine over the ones before it, added clips over all. Rotations use normalised linear interpolation on the shorter arc;
// - legs: the positions of hip, knee and foot of each leg; then the bend of each leg that puts its foot on its stand, by two-bone
// inverse kinematics as in antdsl/bodies/agents/leg_ik.py;
// - soles: the position of the ankle of each leg and the directions across its arch and sole; then their rotations onto the ground;
// - bones: the matrices that move the vertices of a mesh.

import { STANCE } from "../herds/feet";
import { TEXELS } from "../herds/plays";
import { WIDE } from "./rig";

export const POSE_VERTEX = /* glsl */ `
void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;

const COMMON = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
layout(location = 0) out vec4 first;
layout(location = 1) out vec4 second;
layout(location = 2) out vec4 third;
uniform sampler2D table;
uniform int perRow;
uniform int count;
uniform int items;
uniform int joints;
uniform int legs;
uniform float t;
uniform mat3 base;
int agent;
int item;

vec4 at(sampler2D list, int number) { return texelFetch(list, ivec2(number % ${WIDE}, number / ${WIDE}), 0); }
vec4 unit(vec4 q) { float square = dot(q, q); return square > 0.0 ? q * inversesqrt(square) : vec4(0.0, 0.0, 0.0, 1.0); }
ivec2 place(int number, int many) { return ivec2((agent % perRow) * many + number, agent / perRow); }
bool outside() {
  ivec2 here = ivec2(gl_FragCoord.xy);
  agent = here.y * perRow + here.x / items;
  item = here.x % items;
  return here.x >= perRow * items || agent >= count;
}`;

export const JOINTS = /* glsl */ `
${COMMON}
layout(location = 3) out vec4 fourth;
uniform sampler2D samples;
uniform sampler2D plays;
uniform int texels;
uniform int machines;
uniform int clips;
uniform int groups;
uniform sampler2D gazes;
uniform int looks;
uniform int leans;
uniform int gazeTexels;

struct Joint { vec3 move; vec4 turn; vec3 scale; vec3 shear; };

Joint sampled(int row) {
  int k = (row * joints + item) * texels;
  Joint made = Joint(at(samples, k).xyz, at(samples, k + 1), vec3(1.0), vec3(0.0));
  if (texels > 2) made.scale = at(samples, k + 2).xyz;
  if (texels > 3) made.shear = at(samples, k + 3).xyz;
  return made;
}

Joint played(float start, float many, float far) {
  float moment = far * (many - 1.0);
  float whole = min(floor(moment), max(many - 2.0, 0.0));
  int row = int(start + whole + 0.5);
  Joint a = sampled(row), b = sampled(min(row + 1, int(start + many - 0.5)));
  float s = moment - whole;
  return Joint(mix(a.move, b.move, s), unit(mix(a.turn, b.turn, s)), mix(a.scale, b.scale, s), mix(a.shear, b.shear, s));
}

void add(inout Joint sum, Joint more, float part) {
  sum.move += more.move * part;
  sum.scale += more.scale * part;
  sum.shear += more.shear * part;
  sum.turn += more.turn * (dot(sum.turn, more.turn) < 0.0 ? -part : part);
}

/** Adds a part of a clip, less the share of other clips that replace it as the agent turns and climbs. */
void addClip(inout Joint sum, int number, float turn, float part) {
  int k = clips + 3 * number;
  vec4 clip = at(table, k), side = at(table, k + 1), slope = at(table, k + 2);
  float far = mod(clip.z, 2.0) > 0.5 ? fract(turn) : clamp(turn, 0.0, 1.0);
  vec4 share = vec4(0.0);
  if (leans > 0) {
    int here = 2 * (agent * gazeTexels + looks);
    vec2 lean = mix(at(gazes, here).xy, at(gazes, here + 1).xy, t);
    share = clamp(vec4(lean.x, -lean.x, lean.y, -lean.y), 0.0, 1.0);
    share *= vec4(greaterThanEqual(vec4(side.x, side.z, slope.x, slope.z), vec4(0.0)));
    share /= max(dot(share, vec4(1.0)), 1.0);
  }
  float rest = 1.0 - dot(share, vec4(1.0));
  if (rest > 0.0) add(sum, played(clip.x, clip.y, far), part * rest);
  if (share.x > 0.0) add(sum, played(side.x, side.y, far), part * share.x);
  if (share.y > 0.0) add(sum, played(side.z, side.w, far), part * share.y);
  if (share.z > 0.0) add(sum, played(slope.x, slope.y, far), part * share.z);
  if (share.w > 0.0) add(sum, played(slope.z, slope.w, far), part * share.w);
}

/** Returns the weight of a clip at the joint, among added clips or among the others. */
float share(float number, float weight, bool added) {
  if (number > 65534.5 || weight <= 0.0) return 0.0;
  vec4 clip = at(table, clips + 3 * int(number + 0.5));
  if (clip.x < 0.0 || (clip.z > 1.5) != added) return 0.0;
  return weight * at(table, groups + int(clip.w + 0.5) * joints + item).x;
}

/** Computes the mean of the clips of a machine at the joint, and their total weight. */
float mean(int machine, bool added, out Joint found) {
  int k = (agent * machines + machine) * ${TEXELS};
  vec4 number = at(plays, k), a = at(plays, k + 1), b = at(plays, k + 2), c = at(plays, k + 3);
  float own = share(number.x, mix(b.z, b.w, t), added);
  float before = share(number.y, mix(c.x, c.y, t), added);
  float earlier = share(number.z, mix(c.z, c.w, t), added);
  float total = own + before + earlier;
  found = Joint(vec3(0.0), vec4(0.0), vec3(0.0), vec3(0.0));
  if (total < 1e-6) return 0.0;
  if (earlier > 0.0) addClip(found, int(number.z + 0.5), mix(b.x, b.y, t), earlier / total);
  if (before > 0.0) addClip(found, int(number.y + 0.5), mix(a.z, a.w, t), before / total);
  if (own > 0.0) addClip(found, int(number.x + 0.5), mix(a.x, a.y, t), own / total);
  found.turn = unit(found.turn);
  return total;
}

vec4 times(vec4 a, vec4 b) { return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz)); }

void main() {
  if (outside()) discard;
  Joint rest = sampled(0);
  rest.turn = unit(rest.turn);
  Joint pose = rest, found;
  for (int machine = 0; machine < machines; machine++) {
    float over = min(mean(machine, false, found), 1.0);
    if (over <= 0.0) continue;
    Joint sum = Joint(pose.move * (1.0 - over), pose.turn * (1.0 - over), pose.scale * (1.0 - over), pose.shear * (1.0 - over));
    add(sum, found, over);
    sum.turn = unit(sum.turn);
    pose = sum;
  }
  for (int machine = 0; machine < machines; machine++) {
    float much = mean(machine, true, found);
    if (much <= 0.0) continue;
    pose.move += (found.move - rest.move) * much;
    vec4 turn = times(found.turn, vec4(-rest.turn.xyz, rest.turn.w));
    turn *= turn.w < 0.0 ? -much : much;
    turn.w += 1.0 - much;
    pose.turn = unit(times(unit(turn), pose.turn));
  }
  first = vec4(pose.move, 0.0);
  second = pose.turn;
  third = vec4(pose.scale, 0.0);
  fourth = vec4(pose.shear, 0.0);
}`;

const LOCAL = /* glsl */ `
uniform sampler2D moves;
uniform sampler2D turns;
uniform sampler2D scales;
uniform sampler2D shears;
uniform int texels;

int parent(int joint) { return int(round(at(table, joint).x)); }

mat4 local(int joint) {
  ivec2 here = place(joint, joints);
  vec4 q = texelFetch(turns, here, 0);
  vec3 x = vec3(1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y));
  vec3 y = vec3(2.0 * (q.x * q.y - q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z + q.w * q.x));
  vec3 z = cross(x, y);
  if (texels > 2) {
    vec3 scale = texelFetch(scales, here, 0).xyz;
    vec3 shear = texels > 3 ? texelFetch(shears, here, 0).xyz : vec3(0.0);
    z = (z + x * shear.y + y * shear.z) * scale.z;
    y = (y + x * shear.x) * scale.y;
    x *= scale.x;
  }
  return mat4(vec4(x, 0.0), vec4(y, 0.0), vec4(z, 0.0), vec4(texelFetch(moves, here, 0).xyz, 1.0));
}`;

/** Returns a trait: a number by which bodies differ. */
export const TRAIT = /* glsl */ `
float traitOf(sampler2D gazes, int row, int gazeTexels, int first, int number, float t) {
  int here = 2 * (row * gazeTexels + first + number / 3);
  vec4 a = texelFetch(gazes, ivec2(here % ${WIDE}, here / ${WIDE}), 0);
  vec4 b = texelFetch(gazes, ivec2((here + 1) % ${WIDE}, (here + 1) / ${WIDE}), 0);
  return mix(a[number % 3], b[number % 3], t);
}`;

/** Joints in the agent's space, rotated to its gaze and with the offsets of edits as in antdsl/bodies/agents/driving.py, and
 * scaled as in antdsl/bodies/agents/varied_bodies.py. */
const WORLD = /* glsl */ `
${TRAIT}
uniform sampler2D gazes;
uniform int looks;
uniform int leans;
uniform int gazeTexels;
uniform int lookAt;
uniform int targets;
uniform int sizes;
uniform int scaleAt;
uniform sampler2D offsets;
uniform int offsetJoints;
vec3 turned(vec4 q, vec3 v) { vec3 u = 2.0 * cross(q.xyz, v); return v + q.w * u + cross(q.xyz, u); }

mat4 turn(mat4 m, vec4 q, vec3 about) {
  return mat4(vec4(turned(q, m[0].xyz), 0.0), vec4(turned(q, m[1].xyz), 0.0), vec4(turned(q, m[2].xyz), 0.0),
    vec4(turned(q, m[3].xyz - about) + about, 1.0));
}

/** A joint without offsets, the offsets of the joint and of those above it, and the size of the joint. */
struct Posed { mat4 joint; mat4 moved; float size; };
mat4 placed(Posed posed) { return posed.moved * posed.joint; }

/** Adds the offsets of a joint, which turn about its position and move all joints below it. */
void displace(inout Posed posed, int joint) {
  float scale = length(vec3(base[0].x, base[1].x, base[2].x));
  for (int k = 0; k < offsetJoints; k++) {
    int here = 4 * (agent * offsetJoints + k);
    vec4 a = at(offsets, here), b = at(offsets, here + 1), c = at(offsets, here + 2), d = at(offsets, here + 3);
    if (int(round(a.w)) != joint) continue;
    vec4 q = unit(mix(b, dot(b, d) < 0.0 ? -d : d, t));
    posed.moved = turn(posed.moved, vec4((q.xyz * base) / scale, q.w), placed(posed)[3].xyz);
    posed.moved[3].xyz += (mix(a.xyz, c.xyz, t) * base) / (scale * scale) * posed.size;
  }
}

void follow(inout Posed posed, int joint) {
  mat4 m = posed.joint * local(joint);
  vec3 ahead = normalize(vec3(base[0].x, base[1].x, base[2].x));
  for (int k = 0; k < looks; k++) {
    float weight = at(table, lookAt + k * joints + joint).x;
    if (weight <= 0.0) continue;
    int here = 2 * (agent * gazeTexels + k);
    vec3 way = mix(at(gazes, here).xyz, at(gazes, here + 1).xyz, t) * base;
    way /= max(length(way), 1e-12);
    vec4 q = 1.0 + dot(ahead, way) < 1e-6 ? vec4(0.0, 0.0, 0.0, 1.0) : unit(vec4(cross(ahead, way), 1.0 + dot(ahead, way)));
    q = unit(mix(vec4(0.0, 0.0, 0.0, 1.0), q, weight));
    m = turn(m, q, m[3].xyz);
  }
  posed.joint = m;
  displace(posed, joint);
  for (int k = 0; k < sizes; k++) {
    float weight = at(table, scaleAt + k * joints + joint).x;
    if (weight == 0.0) continue;
    float size = 1.0 + weight * (traitOf(gazes, agent, gazeTexels, looks + leans, targets + k, t) - 1.0);
    m = mat4(vec4(m[0].xyz * size, 0.0), vec4(m[1].xyz * size, 0.0), vec4(m[2].xyz * size, 0.0), m[3]);
    posed.size *= size;
  }
  posed.joint = m;
}

int chain[64];
int above(int joint) {
  int found = 0;
  while (joint >= 0 && found < 64) {
    chain[found++] = joint;
    joint = parent(joint);
  }
  return found;
}`;

/** Texels of a leg in the table. */
const LEG = 5;

/** Hip, knee and foot of each leg in the clips. */
export const LEGS = /* glsl */ `
${COMMON}
${LOCAL}
${WORLD}
uniform int legAt;
void main() {
  if (outside()) discard;
  ivec3 leg = ivec3(round(at(table, legAt + ${LEG} * item).xyz));
  Posed posed = Posed(mat4(1.0), mat4(1.0), 1.0);
  for (int k = above(leg.z) - 1; k >= 0; k--) {
    follow(posed, chain[k]);
    if (chain[k] == leg.x) first = placed(posed)[3];
    if (chain[k] == leg.y) second = placed(posed)[3];
  }
  third = placed(posed)[3];
}`;

/** The ankle of each leg in the clips, and the directions of the standing body's up at the ankle and at the foot. */
export const SOLES = /* glsl */ `
${COMMON}
${LOCAL}
${WORLD}
uniform int legAt;
void main() {
  if (outside()) discard;
  int row = legAt + ${LEG} * item;
  ivec4 leg = ivec4(round(at(table, row)));
  Posed posed = Posed(mat4(1.0), mat4(1.0), 1.0);
  for (int k = above(leg.z) - 1; k >= 0; k--) {
    follow(posed, chain[k]);
    if (chain[k] != leg.w) continue;
    first = placed(posed)[3];
    second = vec4(normalize(mat3(placed(posed)) * at(table, row + 2).xyz), 0.0);
  }
  third = vec4(normalize(mat3(placed(posed)) * at(table, row + 3).xyz), 0.0);
}`;

const STANCES = /* glsl */ `
uniform sampler2D hips;
uniform sampler2D knees;
uniform sampler2D stances;
uniform int footTexels;
uniform float unitLength;
vec4 stance(int number) { return at(stances, agent * (footTexels * legs + ${STANCE}) + number); }
vec3 upward() { return vec3(base[0].y, base[1].y, base[2].y) * unitLength; }`;

const REACH = /* glsl */ `
uniform sampler2D feet;
uniform float straight;
uniform float folded;
uniform float sunk;
uniform float plane;
uniform float heel;
uniform int legAt;
uniform sampler2D ankles;
uniform sampler2D archUps;
uniform sampler2D soleUps;

vec3 turned(vec4 q, vec3 v) { vec3 u = 2.0 * cross(q.xyz, v); return v + q.w * u + cross(q.xyz, u); }
vec4 onto(vec3 a, vec3 b) { return unit(vec4(cross(a, b), max(1.0 + dot(a, b), 1e-6))); }
bool isFlat(int leg) { return footTexels > 2 && at(table, legAt + ${LEG} * leg + 1).w > 0.5; }
float stands() { vec4 s = stance(2); return mix(s.x, s.y, t); }
vec3 goal(int leg) {
  vec4 a = stance(${STANCE} + 2 * leg), b = stance(${STANCE} + 2 * leg + 1);
  return (mix(a.xyz, b.xyz, t) * base) * unitLength * unitLength;
}

/** Returns the direction across the sole of a leg. */
vec3 across(int leg) {
  vec4 a = stance(${STANCE} + 2 * legs + 2 * leg), b = stance(${STANCE} + 2 * legs + 2 * leg + 1);
  vec3 found = mix(a.xyz, b.xyz, t) * base;
  return length(found) > 0.0 ? normalize(found) : upward();
}

/** Returns how far a hip is too high for a leg of this length. \`way\`: from the hip to the end of the leg. */
float gap(vec3 way, float reach) {
  float high = dot(way, upward());
  return -sqrt(max(reach * reach - max(dot(way, way) - high * high, 0.0), 0.0)) - high;
}

/** Returns how far the body sinks so that standing feet are in reach. */
float sinks() {
  float most = 0.0;
  for (int leg = 0; leg < legs; leg++) {
    float stood = mix(stance(${STANCE} + 2 * leg).w, stance(${STANCE} + 2 * leg + 1).w, t);
    ivec2 here = place(leg, legs);
    vec3 hip = texelFetch(hips, here, 0).xyz, knee = texelFetch(knees, here, 0).xyz, foot = texelFetch(feet, here, 0).xyz;
    vec3 ankle = isFlat(leg) ? texelFetch(ankles, here, 0).xyz : foot;
    float bones = length(knee - hip) + length(ankle - knee);
    float reach = (bones + length(foot - ankle)) * straight;
    float least = clamp(gap(goal(leg) - hip, reach), 0.0, sunk * reach);
    if (isFlat(leg)) {
      vec3 level = at(table, legAt + ${LEG} * leg + 4).xyz;
      vec3 arch = turned(onto(upward(), across(leg)), level);
      float allowed = max(dot(level - arch, upward()), 0.0) + heel * bones;
      least = max(least, min(gap(goal(leg) + arch - hip, bones * straight), allowed));
    }
    most = max(most, stood * least);
  }
  return most * stands();
}`;

/** The rotations of arch and sole that lay a sole flat, and the vector from its foot to its ankle with them. */
const LAID = /* glsl */ `
struct Laid { vec4 arched; vec4 soled; vec3 arch; };
vec4 times(vec4 a, vec4 b) { return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz)); }

Laid laid(int leg, vec3 hip, vec3 knee, vec3 ankle, vec3 foot, vec3 to) {
  ivec2 here = place(leg, legs);
  vec3 normal = across(leg), arched = texelFetch(archUps, here, 0).xyz, soled = texelFetch(soleUps, here, 0).xyz;
  vec4 turn = onto(arched, normalize(mix(arched, normal, stands())));
  vec3 arch = turned(turn, ankle - foot), way = hip - to;
  float reach = (length(knee - hip) + length(ankle - knee)) * straight;
  float far = max(length(way), 1e-12), size = length(arch);
  vec3 towards = way / far, aside = arch - towards * dot(arch, towards);
  if (length(way - arch) > reach && length(aside) > 1e-6 * far) {
    float cosine = clamp((size * size + far * far - reach * reach) / max(2.0 * size * far, 1e-20), -1.0, 1.0);
    vec3 raised = towards * (size * cosine) + normalize(aside) * (size * sqrt(1.0 - cosine * cosine));
    turn = times(onto(arch / size, raised / size), turn);
    arch = raised;
  }
  return Laid(turn, onto(soled, normalize(mix(soled, normal, stands()))), arch);
}`;

/** The bend of each leg: rotation of the shank about the knee and of the leg about the hip, and displacement of the ankle. */
export const BENT = /* glsl */ `
${COMMON}
${STANCES}
${REACH}
${LAID}
void main() {
  if (outside()) discard;
  ivec2 here = place(item, legs);
  float sink = sinks();
  vec3 down = upward() * sink;
  vec3 hip = texelFetch(hips, here, 0).xyz - down, knee = texelFetch(knees, here, 0).xyz - down;
  vec3 foot = texelFetch(feet, here, 0).xyz - down;
  vec3 to = foot + (goal(item) - foot) * stands();
  if (isFlat(item)) {
    vec3 ankle = texelFetch(ankles, here, 0).xyz - down;
    to += laid(item, hip, knee, ankle, foot, to).arch;
    foot = ankle;
  }
  vec3 thigh = hip - knee, shank = foot - knee, way = to - hip;
  float a = max(length(thigh), 1e-6 * unitLength), b = max(length(shank), 1e-6 * unitLength);
  float far = clamp(length(way), abs(a - b) * folded, (a + b) * straight);
  float before = clamp(dot(thigh, shank) / (a * b), -1.0, 1.0);
  float now = clamp((a * a + b * b - far * far) / (2.0 * a * b), -1.0, 1.0);
  vec3 axis = cross(thigh, shank), rest = at(table, legAt + ${LEG} * item + 1).xyz;
  if (length(axis) <= plane * a * b) axis = rest - thigh * (dot(rest, thigh) / max(dot(thigh, thigh), 1e-20));
  axis /= max(length(axis), 1e-12);
  float sine = sqrt(1.0 - before * before), less = sqrt(1.0 - now * now);
  float cosine = sqrt(max(0.5 + 0.5 * (now * before + less * sine), 1e-12)); // of half the angle between the two
  second = unit(vec4(axis * (less * before - now * sine) / (2.0 * cosine), cosine));
  vec3 reached = knee + turned(second, shank) - hip;
  first = onto(reached / max(length(reached), 1e-12), way / max(length(way), 1e-12));
  third = vec4(hip + turned(first, reached) - foot, sink);
}`;

/** The arch and then the sole of each leg: rotation about the origin, and displacement after it. */
export const FLAT = /* glsl */ `
${COMMON}
${STANCES}
${REACH}
${LAID}
uniform sampler2D footMoves;

void main() {
  if (outside()) discard;
  int leg = item / 2;
  ivec2 here = place(leg, legs);
  vec4 moved = texelFetch(footMoves, here, 0);
  first = vec4(0.0, 0.0, 0.0, 1.0);
  second = vec4(moved.xyz, 0.0);
  if (!isFlat(leg)) return;
  vec3 down = upward() * moved.w;
  vec3 hip = texelFetch(hips, here, 0).xyz - down, knee = texelFetch(knees, here, 0).xyz - down;
  vec3 ankle = texelFetch(ankles, here, 0).xyz - down, foot = texelFetch(feet, here, 0).xyz - down;
  vec3 to = foot + (goal(leg) - foot) * stands();
  Laid sole = laid(leg, hip, knee, ankle, foot, to);
  vec3 end = ankle + moved.xyz;
  first = item % 2 == 0 ? sole.arched : sole.soled;
  second.xyz = item % 2 == 0 ? end - turned(first, ankle) : end - sole.arch - turned(first, foot);
}`;

export const BONES = /* glsl */ `
${COMMON}
${LOCAL}
${WORLD}
${STANCES}
uniform sampler2D bones;
uniform sampler2D legTurns;
uniform sampler2D kneeTurns;
uniform sampler2D footMoves;
uniform sampler2D soleTurns;
uniform sampler2D soleMoves;

/** Returns the matrix of a joint with bent legs. \`part\`: 0 outside legs, else 4 times the leg plus 1 thigh, 2 shank, 3 arch, 4
 * sole. */
mat4 standing(mat4 m, int part) {
  vec3 down = upward() * texelFetch(footMoves, place(0, legs), 0).w;
  m[3].xyz -= down;
  if (part == 0) return m;
  int leg = (part - 1) / 4, piece = (part - 1) % 4;
  ivec2 here = place(leg, legs);
  if (piece > 1) {
    if (footTexels > 2) {
      ivec2 sole = place(2 * leg + piece - 2, 2 * legs);
      m = turn(m, texelFetch(soleTurns, sole, 0), vec3(0.0));
      m[3].xyz += texelFetch(soleMoves, sole, 0).xyz;
    } else m[3].xyz += texelFetch(footMoves, here, 0).xyz;
    return m;
  }
  vec3 hip = texelFetch(hips, here, 0).xyz - down, knee = texelFetch(knees, here, 0).xyz - down;
  if (piece == 1) m = turn(m, texelFetch(kneeTurns, here, 0), knee);
  return turn(m, texelFetch(legTurns, here, 0), hip);
}

void main() {
  if (outside()) discard;
  int bone = 4 * item;
  vec4 own = at(bones, bone);
  Posed posed = Posed(mat4(1.0), mat4(1.0), 1.0);
  for (int k = above(int(round(own.x))) - 1; k >= 0; k--) follow(posed, chain[k]);
  mat4 made = placed(posed);
  bool stands = legs > 0 && own.x > -0.5;
  if (stands) made = standing(made, int(round(own.y)));
  made = mat4(base) * made * transpose(mat4(at(bones, bone + 1), at(bones, bone + 2), at(bones, bone + 3), vec4(0.0, 0.0, 0.0, 1.0)));
  if (stands) {
    vec4 a = stance(0), b = stance(1), now = mix(a, b, t);
    vec4 tilt = unit(vec4(now.yzw, sqrt(max(1.0 - dot(now.yzw, now.yzw), 0.0))));
    made = turn(made, tilt, vec3(0.0));
    made[3].y += now.x;
  }
  mat4 whole = transpose(made);
  first = whole[0];
  second = whole[1];
  third = whole[2];
}`;
