// The parts of the viewer that know of no page, against sums that anybody can check.
import assert from 'node:assert/strict';
import test from 'node:test';
import { flat, kernel, lattice, random, views, whiteNoise } from './fixture.mjs';
import { load, script } from './sources.mjs';

const viewer = load();

const finish = (work) => {
  for (;;) {
    const { value, done } = work.next();
    if (done) return value;
  }
};

const base64 = (numbers) => {
  const bytes = Buffer.alloc(2 * numbers.length);
  numbers.forEach((number, i) => bytes.writeUInt16LE(number, 2 * i));
  return bytes.toString('base64');
};

/** Does a job on a bench of its own. */
function work(numbers, job) {
  const bench = new viewer.Bench();
  finish(bench.addTile(0, base64(numbers)));
  const frames = [];
  let ratio = NaN;
  let wraps = null;
  const tileShape = { whole: true, ...job.tileShape };
  finish(bench.work({ key: 'job', tile: 0, ...job, tileShape }, (message) => {
    if (message.type === 'frame') frames[message.t] = message.values;
    else ({ ratio, wraps } = message);
  }));
  return { frames, ratio, wraps };
}

const DESCRIPTIONS = [
  { kind: 'edge', angle: 30, offset: 0.1 },
  { kind: 'edge', angle: 90, offset: -0.2 },
  { kind: 'edge', angle: 180, offset: 0.3 },
  { kind: 'edge', angle: 225, offset: 0.45 },
  { kind: 'disk', x: 0.5, y: 0.5, radius: 0.3 },
  { kind: 'disk', x: 0.1, y: 0.9, radius: 0.45 },
  { kind: 'disk', x: 1, y: 0, radius: 0.65 },
  { kind: 'disk', x: 0.5, y: 0.3, radius: 0.6 },
  { kind: 'bump', x: 0.5, y: 0.5, sigma: 0.18 },
  { kind: 'bump', x: 0, y: 0.8, sigma: 0.05 },
  { kind: 'linear', angle: 30 },
  { kind: 'linear', angle: 250 },
];

test('integrals and variances are those of a fine grid', () => {
  const side = 1000;
  for (const description of DESCRIPTIONS) {
    for (const line of [false, true]) {
      const { at, integral, variance } = viewer.integrand(description, line);
      let sum = 0;
      let square = 0;
      const rows = line ? 1 : side;
      for (let j = 0; j < rows; j += 1) {
        for (let i = 0; i < side; i += 1) {
          const value = at((i + 0.5) / side, (j + 0.5) / rows);
          sum += value;
          square += value * value;
        }
      }
      const mean = sum / side / rows;
      const label = JSON.stringify([description, line]);
      // A grid misses an edge by about half a cell of a line, and by far less of the square.
      const tolerance = line ? 2e-3 : 2e-4;
      assert.ok(Math.abs(mean - integral) < tolerance, `${label}: ${integral} for ${mean}`);
      assert.ok(Math.abs(square / side / rows - mean * mean - variance) < tolerance, `${label}: variance ${variance}`);
    }
  }
});

test('the area of disks in the square is right wherever they lie', () => {
  const next = random(11);
  for (let n = 0; n < 60; n += 1) {
    const [x, y, r] = [3 * next() - 1, 3 * next() - 1, 0.05 + 1.5 * next()];
    const side = 400;
    let count = 0;
    for (let j = 0; j < side; j += 1) {
      for (let i = 0; i < side; i += 1) count += ((i + 0.5) / side - x) ** 2 + ((j + 0.5) / side - y) ** 2 < r * r;
    }
    const area = viewer.diskInSquare(x, y, r);
    assert.ok(Math.abs(count / side / side - area) < 1e-3, `${x} ${y} ${r}: ${area}`);
  }
});

