// The page's pure modules, against numbers that are known; without npm packages: node --test.

import assert from "node:assert/strict";
import { test } from "node:test";
import { setFlagsFromString } from "node:v8";
import { runInNewContext } from "node:vm";
import { colourOf, differenceOf, graysOf, together } from "../../../radwrap/data/face/difference.js";
import { addPlane, codeOf, coloursOf, frameOf, MAPS, ranksOf, sumPlanes, timesOf } from "../../../radwrap/data/face/mix.js";
import { drawn, frustum, placesOf, rim, turn, VIEWS } from "../../../radwrap/data/face/layout.js";
import { progressText, settingRows } from "../../../radwrap/data/face/trading.js";
import { adviceOf, effectRows } from "../../../radwrap/data/face/matters.js";
import { causeText, pictureOf } from "../../../radwrap/data/face/photo.js";
import { grayOf, rankOf, thresholdsOf, turnedSensor } from "../../../radwrap/data/face/response.js";
import { Server } from "../../../radwrap/data/face/server.js";
import { History, sameTurn, untouched, withKnob, withLevels } from "../../../radwrap/data/face/state.js";
import { draggedWindow, grouped, linePixels, profileCsv, quantile, stripPixels, summary } from "../../../radwrap/data/face/statistics.js";
import { countText, exposureText, parseNumber, parseTime, percent, shortNumber, timeText } from "../../../radwrap/data/face/units.js";

const EQ5 = { gain: 3.38e4, gamma: 0.85, dark_gray: 22, saturation_gray: 181, bit_depth: 8, rounding: true };
const PLAIN = { low: 0, high: 255, map: "gray", saturated: false, dark: false, flips: false, share: 0.01 };

/** Numbers that look random and are the same in each run. */
function* numbers(seed) {
  for (let state = seed >>> 0; ;) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    yield state / 2 ** 32;
  }
}

const draw = numbers(7);
const next = () => draw.next().value;
const floats = (count, of) => Float32Array.from({ length: count }, of);
const plane = (...light) => ({ high: Float32Array.from(light), low: null, unit: 0 });

test("sums of planes are sums, whole and step by step", () => {
  const planes = Array.from({ length: 5 }, (_, k) => ({ high: floats(10_000, next), unit: 2 ** -31,
    low: k === 3 ? null : Int8Array.from({ length: 10_000 }, () => 254 * next() - 127) }));
  const light = ({ high, low, unit }, i) => high[i] + (low ? unit * low[i] : 0);
  const factors = [0.3, 0, 2.5, 1, 0.01];
  const sum = new Float64Array(10_000).fill(7); // of another picture
  sumPlanes(planes, factors, sum);
  for (const i of [0, 4095, 4096, 9999]) {
    assert.ok(Math.abs(sum[i] - factors.reduce((all, factor, k) => all + factor * light(planes[k], i), 0)) < 1e-15);
  }
  addPlane(sum, planes[2], -1.5);
  const anew = new Float64Array(10_000);
  sumPlanes(planes, [0.3, 0, 1, 1, 0.01], anew);
  assert.ok(sum.every((value, i) => Math.abs(value - anew[i]) < 1e-14));
});

test("dark and saturation on a half have the even code, as the server's have", () => {
  const codes = (dark, full) => {
    const thresholds = thresholdsOf({ ...EQ5, gain: 1, gamma: 1, dark_gray: dark, saturation_gray: full });
    return [0, 2 ** -20, 1000].map((exposure) => [rankOf(exposure, thresholds), codeOf(exposure, ranksOf(thresholds))]);
  };
  const both = (...expected) => expected.map((code) => [code, code]);
  assert.deepEqual(codes(4.5, 254.5), both(4, 5, 254));
  assert.deepEqual(codes(5.5, 253.5), both(6, 6, 254));
  assert.deepEqual(codes(0.5, 0.5), both(0, 0, 0));
  assert.deepEqual(codes(4.25, 254.75), both(4, 4, 255));
});

test("light is never negative, and a sum that was goes on from where it was", () => {
  const ranks = ranksOf({ first: 0, values: Float32Array.of(0.5, 1.5), saturated: Infinity, lit: 0.5 });
  const codes = (sum) => [...frameOf(sum, 3, 0, 1, ranks, { x0: 0, y0: 0, x1: 3, y1: 1, bin: 1 }, PLAIN, 256).counts.slice(0, 3)];
  const planes = [plane(-1, 0, 1), plane(2, 0, 0)], sum = new Float64Array(3);
  sumPlanes(planes, [1, 0], sum);
  assert.deepEqual(codes(sum), [2, 1, 0]);
  addPlane(sum, planes[1], 1);
  assert.deepEqual(codes(sum), [1, 2, 0]);
});

