// White noise, a foreign tile and a tile of Perceptile side by side, as they move: textures of `perceptile
// export --format ktx2-3d`, read by three.js.
//
// The address says what is shown: ?tile=tile.ktx2, &fast=FAST.ktx2 for a foreign tile, &accumulate for
// frames that are accumulated, &frame=20 for a still picture of so many frames.
import * as THREE from 'three';
import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';

const FPS = 60;
/** Weight of the newest frame. */
const ALPHA = 0.1;
/** Pixels of a picture, across and down. */
const SIDE = 256;

const asked = new URLSearchParams(location.search);
const element = (id) => document.getElementById(id);
const accumulate = element('accumulate');
const pause = element('pause');
accumulate.checked = asked.has('accumulate');

// Each column is a noise, each row a use of it. A texel's level b stands for (b + 0.5) / 256.
const DRAW = `
  precision highp sampler3D;
  uniform sampler3D tiles[2];
  uniform int columns, frame;
  out vec4 color;

  uint hash(uint x) {
    x ^= x >> 16; x *= 0x7feb352du; x ^= x >> 15; x *= 0x846ca68bu; x ^= x >> 16;
    return x;
  }

  vec2 white(ivec2 p) {
    uint a = hash(uint(p.x) + hash(uint(p.y) + hash(uint(frame))));
    return vec2(a, hash(a)) / 4294967296.0;
  }

  vec2 texel(sampler3D tile, ivec2 p) {
    ivec3 size = textureSize(tile, 0);
    vec2 level = texelFetch(tile, ivec3(p % size.xy, frame % size.z), 0).rg;
    return level * (255.0 / 256.0) + 0.5 / 256.0;
  }

  // A ground below a ball, lit by one point of a square lamp.
  float shadow(vec2 at, vec2 u) {
    vec3 ground = vec3(at.x * 4.0 - 2.0, 0.0, at.y * 4.0 - 2.0);
    vec3 lamp = vec3(1.2 * (u.x - 0.5), 3.0, 1.2 * (u.y - 0.5));
    vec3 way = lamp - ground;
    vec3 ball = vec3(0.0, 0.9, 0.0) - ground;
    float t = clamp(dot(ball, way) / dot(way, way), 0.0, 1.0);
    float lit = length(ball - t * way) < 0.6 ? 0.0 : 1.0;
    return lit * 4.0 / dot(way, way) * way.y / length(way);
  }

  void main() {
    ivec2 p = ivec2(gl_FragCoord.xy);
    int column = p.x / ${SIDE};
    vec2 u = white(p);
    if (column == columns - 1) u = texel(tiles[0], p);
    else if (column == 1) u = texel(tiles[1], p);
    vec2 at = vec2(p % ${SIDE}) / ${SIDE}.0;
    float value = p.y < ${SIDE} ? shadow(at, u) : float(at.x * 0.5 + 0.25 > u.x);
    color = vec4(vec3(value), 1.0);
  }`;

const MIX = `
  uniform sampler2D before, now;
  uniform float alpha;
  out vec4 color;
  void main() {
    ivec2 p = ivec2(gl_FragCoord.xy);
    color = mix(texelFetch(before, p, 0), texelFetch(now, p, 0), alpha);
  }`;

// Linear light to the screen.
const SHOW = `
  uniform sampler2D picture;
  out vec4 color;
  void main() {
    vec3 linear = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;
    color = vec4(mix(linear * 12.92, 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055,
                     step(0.0031308, linear)), 1.0);
  }`;

async function load(loader, address) {
  const texture = await loader.loadAsync(address);
  if (!texture.isData3DTexture) throw new Error(`${address} is no volume: export it with --format ktx2-3d`);
  texture.minFilter = texture.magFilter = THREE.NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

async function start() {
  const renderer = new THREE.WebGLRenderer({ canvas: element('view') });
  renderer.autoClear = false;
  const loader = new KTX2Loader().detectSupport(renderer);
  const tile = await load(loader, asked.get('tile') ?? '../../tiles/vec2-60hz-3d.ktx2');
  const foreign = asked.has('fast') ? await load(loader, asked.get('fast')) : null;
  const names = ['white noise', ...(foreign ? ['FAST'] : []), 'Perceptile'];
  element('names').style.gridTemplateColumns = `repeat(${names.length}, 1fr)`;
  element('names').replaceChildren(...names.map((name) => Object.assign(document.createElement('div'), { textContent: name })));
  const [width, height] = [SIDE * names.length, 2 * SIDE];
  renderer.setPixelRatio(1);
  renderer.setSize(width, height, false);

  const target = () => new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType, depthBuffer: false });
  let [now, before, after] = [target(), target(), target()];
  const quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2));
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);
  const pass = (fragmentShader, values) =>
    new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      vertexShader: 'in vec3 position; void main() { gl_Position = vec4(position, 1.0); }',
      fragmentShader: `precision highp float; precision highp int;${fragmentShader}`,
      uniforms: Object.fromEntries(Object.entries(values).map(([name, value]) => [name, { value }])),
      depthTest: false,
    });
  const draw = pass(DRAW, { tiles: [tile, foreign ?? tile], columns: names.length, frame: 0 });
  const mix = pass(MIX, { before: null, now: null, alpha: 1 });
  const show = pass(SHOW, { picture: null });
  const render = (material, to, values) => {
    for (const [name, value] of Object.entries(values)) material.uniforms[name].value = value;
    quad.material = material;
    renderer.setRenderTarget(to);
    renderer.render(quad, camera);
  };

  let frames = 0;
  const step = (frame) => {
    render(draw, now, { frame });
    // The first frames are a plain mean, so that nothing has to fade in.
    const alpha = accumulate.checked ? Math.max(ALPHA, 1 / (frames + 1)) : 1;
    render(mix, after, { before: before.texture, now: now.texture, alpha });
    [before, after] = [after, before];
    render(show, null, { picture: before.texture });
    frames = accumulate.checked ? frames + 1 : 0;
  };
  const still = asked.get('frame');
  if (still !== null) {
    for (let frame = 0; frame <= Number(still); frame += 1) step(frame);
    document.body.dataset.ready = 'true';
    return;
  }
  let last = -1;
  renderer.setAnimationLoop((time) => {
    const frame = Math.floor((time * FPS) / 1000);
    if (frame !== last && !pause.checked) step(frame);
    last = frame;
    document.body.dataset.ready = 'true';
  });
}

start().catch((error) => {
  element('trouble').textContent = error.message;
});