test('what is free of the light is what rays that are traced find', () => {
  const shape = { width: 20, height: 14, frames: 6 };
  const shadow = new viewer.Shadow({ size: 0.2, softness: 0.5 }, shape, false);
  // The scene in space: the light at height 1 over the picture's middle, the blocker at 1/4.
  const [light, height] = [1.5, 0.25];
  const blockerRadius = 0.2 * (1 - height);
  for (const [x, y, t] of [[3, 2, 0], [10, 7, 1], [14, 7, 0], [13, 4, 5], [12, 6, 0], [8, 9, 3]]) {
    const point = [(x + 0.5) / 20, (y + 0.5) / 20];
    const middle = [0.5, 0.35];
    const turn = (2 * Math.PI * t) / 6;
    const around = [middle[0] + 0.2 * Math.cos(turn), middle[1] + 0.2 * Math.sin(turn)];
    const blocker = around.map((at, i) => at * (1 - height) + middle[i] * height);
    const side = 200;
    let free = 0;
    for (let j = 0; j < side; j += 1) {
      for (let i = 0; i < side; i += 1) {
        const lamp = [middle[0] + light * ((i + 0.5) / side - 0.5), middle[1] + light * ((j + 0.5) / side - 0.5)];
        const crossing = point.map((p, k) => p + height * (lamp[k] - p));
        free += Math.hypot(crossing[0] - blocker[0], crossing[1] - blocker[1]) >= blockerRadius;
      }
    }
    const [startX, startY] = shadow.start(t);
    const found = shadow.free(startX - x * shadow.step, startY - y * shadow.step);
    assert.ok(Math.abs(found - free / side / side) < 2e-3, `${x} ${y} ${t}: ${found} for ${free / side / side}`);
  }
});

/** Every tap by itself, wrapping around. */
function direct(errors, { width, height, frames }, { planes, slices }, x, y, t) {
  const wrap = (value, period) => ((value % period) + period) % period;
  let sum = 0;
  for (const { dt, plane, scale } of slices) {
    const { x: left, y: top, width: w, height: h, weights } = planes[plane];
    for (let j = 0; j < h; j += 1) {
      for (let i = 0; i < w; i += 1) {
        const at = (wrap(t + dt, frames) * height + wrap(y + top + j, height)) * width + wrap(x + left + i, width);
        sum += scale * weights[j * w + i] * errors[at];
      }
    }
  }
  return sum;
}

test('the filter is the sum over its taps, wrapping around in x, y and t', () => {
  const next = random(5);
  const odd = { x: -1, y: -4, width: 2, height: 5, row: null, column: null, weights: Array.from({ length: 10 }, () => next() - 0.4) };
  const unused = { ...odd, weights: odd.weights.map(() => 1e9) };
  const [plane] = kernel([1]).planes;
  const kernels = [
    kernel([0.5, 0.3, -0.2]),
    { power: 1, planes: [plane, odd, unused], slices: [{ dt: 0, plane: 0, scale: 0.4 }, { dt: -1, plane: 1, scale: 1 }, { dt: -9, plane: 0, scale: -0.2 }, { dt: 1, plane: 1, scale: 0.5 }] },
    { power: 1, planes: [{ ...plane, row: null, column: null }], slices: [{ dt: -2, plane: 0, scale: 1 }] },
  ];
  // The last shape is smaller than the kernel.
  for (const shape of [{ width: 11, height: 9, frames: 4 }, { width: 5, height: 6, frames: 2 }]) {
    const errors = Float32Array.from({ length: shape.width * shape.height * shape.frames }, () => next() - 0.5);
    for (const one of kernels) {
      const frames = [];
      finish(viewer.filter(errors, shape, one, (t, values) => (frames[t] = values)));
      assert.equal(frames.length, shape.frames);
      for (let t = 0; t < shape.frames; t += 1) {
        for (let y = 0; y < shape.height; y += 1) {
          for (let x = 0; x < shape.width; x += 1) {
            const expected = direct(errors, shape, one, x, y, t);
            assert.ok(Math.abs(frames[t][y * shape.width + x] - expected) < 1e-6, `${x} ${y} ${t}`);
          }
        }
      }
    }
  }
});

test('numbers of 16 bits survive base64, at every length of its end', () => {
  for (const length of [0, 1, 2, 3, 4, 5, 98303, 98304, 98305]) {
    const next = random(length);
    const numbers = Uint16Array.from({ length }, () => next() * 65536);
    assert.deepEqual([...finish(viewer.decode(base64(numbers)))], [...numbers], `length ${length}`);
  }
});

test('white noise scores 1, whatever is integrated, seen and sampled', () => {
  for (const spp of [1, 3]) {
    const tileShape = { width: 128, height: 64, frames: 32, spp };
    const numbers = whiteNoise(tileShape, 20 + spp);
    for (const { kernel: one } of views().slice(0, 2)) {
      for (const integrand of [DESCRIPTIONS[0], DESCRIPTIONS[5], DESCRIPTIONS[8], DESCRIPTIONS[10]]) {
        const shape = { width: 128, height: 64, frames: 32 };
        const { ratio } = work(numbers, { kind: 'error', tileShape, shape, integrand, kernel: one });
        assert.ok(Math.abs(ratio - 1) < (one ? 0.15 : 0.03), `${integrand.kind} ${spp}: ${ratio}`);
      }
      const shape = { width: 128, height: 64, frames: 64 };
      const integrand = { kind: 'shadow', size: 0.22, softness: 0.5 };
      const { ratio } = work(numbers, { kind: 'error', tileShape, shape, integrand, kernel: one });
      assert.ok(Math.abs(ratio - 1) < (one ? 0.25 : 0.05), `shadow ${spp}: ${ratio}`);
    }
  }
});

