// Textures as others read them: ktx-parse, and three.js with a shader of ours on WebGL2.
//
// TEXTURES names a folder of exports, which run.sh makes: NAME.ktx2 (an array), NAME-3d.ktx2, NAME.raw with
// NAME.raw.json, and NAME.glsl for the volume.
import assert from 'node:assert/strict';
import { existsSync, readFileSync } from 'node:fs';
import { extname, join, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';
import { after, before, test } from 'node:test';
import { read, KHR_DF_TRANSFER_LINEAR } from 'ktx-parse';
import { chromium } from 'playwright-core';
import { LONG, newContext } from './harness.mjs';

const folder = process.env.TEXTURES ? resolve(process.env.TEXTURES) : null;
const skip = folder ? false : 'TEXTURES names no folder';
const HOME = 'http://perceptile.test/';
const root = fileURLToPath(new URL('../../', import.meta.url));
const here = fileURLToPath(new URL('./', import.meta.url));

/** The names of the exports, and the numbers that one texel has. */
const TILES = { pair: 2, scalar: 1, sphere: 3 };

const described = (name) => JSON.parse(readFileSync(join(folder, `${name}.raw.json`), 'utf8'));
const texels = (name) => new Uint8Array(readFileSync(join(folder, `${name}.raw`)));

for (const name of Object.keys(TILES)) {
  test(`ktx-parse reads the ${name} tile`, { skip }, () => {
    const { width, height, frames, spp, channels } = described(name);
    for (const [file, volume] of [[`${name}.ktx2`, false], [`${name}-3d.ktx2`, true]]) {
      const container = read(new Uint8Array(readFileSync(join(folder, file))));
      assert.equal(container.vkFormat, { 1: 9, 2: 16, 4: 37 }[channels]);
      assert.deepEqual([container.pixelWidth, container.pixelHeight], [width, height]);
      const layers = frames * spp;
      assert.deepEqual([container.pixelDepth, container.layerCount], volume ? [layers, 0] : [0, layers]);
      assert.equal(container.supercompressionScheme, 0);
      assert.equal(container.levels.length, 1);
      assert.equal(container.dataFormatDescriptor[0].transferFunction, KHR_DF_TRANSFER_LINEAR);
        assert.match(String(container.keyValue.KTXwriter), /^Perceptile /);
      assert.deepEqual(Buffer.from(container.levels[0].levelData), Buffer.from(texels(name)));
    }
  });
}

let browser;
before(async () => {
  if (!folder) return;
  browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'],
    timeout: LONG,
  });
});
after(() => browser?.close());

const KINDS = { '.html': 'text/html', '.js': 'text/javascript', '.ktx2': 'image/ktx2', '.glsl': 'text/plain' };

/** A page of a site that has the project's examples, three.js, and the textures. */
async function open(address) {
  const context = await newContext(browser, { viewport: { width: 900, height: 760 } });
  const page = await context.newPage();
  const complaints = [];
  page.on('console', (message) => message.type() === 'error' && complaints.push(message.text()));
  page.on('pageerror', (error) => complaints.push(error.stack));
  await context.route(`${HOME}**`, async (route) => {
    const path = new URL(route.request().url()).pathname.slice(1);
    const places = path.includes('node_modules/')
      ? [join(here, path.slice(path.indexOf('node_modules/')))]
      : [join(folder, path.split('/').pop()), join(root, path)];
    const file = places.find((place) => existsSync(place));
    if (path === '') await route.fulfill({ contentType: 'text/html', body: '<!doctype html><title>.</title>' });
    else if (!file) await route.fulfill({ status: 404 });
    else await route.fulfill({ contentType: KINDS[extname(file)] ?? 'application/octet-stream', body: readFileSync(file) });
  });
  await page.goto(HOME + address);
  return { page, complaints, close: () => context.close() };
}

