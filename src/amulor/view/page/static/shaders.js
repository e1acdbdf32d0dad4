// Programs of the graphics card: map of a layer, and places and colors of pixels in space.

const HEADER = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
`;

// Beams interpolated between the nodes of a coarse grid, and shaded points.
const POINTS = `
uniform sampler2D uRange;    // slant range of every pixel
uniform sampler2D uSmooth;   // ranges averaged over neighbors, for the light only
uniform sampler2D uSteps;    // 1: step to the next column, 2: to the next row, 4: off the surface, 8: in a triangle
uniform sampler2D uBase;     // place at range zero, azimuth
uniform sampler2D uAim;      // direction, elevation
uniform sampler2D uRows;     // for every row: node before, share of the next
uniform sampler2D uColumns;
uniform ivec2 uSize;         // columns, rows
uniform bool uClipped;       // only what is inside the clip box is drawn
uniform vec3 uLow;
uniform vec3 uHigh;

bool clipped(vec3 p) { return uClipped && (any(lessThan(p, uLow)) || any(greaterThan(p, uHigh))); }

float rangeAt(sampler2D map, ivec2 at) { return texelFetch(map, at, 0).r; }

vec3 place(ivec2 at, float range) {
  vec2 r = texelFetch(uRows, ivec2(at.y, 0), 0).rg;
  vec2 c = texelFetch(uColumns, ivec2(at.x, 0), 0).rg;
  ivec2 n = ivec2(int(c.r), int(r.r));
  ivec2 last = textureSize(uBase, 0) - 1;
  ivec2 e = min(n + 1, last);
  vec3 base = mix(mix(texelFetch(uBase, n, 0).rgb, texelFetch(uBase, ivec2(e.x, n.y), 0).rgb, c.g),
                  mix(texelFetch(uBase, ivec2(n.x, e.y), 0).rgb, texelFetch(uBase, e, 0).rgb, c.g), r.g);
  vec3 aim = mix(mix(texelFetch(uAim, n, 0).rgb, texelFetch(uAim, ivec2(e.x, n.y), 0).rgb, c.g),
                 mix(texelFetch(uAim, ivec2(n.x, e.y), 0).rgb, texelFetch(uAim, e, 0).rgb, c.g), r.g);
  return base + range * aim;
}

bool bad(float value) { return !(value == value) || abs(value) > 1e30; }

bool steps(ivec2 at, int bit) { return (int(texelFetch(uSteps, at, 0).r + 0.5) & bit) != 0; }

// Surface normal towards the instrument, from the neighbors of the pixel.
vec3 normalAt(ivec2 at) {
  ivec2 low = max(at - 1, ivec2(0));
  ivec2 high = min(at + 1, uSize - 1);
  float own = rangeAt(uSmooth, at);
  float l = rangeAt(uSmooth, ivec2(low.x, at.y)), r = rangeAt(uSmooth, ivec2(high.x, at.y));
  float t = rangeAt(uSmooth, ivec2(at.x, low.y)), b = rangeAt(uSmooth, ivec2(at.x, high.y));
  ivec2 lp = ivec2(low.x, at.y), rp = ivec2(high.x, at.y);
  ivec2 tp = ivec2(at.x, low.y), bp = ivec2(at.x, high.y);
  if (bad(l) || steps(lp, 1)) { l = own; lp = at; }
  if (bad(r) || steps(at, 1)) { r = own; rp = at; }
  if (bad(t) || steps(tp, 2)) { t = own; tp = at; }
  if (bad(b) || steps(at, 2)) { b = own; bp = at; }
  vec3 n = cross(place(bp, b) - place(tp, t), place(rp, r) - place(lp, l));
  float size = length(n);
  vec3 aim = place(at, own + 0.1) - place(at, own);
  if (!(size > 0.0)) return -normalize(aim);
  n /= size;
  return dot(n, aim) > 0.0 ? -n : n;
}
`;

const COLOUR = `
uniform sampler2D uLayer;
uniform sampler2D uTable;
uniform vec2 uLimits;
uniform int uKind;            // 0 numbers, 1 flags, 2 numbers on a logarithmic scale
uniform vec3 uMissing;

bool absent(float v) { return !(v == v) || abs(v) > 1e30; }

vec3 coloured(float value) {
  if (uKind == 1) return texelFetch(uTable, ivec2(int(value + 0.5), 0), 0).rgb;
  if (absent(value)) return uMissing;
  float share = (value - uLimits.x) / max(uLimits.y - uLimits.x, 1e-30);
  return texelFetch(uTable, ivec2(int(clamp(share, 0.0, 1.0) * 255.0 + 0.5), 0), 0).rgb;
}
`;

const LIGHTING = `
uniform vec3 uLight;          // towards the light; zero for none
uniform float uRelief;        // by how much slopes are exaggerated