test('the ratio is that of the definition', () => {
  const tileShape = { width: 16, height: 12, frames: 5, spp: 1 };
  const shape = { width: 16, height: 12, frames: 5 };
  const numbers = lattice(shape);
  const one = views()[1].kernel;
  const { ratio } = work(numbers, { kind: 'error', tileShape, shape, integrand: DESCRIPTIONS[4], kernel: one });
  const share = Math.PI * 0.09;
  const errors = Array.from({ length: numbers.length / 2 }, (_, i) => {
    const [u, v] = [(numbers[2 * i] + 0.5) / 65536, (numbers[2 * i + 1] + 0.5) / 65536];
    return (Math.hypot(u - 0.5, v - 0.5) < 0.3 ? 1 : 0) - share;
  });
  let sum = 0;
  for (let i = 0; i < errors.length; i += 1) {
    sum += direct(errors, shape, one, i % 16, Math.floor(i / 16) % 12, Math.floor(i / 192)) ** 2;
  }
  const expected = sum / errors.length / (share * (1 - share) * one.power);
  assert.ok(Math.abs(ratio / expected - 1) < 1e-5, `${ratio} for ${expected}`);
});

test('the figure of a part is that of the same pixels of the whole tile', () => {
  const whole = { width: 40, height: 36, frames: 14 };
  const numbers = lattice(whole);
  const cut = { width: 20, height: 17, frames: 10, spp: 1, whole: false };
  const part = new Uint16Array(cut.width * cut.height * cut.frames * 2);
  let to = 0;
  for (let t = 0; t < cut.frames; t += 1) {
    for (let y = 0; y < cut.height; y += 1) {
      const from = 2 * whole.width * (t * whole.height + y);
      part.set(numbers.subarray(from, from + 2 * cut.width), to);
      to += 2 * cut.width;
    }
  }
  const share = Math.PI * 0.09;
  const errors = Array.from({ length: numbers.length / 2 }, (_, i) => {
    const [u, v] = [(numbers[2 * i] + 0.5) / 65536, (numbers[2 * i + 1] + 0.5) / 65536];
    return (Math.hypot(u - 0.5, v - 0.5) < 0.3 ? 1 : 0) - share;
  });
  const [plane] = kernel([1]).planes;
  const late = { ...plane, x: -1, y: 2 };
  const aside = { power: 0.3, planes: [plane, late], slices: [{ dt: 1, plane: 1, scale: 0.5 }, { dt: -2, plane: 1, scale: 1 }] };
  // Of each kernel, the columns, rows and frames of the part for which it stays inside.
  for (const [one, [x0, x1], [y0, y1], [t0, t1]] of [
    [kernel([0.5, 0.3, -0.2]), [3, 17], [3, 14], [2, 10]],
    [aside, [1, 15], [0, 9], [2, 9]],
  ]) {
    let [sum, count] = [0, 0];
    for (let t = t0; t < t1; t += 1) {
      for (let y = y0; y < y1; y += 1) {
        for (let x = x0; x < x1; x += 1, count += 1) sum += direct(errors, whole, one, x, y, t) ** 2;
      }
    }
    const expected = sum / count / (share * (1 - share) * one.power);
    const job = { kind: 'error', tileShape: cut, shape: { width: 20, height: 17, frames: 10 }, integrand: DESCRIPTIONS[4], kernel: one };
    const { ratio, wraps } = work(part, job);
    assert.ok(Math.abs(ratio / expected - 1) < 1e-5, `${ratio} for ${expected}`);
    assert.equal(wraps, false);
    const rolled = work(part, { ...job, tileShape: { ...cut, whole: true } });
    assert.ok(Math.abs(rolled.ratio / expected - 1) > 0.05, 'the ends make a difference');
  }
});