test("a threshold is the least float that reaches a code, also where a float next to it is nearer", () => {
  const word = new Int32Array(1), float = new Float32Array(word.buffer);
  for (const bits of [8, 12, 16]) {
    const full = 2 ** bits - 1, sensor = { ...EQ5, gain: EQ5.gain * full / 255, dark_gray: 22.3, saturation_gray: full, bit_depth: bits };
    const { first, values } = thresholdsOf(sensor);
    values.forEach((value, k) => {
      const exact = ((first + k + 0.5 - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma);
      float[0] = value;
      word[0]--;
      assert.ok(float[0] < exact && exact <= value, `${bits} bits, code ${first + k + 1}`);
    });
  }
});

test("codes are ranks among thresholds, at each of them and one float below", () => {
  const values = floats(4000, () => 10 ** (8 * next() - 6)).sort();
  const ranks = ranksOf({ first: 3, values, saturated: Infinity, lit: 0 });
  const slow = (light) => 3 + values.filter((value) => value <= light).length;
  const word = new Uint32Array(1), float = new Float32Array(word.buffer);
  for (let k = 0; k < values.length; k += 37) {
    float[0] = values[k];
    const at = codeOf(float[0], ranks);
    assert.equal(at, slow(values[k]));
    word[0]--;
    assert.equal(codeOf(float[0], ranks), slow(float[0]));
    assert.equal(rankOf(float[0], { first: 3, values }), slow(float[0]));
  }
  assert.equal(codeOf(0, ranks), 3);
  assert.equal(codeOf(1e30, ranks), 3 + values.length);
});

test("equal thresholds are passed together, and those at infinity never", () => {
  const ranks = ranksOf({ first: 0, values: Float32Array.of(1, 1, 1, 2, Infinity), saturated: 2, lit: 1 });
  assert.deepEqual([0, 0.99, 1, 1.5, 2, 3e38].map((light) => codeOf(light, ranks)), [0, 0, 3, 3, 4, 4]);
});

test("a frame of light times a scale is that of the products as floats hold them, at each threshold", () => {
  const columns = 43, rows = 12;
  const whole = { x0: 0, y0: 0, x1: columns, y1: rows, bin: 1 };
  const look = { ...PLAIN, saturated: true, dark: true, flips: true };
  const word = new Uint32Array(1), float = new Float32Array(word.buffer);
  for (const bits of [8, 12]) {
    const thresholds = thresholdsOf({ ...EQ5, gain: EQ5.gain * 2 ** (bits - 8), saturation_gray: 2 ** bits - 1, bit_depth: bits });
    const ranks = ranksOf(thresholds);
    for (const scale of [1, 0, 0.3, 1 / 3, 387e-3, 7.77, 1e-30, 1e30]) {
      const sum = floats(columns * rows, (_, i) => {
        float[0] = Math.min(3e38, thresholds.values[(i * 7) % thresholds.values.length] / (scale || 1));
        word[0] += (i % 5) - 2; // beside the float at which the next code begins, and at it
        return i % 11 ? float[0] : 3e-3 * next();
      });
      const products = sum.map((light) => light * scale);
      assert.deepEqual(frameOf(Float64Array.from(sum), columns, 0, scale, ranks, whole, look, 2 ** bits),
        frameOf(products, columns, 0, 1, ranks, whole, look, 2 ** bits), `${bits} bits, times ${scale}`);
    }
  }
});

test("a band of five megapixels of twelve sources: a turned knob costs no pass over all planes, and leaves no memory", async () => {
  const columns = 2448, rows = 1024, sources = 12, size = 4 * columns * rows;
  /** @type {any} */
  const worker = globalThis;
  let answer = null;
  worker.onmessage = null;
  worker.postMessage = (told) => { answer = told; };
  setFlagsFromString("--expose-gc");
  const tidied = runInNewContext("gc");
  const held = async () => {
    tidied();
    await new Promise((resolve) => { setTimeout(resolve, 20); }); // memory is given back beside the program
    tidied();
    return process.memoryUsage().arrayBuffers;
  };
  const before = await held();
  await import("../../../radwrap/data/face/worker.js");
  const tell = (data) => worker.onmessage({ data });
  tell({ kind: "begin", columns, top: 0, rows });
  tell({ kind: "response", thresholds: thresholdsOf(EQ5), sensor: EQ5 });
  const light = floats(columns * rows, () => 3e-4 * next());
  for (let k = 0; k < sources; k++) tell({ kind: "plane", plane: { high: light.slice(), low: new Int8Array(light.length).fill(k), unit: 1e-15 } });
  const section = { x0: 0, y0: 0, x1: columns, y1: rows, bin: 4 };
  let levels = new Array(sources).fill(1);
  const median = (turn) => {
    const times = Array.from({ length: 9 }, (_, n) => {
      levels = turn(n);
      const start = process.cpuUsage().user;
      tell({ kind: "frame", id: n, factors: levels, scale: 1, certified: false, section, look: PLAIN, shown: "b", range: 1 });
      assert.equal(answer.frame.counts.reduce((all, count) => all + count), columns * rows);
      return process.cpuUsage().user - start;
    }).sort((a, b) => a - b);
    return times[4];
  };
  const all = median((n) => levels.map((_, k) => 1 + 0.01 * n + 0.1 * k)); // no two alike: each plane has its share
  const whole = await held();
  const [one, exposure] = [median((n) => levels.with(n, 0.7)), median((n) => levels.map((level) => level * 1.01))];
  assert.ok(one < all / 1.8, `one knob ${one} us, all planes ${all} us`);
  assert.ok(exposure < all / 1.8, `all knobs alike ${exposure} us, all planes ${all} us`);
  // Planes, whose lower bits are a fourth as large, their sum, twice as large, the light that they were made from; and a frame.
  assert.ok(whole - before < (1.25 * sources + 4) * size, `${(whole - before) / size} planes`);
  answer = null;
  const more = await held() - whole;
  assert.ok(more < size / 4, `${more / size} planes more`);
  tell({ kind: "begin", columns: 1, top: 0, rows: 1 });
});

test("a frame counts each pixel once, whatever part of it is seen", () => {
  const columns = 40, rows = 30;
  const sum = floats(columns * rows, () => 3e-3 * next());
  const thresholds = thresholdsOf(EQ5);
  const ranks = ranksOf(thresholds);
  for (const section of [{ x0: 0, y0: 0, x1: 40, y1: 30, bin: 1 }, { x0: 4, y0: 2, x1: 31, y1: 29, bin: 1 },
    { x0: 0, y0: 0, x1: 40, y1: 30, bin: 4 }, { x0: 3, y0: 3, x1: 40, y1: 30, bin: 3 }]) {
    const frame = frameOf(sum, columns, 0, 1, ranks, section, { ...PLAIN, flips: true }, 256);
    assert.equal(frame.counts.reduce((all, count) => all + count), columns * rows);
    assert.equal(frame.saturated, sum.filter((light) => light >= thresholds.saturated).length);
    assert.equal(frame.dark, sum.filter((light) => light < thresholds.lit).length);
    const flipped = sum.filter((light) => codeOf(light * 1.01, ranks) !== codeOf(light, ranks)).length;
    assert.equal(frame.flips, flipped);
    const bare = frameOf(sum, columns, 0, 1, ranks, section, PLAIN, 256);
    const { x0, y0, x1, y1, bin } = section;
    assert.deepEqual([frame.width, frame.height], [Math.ceil((x1 - x0) / bin), Math.ceil((y1 - y0) / bin)]);
    for (const [x, y] of [[0, 0], [frame.width - 1, frame.height - 1], [2, 3]]) {
      const codes = [];
      for (let v = y0 + y * bin; v < Math.min(y1, y0 + (y + 1) * bin); v++) {
        for (let u = x0 + x * bin; u < Math.min(x1, x0 + (x + 1) * bin); u++) codes.push(codeOf(sum[v * columns + u], ranks));
      }
      const expected = Math.round(codes.reduce((all, code) => all + code) / codes.length);
      const at = 4 * (y * frame.width + x);
      assert.deepEqual([...bare.rgba.slice(at, at + 4)], [expected, expected, expected, 255]);
    }
  }
});

test("bands put together are the whole", () => {
  const columns = 25, rows = 480;
  const sum = floats(columns * rows, () => 3e-3 * next());
  const ranks = ranksOf(thresholdsOf(EQ5));
  for (const section of [{ x0: 0, y0: 0, x1: 25, y1: 480, bin: 6 }, { x0: 5, y0: 100, x1: 20, y1: 470, bin: 5 }]) {
    const whole = frameOf(sum, columns, 0, 1, ranks, section, PLAIN, 256);
    const parts = [0, 240].map((top) =>
      frameOf(sum.slice(top * columns, (top + 240) * columns), columns, top, 1, ranks, section, PLAIN, 256));
    assert.deepEqual(parts.map(({ row }) => row), [0, parts[0].height]);
    assert.deepEqual(parts.flatMap(({ rgba }) => [...rgba]), [...whole.rgba]);
  }
});

test("one clipped pixel of five million stays in sight", () => {
  const columns = 2448, rows = 240;
  const sum = new Float32Array(columns * rows).fill(1e-4);
  sum[123 * columns + 1001] = 1;
  const ranks = ranksOf(thresholdsOf(EQ5));
  const look = { ...PLAIN, saturated: true };
  const frame = frameOf(sum, columns, 0, 1, ranks, { x0: 0, y0: 0, x1: columns, y1: rows, bin: 12 }, look, 256);
  const red = [];
  for (let at = 0; at < frame.rgba.length; at += 4) if (frame.rgba[at] !== frame.rgba[at + 2]) red.push(at / 4);
  assert.deepEqual(red, [10 * 204 + 83]);
  assert.equal(frame.saturated, 1);
});

test("colours: the window is fixed, maps end where they should", () => {
  const words = coloursOf({ ...PLAIN, low: 50, high: 150 }, 256);
  assert.deepEqual([words[0], words[50], words[150], words[255]], [0xff000000, 0xff000000, 0xffffffff, 0xffffffff]);
  assert.deepEqual(MAPS.viridis(0), [68, 1, 84]);
  assert.deepEqual(MAPS.viridis(1).map(Math.round), [253, 231, 37]);
  const lightness = ([r, g, b]) => 0.2126 * r ** 2.2 + 0.7152 * g ** 2.2 + 0.0722 * b ** 2.2;
  for (const map of ["viridis", "cividis"]) {
    for (let k = 0; k < 100; k++) assert.ok(lightness(MAPS[map](k / 100)) < lightness(MAPS[map]((k + 1) / 100)), map);
  }
});

test("thresholds invert Eq. 5", () => {
  for (const sensor of [EQ5, { ...EQ5, gamma: 1, gain: 9e4, dark_gray: 0.5 }]) {
    const { first, values } = thresholdsOf(sensor);
    assert.equal(first + values.length, Math.round(sensor.saturation_gray));
    values.forEach((light, k) => assert.ok(Math.abs(grayOf(light, sensor) - (first + k + 0.5)) < 1e-4));
  }
});

test("turned sensors keep the exposure of saturation", () => {
  const full = ({ saturation_gray: s, dark_gray: d, gain, gamma }) => ((s - d) / gain) ** (1 / gamma);
  for (const knobs of [{ gamma: "0.5" }, { bit_depth: "12" }, { gamma: "1.2", bit_depth: "10" }]) {
    assert.ok(Math.abs(full(turnedSensor(EQ5, knobs, 1)) / full(EQ5) - 1) < 1e-12);
  }
  assert.equal(turnedSensor(EQ5, { gain: "2" }, 1).gain, 2 * EQ5.gain);
  assert.equal(turnedSensor(EQ5, { gain: "wrong", gamma: "" }, 1).gain, EQ5.gain);
  const linear = { ...EQ5, gamma: 1, linear: { system_gain: 0.01, offset: 4, full_well: 2e4, dark_signal: 10, electrons_of_exposure: 1e9 } };
  const made = turnedSensor(linear, { gain: "2", dark_gray: "6" }, 3);
  assert.deepEqual([made.dark_gray, made.saturation_gray, made.gain], [6 + 0.02 * 30, 255, 0.02 * 1e9]);
});

test("a drag is one step back, and what comes after an undo is forgotten", () => {
  const history = new History(untouched(3));
  for (const level of [0.9, 0.8, 0.7]) assert.ok(history.turn(withLevels(history.now, [1], level), "b"));
  history.rest();
  history.turn(withLevels(history.now, [1], 0.1), "b");
  history.turn(withKnob(history.now, "gain", "2"), "gain");
  assert.equal(history.turn(withKnob(history.now, "gain", "2"), "gain"), false);
  assert.ok(history.undo() && history.undo());
  assert.deepEqual(history.now, { levels: [1, 0.7, 1], knobs: {} });
  assert.ok(history.redo());
  assert.equal(history.now.levels[1], 0.1);
  history.turn(withLevels(history.now, [0, 1, 2], 1), "all");
  assert.equal(history.redo(), false);
  assert.ok(sameTurn(history.now, untouched(3)));
  while (history.undo());
  assert.ok(sameTurn(history.now, history.start));
  assert.ok(!sameTurn(withKnob(untouched(3), "gain", "1"), untouched(3)));
  assert.deepEqual(withKnob(withKnob(untouched(1), "gain", "2"), "gain", undefined), untouched(1));
});

test("lines have one pixel a step, and both ends", () => {
  assert.deepEqual(linePixels([5, 5, 5, 5]), [{ u: 5, v: 5, distance: 0 }]);
  const line = linePixels([0, 0, 8, 3]);
  assert.deepEqual(line.map(({ u }) => u), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
  assert.deepEqual(line.map(({ v }) => v), [0, 0, 1, 1, 2, 2, 2, 3, 3]);
  assert.equal(line.at(-1).distance, Math.hypot(8, 3));
  assert.equal(linePixels([9, 2, 0, 2]).length, 10);
});

test("statistics", () => {
  assert.deepEqual(summary([2, 4, 4, 4, 5, 5, 7, 9]), { n: 8, mean: 5, deviation: Math.sqrt(32 / 7), min: 2, max: 9 });
  assert.equal(summary([3]).deviation, 0);
  const counts = Float64Array.of(1, 2, 3, 4);
  assert.deepEqual(grouped(counts, 2), [{ first: 0, last: 1, count: 3 }, { first: 2, last: 3, count: 7 }]);
  assert.equal(quantile(counts, 0.5), 2);
  const csv = profileCsv([{ u: 1, v: 2, distance: 0, code: 5, gray: 5.25, sigma: null, exposure: 1e-3, pixels: 1 }]);
  assert.equal(csv.split("\n")[1], "0,1,2,5,5.25,,0.001,1");
});

test("units as radwrap has them", () => {
  assert.equal(parseTime("387 ms"), 0.387);
  for (const text of ["387", "387ms", "387 mm", "nan s", "-1 s", "1e300 s", "1 s s", "", "0 s", "1,5 s", "1 constructor"]) {
    assert.equal(parseTime(text), null, text);
  }
  for (const text of ["nan", "1e999", "", "1 2", "0x10", "1,5", "Infinity"]) assert.equal(parseNumber(text), null, text);
  assert.equal(parseNumber(" 1e-2 "), 0.01);
  assert.deepEqual([timeText(0.387), timeText(2), timeText(3.5e-5)], ["387 ms", "2 s", "35 us"]);
  assert.equal(parseTime(timeText(0.12345)), 0.1235);
  assert.deepEqual([percent(0), percent(1e-9), percent(0.5), percent(1e-4)], ["0 %", "< 0.001 %", "50.0 %", "0.010 %"]);
  assert.equal(shortNumber(Infinity), "no bound");
  assert.equal(exposureText(1.483e-3), "1.483 mJ/m²");
});

test("counts are said in thousands and millions", () => {
  assert.deepEqual([0, 9999, 10_000, 999_499, 999_500, 12_345_678].map(countText),
    ["0", "9999", "10 thousand", "999 thousand", "1.0 million", "12.3 million"]);
});

test("levels that are turned alike need one factor, others a new sum", () => {
  assert.equal(timesOf([1, 1, 1], [0.3, 0.3, 0.3]), 0.3);
  assert.ok(Math.abs(timesOf([0.1, 0.7, 0], [0.3, 2.1, 0]) - 3) < 1e-12);
  assert.equal(timesOf([0, 0.5], [0, 0]), 0); // all off
  for (const [before, after] of [[[1, 1], [1, 1.001]], [[1, 0], [2, 1]], [[0, 0], [1, 1]], [[], [1]], [[1, 1], [1]]]) {
    assert.equal(timesOf(before, after), null);
  }
});

test("codes are ranks also where a bucket of bits holds many thresholds, and at words of every kind", () => {
  const values = Float32Array.from({ length: 4000 }, (_, k) => 1e-3 + k * 1e-8);
  const many = ranksOf({ first: 5, values, saturated: values[3998], lit: values[1] });
  assert.equal(many.single, false);
  assert.equal(ranksOf(thresholdsOf(EQ5)).single, true);
  const sum = Float32Array.from([0, 1e-3, 9.99e-4, values[1], values[3998], 5e-3, Infinity, 1e-45, ...values.subarray(7, 100)]);
  const section = { x0: 0, y0: 0, x1: sum.length, y1: 1, bin: 1 };
  const frame = frameOf(sum, sum.length, 0, 1, many, section, PLAIN, 4096);
  const counts = new Float64Array(4096);
  for (const light of sum) counts[5 + values.filter((value) => value <= light).length]++;
  assert.deepEqual(frame.counts, counts);
  assert.deepEqual([frame.saturated, frame.dark], [3, 4]); // the one at the threshold is saturated, and is not dark
});

test("a wide line has as many pixels across, but for those outside", () => {
  const [first, ...rest] = stripPixels([3, 1, 20, 1], 5, 20, 24);
  assert.deepEqual(first, [{ u: 3, v: 0 }, { u: 3, v: 1 }, { u: 3, v: 2 }, { u: 3, v: 3 }]);
  assert.equal(rest.length, 17);
  assert.deepEqual(stripPixels([5, 5, 5, 5], 3, 20, 24), [[{ u: 5, v: 4 }, { u: 5, v: 5 }, { u: 5, v: 6 }]]);
  for (const ends of [[0, 0, 17, 9], [20, 3, 1, 18], [4, 19, 4, 0]]) {
    assert.deepEqual(stripPixels(ends, 1, 20, 24).flat(), linePixels(ends).map(({ u, v }) => ({ u, v })));
    const across = stripPixels(ends, 7, 40, 40)[5];
    const far = Math.hypot(across.at(-1).u - across[0].u, across.at(-1).v - across[0].v);
    assert.ok(far > 4.5 && far < 7.5);
  }
});

test("dragging to the right narrows black and white, up makes brighter", () => {
  assert.deepEqual(draggedWindow([0, 255], 0, 0), [0, 255]);
  assert.deepEqual(draggedWindow([0, 200], 150, 0), [50, 150]);
  assert.deepEqual(draggedWindow([0, 200], 0, -150), [-100, 100]);
  assert.deepEqual(draggedWindow([10, 11], 3000, 0), [10, 11]);
});

test("a difference is that of gray levels, and sure beyond 1.96 deviations of both", () => {
  const sensor = { ...EQ5, gamma: 1, gain: 1, dark_gray: 0, saturation_gray: 255 }; // gray = light
  const ranks = ranksOf(thresholdsOf(sensor));
  const side = (light, sigma) => ({ light: Float32Array.from(light), gray: graysOf(Float32Array.from(light), sensor),
    sigma: Float32Array.from(sigma), ranks });
  const a = side([10, 10, 10, 10, 10, 10], [3, 3, 3, 3, 0, 0]);
  const b = side([10, 19.75, 20, 0, 10.5, 10], [4, 4, 4, 4, 0, 0]); // five together: 9.8 gray levels are sure
  const all = { x0: 0, y0: 0, x1: 3, y1: 2, bin: 1 };
  const { rgba, width, height, counts, apart } = differenceOf(a, b, 3, 0, all, 20, 256);
  assert.deepEqual([width, height], [3, 2]);
  assert.deepEqual(apart, { beyond: 3, squares: 9.75 ** 2 + 100 + 100 + 0.25, least: -10, largest: 10 });
  assert.equal(counts[10], 2);
  const colours = new Uint32Array(rgba.buffer);
  const same = 0xff767676;
  assert.deepEqual([...colours], [same, same, colourOf(0.5), colourOf(-0.5), colourOf(0.025), same]);
  const bright = (colour) => (colour & 255) + ((colour >> 8) & 255) + ((colour >> 16) & 255);
  assert.ok(bright(colourOf(0.05)) > bright(same) && bright(same) > bright(colourOf(-0.05))); // without colours too
  assert.equal(colourOf(7), colourOf(1));
});

test("one pixel that differs is seen in a bin, and bands are one picture", () => {
  const rows = 480, columns = 50, place = 300 * columns + 37;
  const sensor = { ...EQ5, gamma: 1, gain: 1, dark_gray: 0, saturation_gray: 255 };
  const ranks = ranksOf(thresholdsOf(sensor));
  const light = new Float32Array(rows * columns).fill(100);
  const other = light.slice();
  other[place] = 150;
  const sigma = new Float32Array(light.length).fill(1);
  const section = { x0: 0, y0: 0, x1: columns, y1: rows, bin: 6 };
  const bands = [0, 240].map((top) => {
    const cut = (all) => all.subarray(top * columns, (top + 240) * columns);
    const side = (all) => ({ light: cut(all), gray: graysOf(cut(all), sensor), sigma: cut(sigma), ranks });
    return differenceOf(side(light), side(other), columns, top, section, 50, 256);
  });
  assert.deepEqual(together(bands.map(({ apart }) => apart)), { beyond: 1, squares: 2500, least: 0, largest: 50 });
  assert.deepEqual(bands.map(({ row, width, height }) => [row, width, height]), [[0, 9, 40], [40, 9, 40]]);
  const shown = bands.flatMap(({ rgba }) => [...new Uint32Array(rgba.buffer)]);
  assert.deepEqual(shown.flatMap((colour, k) => (colour === colourOf(1) ? [k] : [])), [50 * 9 + 6]);
  assert.equal(shown.filter((colour) => colour === 0xff767676).length, shown.length - 1);
});

test("a photo's gray levels are its codes, as those of a picture are", () => {
  const values = Float32Array.of(0, 1, 21.4, 21.6, 254, 255);
  const photo = pictureOf({ number: 3, name: "x", values, bits: 8, rows: 1, columns: 6, sensor: EQ5 });
  assert.deepEqual([...values].map((value) => rankOf(value, photo.thresholds)), [0, 1, 21, 22, 254, 255]);
  assert.deepEqual([...graysOf(values, photo.told.sensor)], [...values]);
  const ranks = ranksOf(photo.thresholds);
  assert.deepEqual([...values].map((value) => codeOf(value, ranks)), [0, 1, 21, 22, 254, 255]);
  // A picture of the same gray levels does not differ from it; a brighter one is B more than A.
  const now = { light: values, gray: values.map((value) => value + 2), sigma: new Float32Array(6).fill(0.5), ranks };
  const a = { gray: graysOf(values, photo.told.sensor), sigma: photo.sigma };
  const { apart } = differenceOf(a, now, 6, 0, { x0: 0, y0: 0, x1: 6, y1: 1, bin: 1 }, 16, 256);
  assert.deepEqual([apart.beyond, apart.least, apart.largest], [6, 2, 2]);
});

test("what explains a difference is said with what it leaves", () => {
  const causes = { mainly: null, as_is: 4, dark_level: 3.9, exposure: 1.5, exposure_factor: 1.234567, geometry: null, shift: null };
  assert.equal(causeText({ ...causes, mainly: "exposure" }), "mainly light or exposure: 1.23 times as bright above dark, and 1.5 gray rms of 4 stay");
  assert.match(causeText({ ...causes, mainly: "geometry", geometry: 1, shift: [0.5, -2] }), /moved by 0.50, -2.00 px, and 1 gray rms of 4 stay/);
  assert.match(causeText(causes), /neither/);
  assert.match(causeText(null), /no cause is looked for/);
});

test("effects stand in a table by their size, and what is needed is said", () => {
  const rows = effectRows([{ name: "cos4", left_out: "no falloff", rms_gray: 0.5, rms_gray_upper95: 0.6, needed: false },
    { name: "finite_aperture", left_out: "a sharp image", rms_gray: 3.21, rms_gray_upper95: 3.45, needed: true },
    { name: "bands", left_out: "one", rms_gray: 1e-5, rms_gray_upper95: 1e-4, needed: false }]);
  assert.deepEqual(rows, [["finite aperture", "3.2", "3.5", "yes", "a sharp image"], ["cos4", "0.50", "0.60", "no", "no falloff"],
    ["bands", "< 0.001", "< 0.001", "no", "one"]]);
  const found = { parts: {}, tolerance: 1, effects: [], method: "kernel", why: "w", advice: "a", best_opening: { steepest_diameter: 2e-3 },
    eight_bits: { enough: false, target: "board" }, exposure_time: 1, effects_exposure_time: 0.25 };
  assert.match(adviceOf(found).join("; "), /exposure of 250 ms, as the picture saturates.*2 mm has the steepest edges.*8 bits are too few/);
  assert.doesNotMatch(adviceOf({ ...found, effects_exposure_time: 1 }).join("; "), /saturates/);
});

test("settings stand by their time, and how far a trade is changes seldom", () => {
  const setting = (options, wall_s, rms_gray, front) => ({ options, rays: 123456, wall_s, rms_gray, rms_gray_upper: 2 * rms_gray, front });
  assert.deepEqual(settingRows([setting("--method rays --tolerance 1", 12.345, 0.5, false), setting("--method kernel --tolerance 1", 0.25, 1e-4, true)]),
    [["method kernel tolerance 1", "123000", "250 ms", "0.00", "0.00", "yes"], ["method rays tolerance 1", "123000", "12.3 s", "0.50", "1.0", "no"]]);
  assert.equal(progressText({ what: "reference", done: 1, of: 1e6 }), progressText({ what: "reference", done: 2, of: 1e6 }));
  assert.match(progressText({ what: "settings", done: 30, of: 22 }), /22 of 22/); // more than were foreseen
});

const near = (found, wanted) => found.forEach((value, k) => assert.ok(Math.abs(value - wanted[k]) < 1e-12, `${found} is not ${wanted}`));

test("a layout is seen from where its button says", () => {
  near(turn([1, 2, 3], VIEWS.camera), [1, 2, 3]); // right, down, away
  near(turn([1, 2, 3], VIEWS.above), [1, -3, 2]); // what is farther from the camera is higher up, what is lower is farther away
  near(turn([1, 2, 3], VIEWS.side), [3, 2, -1]); // away from the camera is to the right, its right is near
  for (let k = 0; k < 20; k++) { // a rotation: lengths and hands stay
    const turned = { yaw: 7 * next(), pitch: 3 * next() - 1.5 };
    const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => turn(axis, turned));
    near([Math.hypot(...x), Math.hypot(...y), Math.hypot(...z)], [1, 1, 1]);
    near([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]], z);
  }
});