float lit(ivec2 at) {
  if (dot(uLight, uLight) < 0.5) return 1.0;
  vec3 n = normalAt(at);
  // Slopes relative to the view's direction are enhanced, as by raking light.
  vec3 flat0 = vec3(0.0, 0.0, -1.0);
  n = normalize(flat0 * dot(n, flat0) + uRelief * (n - flat0 * dot(n, flat0)));
  return clamp(0.28 + 0.92 * max(dot(n, uLight), 0.0), 0.0, 1.25);
}
`;

export const MAP = {
  vertex: `${HEADER}
void main() {
  vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1));
  gl_Position = vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}`,
  fragment: `${HEADER}${POINTS}${COLOUR}${LIGHTING}
uniform vec4 uView;           // column and row at the top left, columns and rows a pixel
uniform float uHeight;
uniform float uContour;       // distance of contour lines [m], 0 for none
uniform vec3 uGround;
out vec4 colour;

float band(ivec2 at) {
  float r = rangeAt(uSmooth, clamp(at, ivec2(0), uSize - 1));
  return bad(r) ? 1e9 : floor(place(clamp(at, ivec2(0), uSize - 1), r).z / uContour);
}

void main() {
  vec2 screen = vec2(gl_FragCoord.x, uHeight - gl_FragCoord.y);
  vec2 at = uView.xy + screen * uView.zw;
  ivec2 pixel = ivec2(floor(at));
  if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, uSize))) {
    colour = vec4(uGround, 1.0);
    return;
  }
  float value = texelFetch(uLayer, pixel, 0).r;
  vec3 c = coloured(value);
  bool there = !bad(rangeAt(uRange, pixel));
  if (there && uKind != 1) c *= lit(pixel);
  if (uContour > 0.0 && there) {
    float own = band(pixel);
    ivec2 right = ivec2(floor(at + vec2(uView.z * 1.4, 0.0)));
    ivec2 under = ivec2(floor(at + vec2(0.0, uView.w * 1.4)));
    float a = band(right), b = band(under);
    if ((a != own && a < 1e8) || (b != own && b < 1e8)) c = mix(c, vec3(0.02, 0.07, 0.1), 0.75);
  }
  if (uClipped && there && clipped(place(pixel, rangeAt(uRange, pixel)))) c = mix(c, uGround, 0.85);
  colour = vec4(c, 1.0);
}`,
};

/** Places and colors of the nodes of a grid of pixels, which do not depend on the camera. */
export const NODES = {
  captured: ["vPlace", "vColour"],
  vertex: `${HEADER}${POINTS}${COLOUR}${LIGHTING}
uniform int uStep;            // distance of nodes [pixel]
uniform int uAcross;          // nodes of a row
uniform bool uAveraged;       // nodes on the surface that the light falls on
out vec3 vPlace;
flat out uint vColour;

void main() {
  ivec2 at = min(ivec2(gl_VertexID % uAcross, gl_VertexID / uAcross) * uStep, uSize - 1);
  vPlace = place(at, uAveraged ? rangeAt(uSmooth, at) : rangeAt(uRange, at));
  vec3 shown = coloured(texelFetch(uLayer, at, 0).r);
  if (uKind != 1) shown *= lit(at);
  uvec3 bytes = uvec3(clamp(shown, 0.0, 1.0) * 255.0 + 0.5);
  vColour = bytes.r | (bytes.g << 8) | (bytes.b << 16) | (255u << 24);
  gl_Position = vec4(0.0);
  gl_PointSize = 1.0;
}`,
  fragment: `${HEADER}
out vec4 colour;
void main() { colour = vec4(0.0); }`,
};

/** Triangles and points between these nodes. */
export const SPACE = {
  vertex: `${HEADER}
layout(location = 0) in vec3 aPlace;
layout(location = 1) in vec4 aColour;
uniform mat4 uProject;
uniform float uDot;           // size of a point, times its distance if far ones shrink
uniform bool uShrinks;
uniform bool uPick;
out vec4 vColour;
out vec3 vPlace;

void main() {
  vPlace = aPlace;
  gl_Position = uProject * vec4(aPlace, 1.0);
  gl_PointSize = clamp(uShrinks ? uDot / max(gl_Position.w, 1e-6) : uDot, 1.4, 64.0);
  int id = gl_VertexID + 1;
  vColour = uPick ? vec4(ivec4(id, id >> 8, id >> 16, id >> 24) & 255) / 255.0 : aColour;
}`,
  fragment: `${HEADER}
uniform bool uClipped;
uniform vec3 uLow;
uniform vec3 uHigh;
in vec4 vColour;
in vec3 vPlace;
out vec4 colour;
void main() {
  if (uClipped && (any(lessThan(vPlace, uLow)) || any(greaterThan(vPlace, uHigh)))) discard;
  colour = vColour;
}`,
};
