/**
 * Shapes of what goes between the page's modules; there is no code here.
 *
 * @typedef {{first: number, values: Float32Array, saturated: number, lit: number}} Thresholds
 * @typedef {{high: Float32Array, low: Int8Array | null, unit: number}} Plane light of a source alone: high + unit low
 * Radiant exposures at which codes begin [J/m^2]: of first + 1, first + 2, ...; of saturation; of half a level of light.
 *
 * @typedef {{gain: number, gamma: number, dark_gray: number, saturation_gray: number, bit_depth: number,
 *   rounding: boolean, linear?: {system_gain: number, offset: number, full_well: number, dark_signal: number,
 *   electrons_of_exposure: number}}} Sensor
 *
 * @typedef {{exposure_time?: string, gain?: string, gamma?: string, dark_gray?: string, bit_depth?: string}} Knobs
 * As texts; what is missing is as in the scene.
 *
 * @typedef {{levels: number[], knobs: Knobs}} Turn
 *
 * @typedef {{name: string, ring: string | null, place: [number, number] | null}} Source
 *
 * @typedef {{name: string, left_out: string, rms_gray: number, rms_gray_upper95: number, needed: boolean}} Effect
 *
 * @typedef {{basis: number, title: string, rows: number, columns: number, sources: Source[], dark_sources: string[],
 *   exposure_time: number, exposure_of_radiance: number, sensor: Sensor, tolerance: number, left_out: Effect[],
 *   warnings: string[], mixes: boolean, saves: boolean, coarse?: number, replaces?: number,
 *   study?: Study, ring?: {count: number, emulated: boolean, wavelength: number | null, max_on_time: number | null}, ray_knobs?: Record<string, string>, ray_knobs_of_file?: Record<string, string>}} Described
 * A coarse picture tells how many pixels a side are one; the next one tells which coarse picture stood for it.
 *
 * @typedef {{history: import("./state.js").History, pin: {u: number, v: number} | null, line: number[] | null,
 *   region: number[] | null, window: [number, number] | null,
 *   sight: {x: number, y: number, size: number} | null,
 *   focus: {knob: string, type: string, text: string} | null, rays: Record<string, string>[]}} Kept
 * What a coarse picture leaves to the one that it stood for, in pixels of that one.
 *
 * @typedef {{error: {rms_gray: number | null, rms_gray_upper95: number | null, method: string}, keeps: boolean,
 *   saturated_fraction: number, gray: {min: number, max: number, mean: number}, sigma_rms: number,
 *   exposure_of_radiance: number, sensor: Sensor,
 *   thresholds: {first: number, count: number, saturated: number | null, lit: number | null}, left_out?: Effect[] | null,
 *   command: string, python?: string}} Told
 * Nothing is known of what is left out where that is null.
 *
 * @typedef {{told: Told, thresholds: Thresholds, exposure: Float32Array, sigma: Float32Array}} Certified
 * An image as the server has made it.
 *
 * @typedef {{rows: number, columns: number, basis: number, turn: Turn, exposure: Float32Array, sigma: Float32Array,
 *   thresholds: Thresholds, told: Told, photo?: {number: number, name: string}}} KeptPicture
 * A picture that is kept to compare with, as it was certified; of a photo its number with the server, and its file's name.
 *
 * @typedef {{targets: {name: string, place: [number, number, number], world: [number, number, number], boxed: boolean,
 *     surfaces: {colour: number[], decal: boolean, vertices: [number, number, number][], faces: number[][]}[]}[],
 *   sources: {name: string, place: [number, number, number], world: [number, number, number], axis: [number, number, number],
 *     radius: number, half_angle: number | null}[],
 *   camera: {world: [number, number, number], corners: [number, number, number][], depth: number, focus: number | null},
 *   unknown: string[]}} Layout
 * Where things stand in the camera's frame, and in the scene file's [m, rad].
 *
 * @typedef {{target: string, distance: number, place: [number, number, number]}} Sight
 * What a pixel sees [m].
 *
 * @typedef {{parts: Record<string, number>, tolerance: number, exposure_time: number, effects_exposure_time: number,
 *   effects: {name: string, left_out: string, rms_gray: number | null, rms_gray_upper95: number | null, needed: boolean}[],
 *   method: string, why: string, advice: string, best_opening: {steepest_diameter: number} | null,
 *   eight_bits: {enough: boolean, target: string} | null}} Matters
 * Causes of the deviation and effects [gray level], times [s], diameters [m].
 *
 * @typedef {{tolerance: number, reference: number, recommendation: string, left_out: {options: string, why: string}[],
 *   settings: {options: string, rays: number, wall_s: number, rms_gray: number, rms_gray_upper: number, front: boolean}[]}} TradeFound
 * What each setting costs [s], and how far it is off [gray level].
 *
 * @typedef {{what: string, done: number, of: number}} TradeProgress
 *
 * @typedef {{title: string, responses: {response: string, runs: number, margin: number | null, sentences: string[],
 *   effects: {name: string, label: string, effect: number, image_error: number, significant: boolean | null,
 *     from: string | null, to: string | null}[]}[]}} Study
 * Results of a study, in the units of its responses.
 *
 * @typedef {{mean: number, rms: number, expected_rms: number, beyond: number,
 *   worst: {column: number, row: number, photo: number, picture: number},
 *   causes: null | {mainly: string | null, as_is: number, dark_level: number, exposure: number, exposure_factor: number | null,
 *     geometry: number | null, shift: [number, number] | null}, notes: string[]}} PhotoFound
 * What a photo differs by from a picture [gray level].
 *
 * @typedef {"a" | "b" | "wipe" | "difference"} Shown
 * What the canvas shows: the kept picture, that of the knobs, both, or the second less the first.
 *
 * @typedef {{beyond: number, squares: number, least: number, largest: number}} Apart
 * How many pixels differ by more than their errors, the sum of squares of all differences, and their extremes [gray level].
 *
 * @typedef {{code: number, gray: number, sigma: number, radiant_exposure: number, parts: Record<string, number>,
 *   saturated: boolean, sees?: Sight | null}} PixelTold
 *
 * @typedef {{name: string, what: string, unit: string, value: number | null, error: number | null, notes: string[]}} Measured
 * What an algorithm reads, with its standard uncertainty; null where the picture does not show it.
 *
 * @typedef {{x0: number, y0: number, x1: number, y1: number, bin: number}} Section
 * Pixels of the image from x0, y0 up to before x1, y1, of which bin x bin become one.
 *
 * @typedef {{low: number, high: number, map: string, saturated: boolean, dark: boolean, flips: boolean,
 *   share: number}} Look
 * Codes that are shown black and white, the colour map, overlays, and the share of light that flips codes.
 *
 * @typedef {{rgba: Uint8ClampedArray, width: number, height: number, counts: Float64Array, saturated: number,
 *   dark: number, flips: number}} Frame
 */

export {};
