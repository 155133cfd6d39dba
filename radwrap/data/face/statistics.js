// Lines, regions and histograms; pure.

/**
 * Pixels nearest to even steps along a line, as radwrap/face/profile.py takes them.
 * @param {[number, number, number, number]} ends column and row of both
 */
export function linePixels([u0, v0, u1, v1]) {
  const steps = Math.max(Math.abs(u1 - u0), Math.abs(v1 - v0));
  const length = Math.hypot(u1 - u0, v1 - v0);
  const found = [];
  for (let k = 0; k <= steps; k++) {
    const share = k / Math.max(steps, 1);
    const u = Math.floor(u0 + (u1 - u0) * share + 0.5);
    const v = Math.floor(v0 + (v1 - v0) * share + 0.5);
    found.push({ u, v, distance: length * share });
  }
  return found;
}

/**
 * Pixels across each step of a line, as radwrap/face/profile.py takes them; those outside are left out.
 * @param {[number, number, number, number]} ends
 * @param {number} width an odd number of pixels
 * @param {number} rows
 * @param {number} columns
 * @returns {{u: number, v: number}[][]}
 */
export function stripPixels([u0, v0, u1, v1], width, rows, columns) {
  const steps = Math.max(Math.abs(u1 - u0), Math.abs(v1 - v0));
  const length = Math.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2);
  const [across, down] = length ? [-(v1 - v0) / length, (u1 - u0) / length] : [0, 1];
  return Array.from({ length: steps + 1 }, (_, k) => {
    const share = k / Math.max(steps, 1);
    const found = [];
    for (let j = 0; j < width; j++) {
      const off = j - (width - 1) / 2;
      const u = Math.floor(u0 + (u1 - u0) * share + off * across + 0.5);
      const v = Math.floor(v0 + (v1 - v0) * share + off * down + 0.5);
      if (u >= 0 && u < columns && v >= 0 && v < rows) found.push({ u, v });
    }
    return found;
  });
}

/**
 * Mean, standard deviation, extremes and number of some values.
 * @param {Iterable<number>} values
 */
export function summary(values) {
  let n = 0, mean = 0, squares = 0, min = Infinity, max = -Infinity;
  for (const value of values) {
    n++;
    const off = value - mean;
    mean += off / n;
    squares += off * (value - mean);
    if (value < min) min = value;
    if (value > max) max = value;
  }
  return { n, mean, deviation: n > 1 ? Math.sqrt(squares / (n - 1)) : 0, min, max };
}

/**
 * Black and white as dragging turns them: to the right more contrast, up brighter.
 * @param {[number, number]} window codes that were black and white
 * @param {number} right
 * @param {number} down both in pixels of the screen
 * @returns {[number, number]}
 */
export function draggedWindow([low, high], right, down) {
  const before = Math.max(1, high - low);
  const width = Math.max(1, before * 2 ** (-right / 150));
  const middle = (low + high) / 2 + (down / 300) * before;
  const first = Math.round(middle - width / 2);
  return [first, Math.max(first + 1, Math.round(middle + width / 2))];
}

/**
 * Counts of groups of codes, at most so many groups.
 * @param {Float64Array} counts of each code
 * @param {number} most
 */
export function grouped(counts, most) {
  const size = Math.max(1, Math.ceil(counts.length / most));
  const groups = [];
  for (let first = 0; first < counts.length; first += size) {
    let count = 0;
    for (let code = first; code < Math.min(first + size, counts.length); code++) count += counts[code];
    groups.push({ first, last: Math.min(first + size, counts.length) - 1, count });
  }
  return groups;
}

/**
 * Code below which a share of all pixels lies.
 * @param {Float64Array} counts
 * @param {number} share
 */
export function quantile(counts, share) {
  let all = 0;
  for (const count of counts) all += count;
  let below = 0;
  for (let code = 0; code < counts.length; code++) {
    below += counts[code];
    if (below >= share * all) return code;
  }
  return counts.length - 1;
}

/**
 * A profile as CSV, with the columns of the server's.
 * @param {{u: number, v: number, distance: number, code: number, gray: number, sigma: number | null,
 *   exposure: number, pixels: number}[]} rows
 */
export function profileCsv(rows) {
  const lines = rows.map(({ distance, u, v, code, gray, sigma, exposure, pixels }) =>
    [distance, u, v, code, gray, sigma ?? "", exposure, pixels].join(","));
  return ["distance_px,u_px,v_px,code,gray,sigma_gray,radiant_exposure_J_m2,pixels", ...lines, ""].join("\n");
}