test('a part that is shorter than the kernel wraps, and says so', () => {
  const shape = { width: 16, height: 5, frames: 8 };
  const numbers = whiteNoise(shape, 4);
  const one = kernel([0.6, 0.4]);
  const job = { kind: 'error', tileShape: { ...shape, spp: 1, whole: false }, shape, integrand: DESCRIPTIONS[4], kernel: one };
  const { frames, ratio, wraps } = work(numbers, job);
  assert.equal(wraps, true);
  let [sum, count] = [0, 0];
  for (let t = 1; t < 8; t += 1) {
    for (let y = 0; y < 5; y += 1) {
      for (let x = 3; x < 13; x += 1, count += 1) sum += frames[t][y * 16 + x] ** 2;
    }
  }
  const share = Math.PI * 0.09;
  assert.ok(Math.abs(ratio / (sum / count / (share * (1 - share) * one.power)) - 1) < 1e-5);
});

test('where a part repeats, its inner ends are left out, too', () => {
  const tile = { width: 12, height: 12, frames: 4 };
  const shape = { width: 24, height: 24, frames: 8 };
  const integrand = { kind: 'shadow', size: 0.25, softness: 0.6 };
  const one = kernel([0.6, 0.4]);
  const job = { tileShape: { ...tile, spp: 1, whole: false }, shape, integrand, kernel: one };
  const numbers = whiteNoise(tile, 8);
  const { frames, ratio } = work(numbers, { ...job, kind: 'error' });
  const truth = work(numbers, { ...job, kind: 'truth', kernel: null });
  let [sum, variance] = [0, 0];
  for (const t of [1, 2, 3, 5, 6, 7]) {
    for (const y of [3, 4, 5, 6, 7, 8, 15, 16, 17, 18, 19, 20]) {
      for (const x of [3, 4, 5, 6, 7, 8, 15, 16, 17, 18, 19, 20]) {
        sum += frames[t][y * 24 + x] ** 2;
        variance += truth.frames[t][y * 24 + x] * (1 - truth.frames[t][y * 24 + x]);
      }
    }
  }
  assert.ok(Math.abs(ratio / (sum / (variance * one.power)) - 1) < 1e-5, `${ratio}`);
});

test('tiles of one dimension are integrated along their line', () => {
  const tileShape = { width: 64, height: 64, frames: 16, spp: 1, dims: 1 };
  const shape = { width: 64, height: 64, frames: 16 };
  const numbers = flat(tileShape);
  for (const integrand of [DESCRIPTIONS[0], DESCRIPTIONS[4], DESCRIPTIONS[8], DESCRIPTIONS[10], { kind: 'shadow', size: 0.22, softness: 0.5 }]) {
    const { ratio, frames } = work(numbers, { kind: 'error', tileShape, shape, integrand, kernel: null });
    assert.ok(Math.abs(ratio - 1) < 0.05, `${integrand.kind}: ${ratio}`);
    const mean = frames.reduce((sum, frame) => sum + frame.reduce((a, b) => a + b), 0) / (64 * 64 * 16);
    assert.ok(Math.abs(mean) < 0.01, `${integrand.kind}: mean ${mean}`);
  }
});

test('the soft shadow is its truth and an error that averages to nothing', () => {
  const tileShape = { width: 16, height: 16, frames: 4, spp: 64 };
  const shape = { width: 32, height: 32, frames: 8 };
  const integrand = { kind: 'shadow', size: 0.25, softness: 0.6 };
  const numbers = whiteNoise(tileShape, 77);
  const truth = work(numbers, { kind: 'truth', tileShape, shape, integrand, kernel: null });
  const error = work(numbers, { kind: 'error', tileShape, shape, integrand, kernel: null });
  assert.equal(truth.frames.length, 8);
  let [sum, count] = [0, 0];
  for (let t = 0; t < 8; t += 1) {
    for (let i = 0; i < 32 * 32; i += 1) {
      const [p, e] = [truth.frames[t][i], error.frames[t][i]];
      // A share of 64 samples: p + e is a multiple of 1/64, and between 0 and 1.
      const samples = 64 * (p + e);
      assert.ok(Math.abs(samples - Math.round(samples)) < 1e-3 && samples > -1e-3 && samples < 64.001);
      if (p > 0 && p < 1) [sum, count] = [sum + e, count + 1];
    }
  }
  assert.ok(count > 500 && Math.abs(sum / count) < 0.01, `${sum / count} over ${count}`);
});

test('a tile that holds too little says so', () => {
  const bench = new viewer.Bench();
  finish(bench.addTile(3, base64(new Uint16Array(10))));
  const shape = { width: 4, height: 4, frames: 2 };
  const job = { key: 'job', kind: 'error', tile: 3, tileShape: { ...shape, spp: 1, whole: true }, shape, integrand: DESCRIPTIONS[0], kernel: null };
  assert.throws(() => finish(bench.work(job, () => {})), /tile 3 holds 10 numbers, not 64/);
});

