// Geometry of the layout's picture: a parallel projection that the user turns; pure.
//
// Places are in the camera's frame: x to the right and y down as it looks, z the way that it looks [m].

/** @typedef {[number, number, number]} Point */
/** @typedef {import("./types.js").Layout} Layout */
/** @typedef {{yaw: number, pitch: number}} Turned angles [rad]; both 0: as the camera looks */

/** @type {Record<string, Turned>} */
export const VIEWS = { camera: { yaw: 0, pitch: 0 }, above: { yaw: 0, pitch: Math.PI / 2 }, side: { yaw: Math.PI / 2, pitch: 0 },
  oblique: { yaw: 0.7, pitch: 0.5 } };

/**
 * Right, down and away on the screen.
 * @param {Point} point
 * @param {Turned} turned
 * @returns {Point}
 */
export function turn([x, y, z], { yaw, pitch }) {
  const right = x * Math.cos(yaw) + z * Math.sin(yaw);
  const forward = z * Math.cos(yaw) - x * Math.sin(yaw);
  return [right, y * Math.cos(pitch) - forward * Math.sin(pitch), y * Math.sin(pitch) + forward * Math.cos(pitch)];
}

/** All places that the picture must hold. @param {Layout} layout @returns {Point[]} */
export function placesOf({ targets, sources, camera }) {
  return [[0, 0, 0], ...targets.flatMap(({ surfaces }) => surfaces.flatMap(({ vertices }) => vertices)),
    ...sources.map(({ place }) => place), ...frustum(camera)];
}

/** Corners of the field of view in the depth of the farthest target. @param {Layout["camera"]} camera @returns {Point[]} */
export function frustum({ corners, depth }) {
  return corners.map(([x, y, z]) => [x * depth, y * depth, z * depth]);
}

/**
 * Points on the rim of a beam, where its intensity is half of that on its axis.
 * @param {Layout["sources"][number]} source
 * @param {number} length along the axis [m]
 * @param {number} count
 * @returns {Point[]} none of one that shines all around, or more than 80 degrees wide
 */
export function rim({ place, axis, half_angle: angle }, length, count = 16) {
  if (angle === null || angle > 1.4) return [];
  const least = axis.map(Math.abs).indexOf(Math.min(...axis.map(Math.abs)));
  const beside = /** @type {Point} */ ([0, 1, 2].map((k) => (k === least ? 1 : 0)));
  const first = unit(cross(axis, beside));
  const second = cross(axis, first);
  const reach = length * Math.tan(angle);
  return Array.from({ length: count }, (_, k) => {
    const [c, s] = [reach * Math.cos((2 * Math.PI * k) / count), reach * Math.sin((2 * Math.PI * k) / count)];
    return /** @type {Point} */ ([0, 1, 2].map((i) => place[i] + length * axis[i] + c * first[i] + s * second[i]));
  });
}

/** @param {Point} a @param {Point} b @returns {Point} */
function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** @param {Point} a @returns {Point} */
function unit(a) {
  const size = Math.hypot(...a);
  return [a[0] / size, a[1] / size, a[2] / size];
}

/**
 * Triangles as they are to be drawn, one over the other: targets by their middles, far ones first; of one target a decal
 * after the surface that it is painted on, and triangles of a surface far ones first.
 * @param {Layout["targets"]} targets
 * @param {Turned} turned
 * @returns {{corners: Point[], colour: number[], facing: number}[]} facing: cosine between normal and view, without sign
 */
export function drawn(targets, turned) {
  const apart = targets.map(({ place, surfaces }) => ({ away: turn(place, turned)[2], surfaces })).sort((a, b) => b.away - a.away);
  return apart.flatMap(({ surfaces }) => surfaces.flatMap(({ colour, vertices, faces }) => {
    const seen = vertices.map((vertex) => turn(vertex, turned));
    return faces.map((face) => {
      const corners = face.map((k) => seen[k]);
      const [ab, ac] = [1, 2].map((k) => /** @type {Point} */ (corners[k].map((value, i) => value - corners[0][i])));
      const normal = cross(ab, ac);
      const away = corners.reduce((sum, corner) => sum + corner[2], 0) / 3;
      return { corners, colour, away, facing: Math.abs(normal[2]) / (Math.hypot(...normal) || 1) };
    }).sort((a, b) => b.away - a.away);
  }));
}