test("a beam's rim lies at its half angle about its axis, and the field of view in its depth", () => {
  const source = { name: "a", place: [0.1, 0, 0], world: [0, 0, 0], axis: [0, 0.6, 0.8], radius: 0, half_angle: 0.3 };
  for (const point of rim(source, 2)) {
    const [x, y, z] = point.map((value, k) => value - source.place[k]);
    near([(0.6 * y + 0.8 * z), Math.acos((0.6 * y + 0.8 * z) / Math.hypot(x, y, z))], [2, 0.3]);
  }
  assert.deepEqual(rim({ ...source, half_angle: null }, 1), []);
  const camera = { world: [0, 0, 0], corners: [[-0.1, -0.2, 1], [0.1, -0.2, 1], [0.1, 0.2, 1], [-0.1, 0.2, 1]], depth: 0.5, focus: null };
  near(frustum(camera)[2], [0.05, 0.1, 0.5]);
  assert.equal(placesOf({ targets: [], sources: [source], camera, unknown: [] }).length, 6);
});

test("what is nearer is drawn later, and a decal after what it is painted on", () => {
  const square = (z, colour, size = 1) => ({ colour: [colour], decal: size < 1,
    vertices: [[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]], faces: [[0, 1, 2], [0, 2, 3]] });
  const target = (name, z, ...surfaces) => ({ name, place: [0, 0, z], world: [0, 0, 0], boxed: false, surfaces });
  const targets = [target("near", 1, square(1, 3), square(1, 4, 0.5)), target("far", 2, square(2, 1), square(2, 2, 0.5))];
  const colours = (turned) => drawn(targets, turned).map(({ colour: [one] }) => one);
  assert.deepEqual(colours(VIEWS.camera), [1, 1, 2, 2, 3, 3, 4, 4]);
  assert.deepEqual(colours({ yaw: Math.PI, pitch: 0 }), [3, 3, 4, 4, 1, 1, 2, 2]); // from behind
  assert.ok(drawn(targets, VIEWS.camera).every(({ facing }) => facing === 1));
  assert.ok(drawn(targets, VIEWS.side).every(({ facing }) => facing < 1e-9));
});

test("a worker is there before a picture needs it, and another one is started once that is drawn", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const started = [];
  globalThis.Worker = class { constructor(place) { started.push(place); } };
  t.after(() => { delete globalThis.Worker; });
  const server = new Server("token");
  assert.deepEqual(started, ["/worker.js"]);
  const [first, second] = [server.makeWorker(), server.makeWorker()]; // of a large picture
  assert.ok(first !== second && started.length === 2);
  t.mock.timers.tick(1000);
  assert.equal(started.length, 3);
  server.makeWorker();
  assert.equal(started.length, 3);
});
