// Programs of the graphics card: map of a layer, and surface and points from ranges.

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

export const SURFACE = {
  vertex: `${HEADER}${POINTS}${COLOUR}${LIGHTING}
uniform mat4 uProject;
uniform int uStride;
uniform int uAcross;          // cells of a row at this stride
uniform bool uAveraged;       // vertices on the surface that the light falls on
out vec4 vColour;
out vec3 vPlace;

// Whether the surface steps between two pixels of a row (bit 1) or of a column (bit 2).
bool parted(ivec2 at, ivec2 end, int bit) {
  ivec2 way = ivec2(bit == 1 ? 1 : 0, bit == 2 ? 1 : 0);
  for (; at != end; at += way) if (steps(at, bit)) return true;
  return false;
}

bool usable(ivec2 at) { return !bad(rangeAt(uRange, at)) && !steps(at, 4); }

// As in geometry.js: two triangles per cell, along the better of its diagonals.
void main() {
  int cell = gl_VertexID / 6;
  int corner = gl_VertexID % 6;
  ivec2 a = ivec2(cell % uAcross, cell / uAcross) * uStride;
  ivec2 d = min(a + uStride, uSize - 1);
  ivec2 b = ivec2(d.x, a.y), c = ivec2(a.x, d.y);
  bool above = usable(a) && usable(b) && !parted(a, b, 1);
  bool below = usable(c) && usable(d) && !parted(c, d, 1);
  bool left = usable(a) && usable(c) && !parted(a, c, 2);
  bool right = usable(b) && usable(d) && !parted(b, d, 2);
  int rising = int(above && left) + int(below && right);
  int falling = int(above && right) + int(below && left);
  bool fall = falling > rising || (falling == rising &&
    abs(rangeAt(uRange, a) - rangeAt(uRange, d)) < abs(rangeAt(uRange, b) - rangeAt(uRange, c)));
  bool second = corner > 2;
  bool there = second ? below && (fall ? left : right) : above && (fall ? right : left);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  vColour = vec4(0.0);
  vPlace = vec3(0.0);
  if (!there) return;
  ivec2 first[3] = ivec2[3](a, b, fall ? d : c);
  ivec2 last[3] = ivec2[3](fall ? a : b, d, c);
  ivec2 at = second ? last[corner - 3] : first[corner];
  vPlace = place(at, uAveraged ? rangeAt(uSmooth, at) : rangeAt(uRange, at));
  gl_Position = uProject * vec4(vPlace, 1.0);
  vec3 shown = coloured(texelFetch(uLayer, at, 0).r);
  if (uKind != 1) shown *= lit(at);
  vColour = vec4(shown, 1.0);
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

export const CLOUD = {
  vertex: `${HEADER}${POINTS}${COLOUR}${LIGHTING}
uniform mat4 uProject;
uniform int uStride;
uniform int uAcross;          // points of a row at this stride
uniform float uDot;           // size of a point, times its distance if far ones shrink
uniform bool uShrinks;
uniform bool uPick;
uniform bool uAlone;          // only pixels that no triangle has
uniform bool uAveraged;       // points on the surface that the light falls on
flat out vec4 vColour;

void main() {
  int column = (gl_VertexID % uAcross) * uStride;
  int row = (gl_VertexID / uAcross) * uStride;
  ivec2 at = ivec2(column, row);
  float range = rangeAt(uRange, at);
  if (bad(range) || (uAlone && steps(at, 8))) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 0.0;
    vColour = vec4(0.0);
    return;
  }
  if (uAveraged) range = rangeAt(uSmooth, at);
  vec3 spot = place(at, range);
  gl_Position = uProject * vec4(spot, 1.0);
  if (clipped(spot)) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 0.0;
    vColour = vec4(0.0);
    return;
  }
  float size = uShrinks ? uDot / max(gl_Position.w, 1e-6) : uDot;
  gl_PointSize = clamp(size, 1.4, 64.0);
  if (uPick) {
    int id = row * uSize.x + column + 1;
    vColour = vec4(float(id & 255), float((id >> 8) & 255), float((id >> 16) & 255), float((id >> 24) & 255)) / 255.0;
    return;
  }
  vec3 c = coloured(texelFetch(uLayer, at, 0).r);
  if (uKind != 1) c *= lit(at);
  vColour = vec4(c, 1.0);
}`,
  fragment: `${HEADER}
flat in vec4 vColour;
out vec4 colour;
void main() { colour = vColour; }`,
};