test('the queue does what is wanted last, and tells of failures', () => {
  const messages = [];
  const later = [];
  const queue = new viewer.Queue((message) => messages.push(message), Infinity, (run) => later.push(run));
  const settle = () => {
    while (later.length > 0) later.shift()();
  };
  const shape = { width: 4, height: 4, frames: 2 };
  const job = (key, tile) => ({ key, kind: 'error', tile, tileShape: { ...shape, spp: 1, whole: true }, shape, integrand: DESCRIPTIONS[0], kernel: null });
  queue.receive({ type: 'want', jobs: [job('dropped', 0)] });
  queue.receive({ type: 'tile', number: 0, text: base64(whiteNoise({ ...shape, spp: 1 })) });
  queue.receive({ type: 'want', jobs: [job('first', 0), job('broken', 9), job('last', 0)] });
  settle();
  const ends = messages.filter(({ type }) => type !== 'frame').map(({ type, key }) => [type, key]);
  assert.deepEqual(ends, [['done', 'first'], ['failed', 'broken'], ['done', 'last']]);
  assert.equal(messages.filter(({ key, type }) => key === 'first' && type === 'frame').length, 2);
});

test('the queue drops what is under way when it is no longer wanted', () => {
  const messages = [];
  const later = [];
  const queue = new viewer.Queue((message) => messages.push(message), 0.2, (run) => later.push(run));
  const shape = { width: 64, height: 64, frames: 64 };
  const job = (key) => ({ key, kind: 'error', tile: 0, tileShape: { ...shape, spp: 1, whole: true }, shape, integrand: DESCRIPTIONS[8], kernel: null });
  queue.receive({ type: 'tile', number: 0, text: base64(whiteNoise({ ...shape, spp: 1 })) });
  queue.receive({ type: 'want', jobs: [job('old')] });
  while (!messages.some(({ type, key }) => type === 'progress' && key === 'old')) later.shift()();
  queue.receive({ type: 'want', jobs: [job('new')] });
  while (later.length > 0) later.shift()();
  const ends = messages.filter(({ type }) => type === 'done').map(({ key }) => key);
  assert.deepEqual(ends, ['new']);
});

test('a display at the rate of the animation shows every frame once', () => {
  const next = random(3);
  const jitter = () => 16.683 + 6 * (next() - 0.5);
  for (const [fps, speed, refreshes, frames] of [[60, 1, 1, 1], [60, 0.5, 2, 1], [60, 0.25, 4, 1], [120, 1, 1, 2]]) {
    const clock = new viewer.Clock(fps);
    clock.speed = speed;
    clock.play();
    const shown = [];
    for (let n = 0, now = 0; n <= 600; n += 1, now += jitter()) {
      clock.tick(now);
      shown.push(clock.frame);
    }
    // The first second finds out the display's rate.
    for (let n = 60; n + refreshes <= 600; n += 1) {
      assert.equal(shown[n + refreshes] - shown[n], frames, `${fps} ${speed} ${n}`);
    }
  }
});

test('a display at another rate keeps the time', () => {
  const clock = new viewer.Clock(60);
  clock.play();
  for (let n = 0; n <= 750; n += 1) clock.tick(n * (1000 / 75));
  assert.ok(Math.abs(clock.frame - 600) < 6, `${clock.frame}`);
  clock.stop();
  clock.tick(1e6);
  assert.ok(Math.abs(clock.frame - 600) < 6);
});

test('the rate is of frames that follow each other', () => {
  const rate = new viewer.Rate();
  let now = 0;
  const play = (frames, each) => {
    for (let n = 0; n < frames; n += 1) {
      rate.add(now);
      now += each;
    }
  };
  play(90, 1000 / 60);
  assert.ok(Math.abs(rate.value - 60) < 1.5, `${rate.value}`);
  // The page rests for six seconds, and goes on.
  now += 6000;
  play(90, 1000 / 60);
  assert.ok(Math.abs(rate.value - 60) < 1.5, `${rate.value}`);
  rate.forget();
  assert.equal(rate.value, null);
  play(40, 1000 / 15);
  assert.ok(Math.abs(rate.value - 15) < 1, `${rate.value}`);
});

test('the script can stand inside a page', () => {
  assert.doesNotMatch(script(), /<\/script|<!--/i);
});
