// A report as the program makes it, without the program: what the viewer needs and no more.
import { mkdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { deflateSync, crc32 as zlibCrc32 } from 'node:zlib';
import { read, script } from './sources.mjs';

export const POLICY =
  "default-src 'none'; img-src 'self' file: data:; style-src 'unsafe-inline'; " +
  "script-src 'self' file: 'unsafe-inline'; worker-src blob:; base-uri 'none'; form-action 'none'";

/** Uniform numbers in [0, 1) from a seed (mulberry32). */
export function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

const to16 = (value) => Math.min(Math.floor(value * 65536), 65535);

export function whiteNoise({ width, height, frames, spp = 1 }, seed = 1) {
  const next = random(seed);
  return Uint16Array.from({ length: width * height * frames * spp * 2 }, () => to16(next()));
}

/** A lattice of two coordinates whose errors alternate between neighbours; it wraps. */
export function lattice({ width, height, frames }) {
  const numbers = new Uint16Array(width * height * frames * 2);
  const turns = (share, period) => Math.round(share * period) / period;
  let at = 0;
  for (let t = 0; t < frames; t += 1) {
    for (let y = 0; y < height; y += 1) {
      for (let x = 0; x < width; x += 1) {
        const u = x * turns(0.7548777, width) + y * turns(0.5698403, height) + t * turns(0.6180339, frames);
        const v = x * turns(0.4142135, width) + y * turns(0.7320508, height) + t * turns(0.2360679, frames);
        numbers[at] = to16(u % 1);
        numbers[at + 1] = to16((v + 0.13) % 1);
        at += 2;
      }
    }
  }
  return numbers;
}

/** A tile of one dimension: its second coordinates are 1/2. */
export function flat(shape, seed = 3) {
  return whiteNoise(shape, seed).map((number, i) => (i % 2 ? 32768 : number));
}

/** The first taps of the perception kernel at 60 frames a second. */
const PERCEPTION = [
  0.0395582850655909, 0.39840976559982, 0.404689211439515, 0.177879764807883, 0.0419136195197315,
  -0.00678276096076438, -0.0170052838869954, -0.0150087151111371,
];

function convolve(a, b, length) {
  return Array.from({ length }, (_, n) => a.reduce((sum, value, i) => sum + value * (b[n - i] ?? 0), 0));
}

/** A kernel of the contract: a Gaussian of 7 × 7 pixels, and weights of the frames of the past. */
export function kernel(weights) {
  const gauss = [-3, -2, -1, 0, 1, 2, 3].map((d) => Math.exp((-d * d) / (2 * 2.1 * 2.1)));
  const total = gauss.reduce((a, b) => a + b);
  const line = gauss.map((g) => g / total);
  const range = weights.reduce((sum, weight) => sum + Math.abs(weight), 0);
  const slices = weights.map((weight, k) => ({ dt: -k, plane: 0, scale: weight / range }));
  const plane = { x: -3, y: -3, width: 7, height: 7, row: line, column: line, weights: line.flatMap((c) => line.map((r) => c * r)) };
  const sum = (values) => values.reduce((total, value) => total + value * value, 0);
  const power = sum(plane.weights) * sum(slices.map(({ scale }) => scale));
  return { power, planes: [plane], slices };
}

export function views() {
  const taa = Array.from({ length: 16 }, (_, j) => 0.2 * 0.8 ** j);
  const single = { x: 0, y: 0, width: 1, height: 1, row: [1], column: [1], weights: [1] };
  const taaKernel = { ...kernel(taa), planes: [single] };
  taaKernel.power = taaKernel.slices.reduce((sum, { scale }) => sum + scale * scale, 0);
  return [
    { name: 'Raw', kernel: null },
    { name: 'As perceived', kernel: kernel(PERCEPTION) },
    { name: 'With TAA', kernel: taaKernel },
    { name: 'TAA, as perceived', kernel: kernel(convolve(PERCEPTION, taa, 15)) },
  ];
}

/** An 8-bit grey PNG. */
export function png(width, height, grey) {
  const rows = Buffer.alloc(height * (width + 1));
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1) rows[y * (width + 1) + 1 + x] = Math.max(0, Math.min(255, Math.round(grey(x, y))));
  }
  const chunk = (type, data) => {
    const body = Buffer.concat([Buffer.from(type), data]);
    const size = Buffer.alloc(4);
    size.writeUInt32BE(data.length);
    const check = Buffer.alloc(4);
    check.writeUInt32BE(zlibCrc32 ? zlibCrc32(body) : crc32(body));
    return Buffer.concat([size, body, check]);
  };
  const header = Buffer.alloc(13);
  header.writeUInt32BE(width, 0);
  header.writeUInt32BE(height, 4);
  header[8] = 8;
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  return Buffer.concat([signature, chunk('IHDR', header), chunk('IDAT', deflateSync(rows)), chunk('IEND', Buffer.alloc(0))]);
}

function crc32(bytes) {
  let crc = ~0;
  for (const byte of bytes) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit += 1) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return ~crc >>> 0;
}

