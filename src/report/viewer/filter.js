// What the kernel leaves of an error animation, and how much that is against white noise.
//
// Animations are Float32Arrays of frames, rows, columns. They wrap around in all three, as tiles
// do. Long work is a generator that yields the part of it that is done, so that whoever runs it
// can stop at any time; see work.js.
(function (perceptile) {
  'use strict';

  /**
   * @typedef {{width: number, height: number, frames: number}} Shape
   * @typedef {{x: number, y: number, width: number, height: number, row: number[] | null,
   *   column: number[] | null, weights: number[]}} Plane
   * @typedef {{power: number, planes: Plane[],
   *   slices: {dt: number, plane: number, scale: number}[]}} Kernel
   */

  const modulo = (value, period) => ((value % period) + period) % period;

  /** Adds a row of pixels, filtered with the weights of one row of a plane, to `into`. */
  function addRow(source, start, width, x, weights, first, count, padded, into, at) {
    const length = width + count - 1;
    let from = modulo(x, width);
    for (let i = 0; i < length; i += 1) {
      padded[i] = source[start + from];
      from += 1;
      if (from === width) from = 0;
    }
    for (let i = 0; i < width; i += 1) {
      let sum = 0;
      for (let k = 0; k < count; k += 1) sum += weights[first + k] * padded[i + k];
      into[at + i] += sum;
    }
  }

  /**
   * Filters one frame in x and y: pixel (x, y) of the result is Σ weight(dx, dy) · pixel
   * (x + dx, y + dy) of the frame that starts at `start` in `source`.
   *
   * @param {Float32Array} into the result's frame starts at `start`, too
   * @param {{padded: Float64Array, rows: Float64Array}} scratch from `scratchFor`
   */
  function filterPlane(source, start, shape, plane, scratch, into) {
    const { width, height } = shape;
    const { padded, rows } = scratch;
    rows.fill(0);
    if (plane.row && plane.column) {
      const { row, column } = plane;
      for (let y = 0; y < height; y += 1) {
        addRow(source, start + y * width, width, plane.x, row, 0, plane.width, padded, rows, y * width);
      }
      for (let y = 0; y < height; y += 1) {
        const at = start + y * width;
        for (let i = 0; i < width; i += 1) into[at + i] = 0;
        for (let k = 0; k < plane.height; k += 1) {
          const from = modulo(y + plane.y + k, height) * width;
          const weight = column[k];
          for (let i = 0; i < width; i += 1) into[at + i] += weight * rows[from + i];
        }
      }
      return;
    }
    for (let y = 0; y < height; y += 1) {
      for (let k = 0; k < plane.height; k += 1) {
        const from = start + modulo(y + plane.y + k, height) * width;
        addRow(source, from, width, plane.x, plane.weights, k * plane.width, plane.width, padded, rows, y * width);
      }
    }
    for (let i = 0; i < width * height; i += 1) into[start + i] = rows[i];
  }

  function scratchFor(shape, kernel) {
    const widest = Math.max(...kernel.planes.map((plane) => plane.width));
    return {
      padded: new Float64Array(shape.width + widest - 1),
      rows: new Float64Array(shape.width * shape.height),
    };
  }

  /**
   * Filters a whole animation. Frame t of the result reads the frames t + dt.
   *
   * @param {Float32Array} errors
   * @param {Shape} shape
   * @param {Kernel | null} kernel null leaves the errors as they are
   * @param {(t: number, values: Float32Array) => void} emit gets each frame when it is finished
   */
  function* filter(errors, shape, kernel, emit) {
    const { frames } = shape;
    const pixels = shape.width * shape.height;
    if (!kernel) {
      for (let t = 0; t < frames; t += 1) {
        emit(t, errors.slice(t * pixels, (t + 1) * pixels));
        yield (t + 1) / frames;
      }
      return;
    }
    const scratch = scratchFor(shape, kernel);
    const spatial = new Float32Array(errors.length);
    const results = Array.from({ length: frames }, () => new Float32Array(pixels));
    const used = kernel.planes.map((_, plane) => kernel.slices.filter((s) => s.plane === plane));
    const last = used.findLastIndex((slices) => slices.length > 0);
    for (const [number, plane] of kernel.planes.entries()) {
      for (let t = 0; t < frames; t += 1) {
        filterPlane(errors, t * pixels, shape, plane, scratch, spatial);
        yield (number + (0.7 * (t + 1)) / frames) / kernel.planes.length;
      }
      for (let t = 0; t < frames; t += 1) {
        const result = results[t];
        for (const { dt, scale } of used[number]) {
          const from = modulo(t + dt, frames) * pixels;
          for (let i = 0; i < pixels; i += 1) result[i] += scale * spatial[from + i];
        }
        if (number === last) emit(t, result);
        yield (number + 0.7 + (0.3 * (t + 1)) / frames) / kernel.planes.length;
      }
    }
  }

  /** The first and the last tap of a kernel across, down and in time. */
  function reach(kernel) {
    if (!kernel) return { x: [0, 0], y: [0, 0], t: [0, 0] };
    const planes = kernel.slices.map(({ plane }) => kernel.planes[plane]);
    const ends = (taps) => [Math.min(...taps.map(([first]) => first)), Math.max(...taps.map(([, last]) => last))];
    return {
      x: ends(planes.map(({ x, width }) => [x, x + width - 1])),
      y: ends(planes.map(({ y, height }) => [y, y + height - 1])),
      t: ends(kernel.slices.map(({ dt }) => [dt, dt])),
    };
  }

  /**
   * What of an animation counts in its mean. A part of a tile does not go on at its ends as the
   * tile does, so of a part only those columns, rows and frames count whose taps all lie in one
   * copy of it. Along an axis that is too short for that, all count: its ends wrap.
   *
   * @param {Shape} shape of the animation, over which the tile may repeat
   * @param {Shape & {whole: boolean}} tileShape
   * @returns {{columns: number[], rows: number[], frames: Set<number>, wraps: boolean}}
   */
  function counted(shape, tileShape, kernel) {
    const { x, y, t } = reach(kernel);
    let wraps = false;
    const along = (length, period, [first, last]) => {
      const all = Array.from({ length }, (_, i) => i);
      if (tileShape.whole) return all;
      const copy = (i) => (i < length ? Math.floor(i / period) : NaN);
      const inside = all.filter((i) => i + first >= 0 && copy(i + first) === copy(i + last));
      wraps ||= inside.length === 0;
      return inside.length > 0 ? inside : all;
    };
    const columns = along(shape.width, tileShape.width, x);
    const rows = along(shape.height, tileShape.height, y);
    const frames = new Set(along(shape.frames, tileShape.frames, t));
    return { columns, rows, frames, wraps };
  }

  /** The sum of `term(i)` over those pixels i of a frame that count. */
  function sumOf({ columns, rows }, width, term) {
    let sum = 0;
    for (const y of rows) for (const x of columns) sum += term(y * width + x);
    return sum;
  }

  /**
   * The ratio to white noise: its expected squared error after the kernel is Var f · Σg²/spp.
   *
   * @param {number} meanSquare mean over the pixels and frames that count of (g*e)²
   * @param {number} variance of the integrand (for the soft shadow, its mean over the same pixels)
   */
  function ratio(meanSquare, variance, kernel, spp) {
    return meanSquare / ((variance * (kernel ? kernel.power : 1)) / spp);
  }

  Object.assign(perceptile, { modulo, filter, counted, sumOf, ratio });
})((globalThis.perceptileViewer ??= {}));