for (const [name, dims] of Object.entries(TILES)) {
  test(`three.js and the exported function read every sample of the ${name} tile`, { skip }, async () => {
    const { width, height, frames, spp, channels } = described(name);
    const { page, complaints, close } = await open('');
    await page.setContent(`<!doctype html><base href="${HOME}"><script type="importmap">{"imports": {
      "three": "${HOME}node_modules/three/build/three.module.js",
      "three/addons/": "${HOME}node_modules/three/examples/jsm/"}}</script>
      <script type="module">import * as THREE from 'three';
      import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';
      Object.assign(window, { THREE, KTX2Loader });</script>`);
    await page.waitForFunction(() => window.KTX2Loader);
    const found = await page.evaluate(async ({ name, dims, width, height, frames, spp }) => {
      const { THREE, KTX2Loader } = window;
      const renderer = new THREE.WebGLRenderer();
      const loader = new KTX2Loader().detectSupport(renderer);
      const texture = await loader.loadAsync(`${document.baseURI}${name}-3d.ktx2`);
      if (!texture.isData3DTexture) throw new Error('no volume');
      texture.minFilter = texture.magFilter = THREE.NearestFilter;
      texture.needsUpdate = true;
      const header = await (await fetch(`${document.baseURI}${name}.glsl`)).text();
      const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType, depthBuffer: false });
      const padded = ['vec4(p, 0, 0, 0)', 'vec4(p, 0, 0)', 'vec4(p, 0)'][dims - 1];
      const material = new THREE.RawShaderMaterial({
        glslVersion: THREE.GLSL3,
        vertexShader: 'in vec3 position; void main() { gl_Position = vec4(position, 1.0); }',
        fragmentShader: `precision highp float; precision highp int; precision highp sampler3D;
          ${header}
          uniform sampler3D tile; uniform uvec3 place; out vec4 color;
          void main() {
            ${['float', 'vec2', 'vec3'][dims - 1]} p =
              ${name}_point(tile, uvec2(gl_FragCoord.xy), place.x, place.y, place.z);
            color = ${padded};
          }`,
        uniforms: { tile: { value: texture }, place: { value: new THREE.Vector3() } },
        depthTest: false,
      });
      const quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
      const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);
      const numbers = [];
      for (let frame = 0; frame < frames; frame += 1) {
        for (let index = 0; index < spp; index += 1) {
          for (const number of [0, 1]) {
            material.uniforms.place.value = [frame, index, number];
            renderer.setRenderTarget(target);
            renderer.render(quad, camera);
            const pixels = new Float32Array(4 * width * height);
            renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
            numbers.push(Array.from(pixels));
          }
        }
      }
      return numbers;
    }, { name, dims, width, height, frames, spp });
    assert.deepEqual(complaints, []);
    const levels = texels(name);
    let at = 0;
    for (let layer = 0; layer < frames * spp; layer += 1) {
      for (const number of [0n, 1n]) {
        // The other place, as the header describes it.
        const shift = (factor, size) => Number((((number * factor) % 4294967296n >> 16n) * BigInt(size)) >> 16n);
        const [dx, dy] = [shift(3242174889n, width), shift(2447445414n, height)];
        const pixels = found[at++];
        for (let y = 0; y < height; y += 1) {
          for (let x = 0; x < width; x += 1) {
            const texel = ((layer * height + ((y + dy) % height)) * width + ((x + dx) % width)) * channels;
            let point = Array.from({ length: dims }, (_, k) => (levels[texel + k] + 0.5) / 256);
            if (dims === 3) {
              point = point.map((u) => 2 * u - 1);
              const length = Math.hypot(...point);
              point = point.map((u) => u / length);
            }
            point.forEach((value, k) => {
              const pixel = pixels[4 * (y * width + x) + k];
              assert.ok(Math.abs(pixel - value) < 1e-6, `${name} ${layer} ${number} ${x} ${y} ${k}: ${pixel} ${value}`);
            });
          }
        }
      }
    }
    await close();
  });
}

test('the page of examples/three shows all noises, and accumulation calms them', { skip }, async () => {
  /** For each picture the mean and the mean square of what differs between neighbours. */
  const measure = async (address) => {
    const { page, complaints, close } = await open(address);
    await page.waitForSelector('body[data-ready]');
    assert.equal(await page.textContent('#trouble'), '');
    const names = await page.$$eval('#names div', (all) => all.map((it) => it.textContent));
    const picture = (await page.locator('#view').screenshot()).toString('base64');
    const result = await page.evaluate(async (picture) => {
      const image = new Image();
      image.src = `data:image/png;base64,${picture}`;
      await image.decode();
      const canvas = Object.assign(document.createElement('canvas'), { width: image.width, height: image.height });
      const context = canvas.getContext('2d');
      context.drawImage(image, 0, 0);
      const { data } = context.getImageData(0, 0, image.width, image.height);
      const sum = new Set();
      for (let i = 0; i < data.length; i += 4) sum.add(data[i]);
      return { width: image.width, levels: sum.size };
    }, picture);
    assert.deepEqual(complaints, []);
    await close();
    return { names, ...result };
  };
  const base = 'examples/three/index.html?tile=pair-3d.ktx2&frame=20';
  const raw = await measure(base);
  assert.deepEqual(raw.names, ['white noise', 'Perceptile']);
  const all = await measure(`${base}&fast=pair-3d.ktx2&accumulate`);
  assert.deepEqual(all.names, ['white noise', 'FAST', 'Perceptile']);
  assert.ok(all.levels > raw.levels, `${all.levels} levels of gray are more than ${raw.levels}`);
  const { page, close } = await open('examples/three/index.html?tile=pair.ktx2&frame=1');
  await page.waitForFunction(() => document.getElementById('trouble').textContent);
  assert.match(await page.textContent('#trouble'), /ktx2-3d/);
  await close();
});