const STYLE = `
:root { color-scheme: light; --paper: #fbfaf8; --raised: #ffffff; --ink: #1c1b19; --muted: #5f5b55; --line: #dcd8d1; --accent: #1f5f8b; --on-accent: #ffffff; }
@media (prefers-color-scheme: dark) { :root { color-scheme: dark; --paper: #171614; --raised: #22201e; --ink: #ece9e4; --muted: #a8a29a; --line: #3b3834; --accent: #7fb8e0; --on-accent: #10202c; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 72rem; padding: 1rem; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
a { color: var(--accent); }
section > figure { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1rem 0; }
`;

const escape = (text) => text.replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
const json = (value) => JSON.stringify(value).replace(/</g, '\\u003c');

/**
 * Writes a report.
 *
 * @param {string} folder
 * @param {{name: string, width: number, height: number, frames: number, spp?: number,
 *   dims?: number, whole?: boolean, numbers: Uint16Array}[]} tiles
 * @param {object[]} scenes as in scenes-data
 */
export function writeReport(folder, tiles, scenes = []) {
  mkdirSync(join(folder, 'tiles'), { recursive: true });
  tiles.forEach(({ numbers }, number) => {
    const bytes = Buffer.alloc(numbers.length * 2);
    numbers.forEach((value, i) => bytes.writeUInt16LE(value, 2 * i));
    writeFileSync(join(folder, 'tiles', `${number}.js`), `perceptileTile(${number}, "${bytes.toString('base64')}")\n`);
  });
  const data = {
    fps: 60,
    views: views(),
    first: 1,
    tiles: tiles.map(({ name, width, height, frames, spp = 1, dims = 2, whole = true }, number) => ({ name, file: `tiles/${number}.js`, width, height, frames, spp, dims, whole })),
  };
  const figures = scenes.map(
    ({ name, pictures, width, height }) =>
      `<figure>${pictures.map((p) => `<img loading="lazy" width="${width}" height="${height}" src="${escape(p.file)}" alt="${escape(p.name)}">`).join('')}<figcaption>${escape(name)}</figcaption></figure>`,
  );
  const section = scenes.length > 0 ? `<section id="scenes"><h2>Scenes</h2>${figures.join('')}</section><script type="application/json" id="scenes-data">${json(scenes)}</script>` : '';
  const page = `<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Fixture</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="${POLICY}">
<style>${STYLE}${read('viewer.css')}</style></head>
<body><main><h1>Fixture</h1><p>A page for tests of the viewer.</p>
<h2>Viewer</h2><section id="viewer" aria-label="Viewer"><noscript>The viewer needs a script.</noscript></section>
${section}</main>
<script type="application/json" id="viewer-data">${json(data)}</script>
<script>${script()}</script></body></html>
`;
  writeFileSync(join(folder, 'index.html'), page);
}

/** A scene of grey shapes in the noise of several methods. */
function scene(folder, name, width, height, seed) {
  mkdirSync(join(folder, 'renders', String(seed)), { recursive: true });
  const truth = (x, y) => 90 + 80 * Math.sin(x / 23) * Math.cos(y / 31) + (Math.hypot(x - width / 2, y - height / 2) < 50 ? 60 : 0);
  const file = (of) => `renders/${seed}/${of}.png`;
  const write = (of, noise) => {
    const next = random(seed * 100 + noise);
    writeFileSync(join(folder, file(of)), png(width, height, (x, y) => truth(x, y) + noise * (next() - 0.5)));
    return file(of);
  };
  const methods = [['White noise', 90, 1], ['STBN', 50, 0.4], ['Ours', 25, 0.11]];
  const pictures = ['no TAA', 'TAA'].flatMap((view, v) =>
    methods.map(([method, noise, ratio]) => ({ name: method, view, file: write(`${method[0]}${v}`, noise / (v + 1)), value: 0.0123 * ratio, ratio })),
  );
  return {
    name,
    caption: 'Shapes of grey.',
    width,
    height,
    reference: write('reference', 0),
    views: ['no TAA', 'TAA'],
    pictures,
    crops: [{ x: 40, y: 60, size: 64 }, { x: 130, y: 20, size: 48 }],
  };
}

/** The usual report of the tests. */
export function writeFixture(folder) {
  mkdirSync(folder, { recursive: true });
  const shape = { width: 64, height: 64, frames: 16 };
  const several = { width: 24, height: 40, frames: 8, spp: 4 };
  const tiles = [
    { name: 'lattice', ...shape, numbers: lattice(shape) },
    { name: `several <samples> under a ${'wide'.repeat(50)} name`, ...several, numbers: whiteNoise(several, 7) },
    { name: 'one dimension', ...shape, dims: 1, numbers: flat(shape) },
    { name: 'part', ...shape, whole: false, numbers: whiteNoise(shape, 9) },
    { name: 'White noise', ...shape, numbers: whiteNoise(shape, 5) },
  ];
  writeReport(folder, tiles, [scene(folder, 'Cornell box', 256, 256, 1), scene(folder, 'Dragon', 320, 180, 2)]);
}

/** Four tiles of the size for which the speed is promised. */
export function writeLarge(folder) {
  mkdirSync(folder, { recursive: true });
  const shape = { width: 256, height: 256, frames: 16 };
  const names = ['one', 'two', 'three', 'White noise'];
  writeReport(folder, names.map((name, seed) => ({ name, ...shape, numbers: whiteNoise(shape, seed) })));
}
