// The viewer in a browser: what every control does, and that pictures and figures are right.
//
// With REPORT=folder the same tests run on a real report; see harness.mjs.
import assert from 'node:assert/strict';
import { rmSync } from 'node:fs';
import { join } from 'node:path';
import test, { after, before } from 'node:test';
import { whiteNoise, writeFixture, writeLarge, writeReport } from './fixture.mjs';
import {
  REPORT, breaches, dataOf, greys, launch, newContext, open, paints, pictures, ratios, ready, report, samplesOf, settle, slide, temporary,
} from './harness.mjs';

let browser;
let made;
let data;
let scenes;

before(async () => {
  browser = await launch();
  made = report();
  data = dataOf(made.folder, 'viewer-data');
  scenes = dataOf(made.folder, 'scenes-data');
});
after(async () => {
  await browser.close();
  made.remove();
});

/** The tiles that are shown at first: up to four, white noise last. */
const firstTiles = () => (data.tiles.length > 4 ? [...data.tiles.slice(0, 3), data.tiles.at(-1)] : data.tiles);

const radio = (page, name, within = '#viewer') => page.locator(within).getByRole('radio', { name, exact: true });
const camera = async (page) => (await page.getAttribute('#viewer', 'data-camera')).split(' ').map(Number);

// --- What is right, by plain sums ----------------------------------------------------------------

/** The functions as the viewer first shows them, with integrals that need no code of ours. */
const FUNCTIONS = {
  Edge: { at: (u, v) => ((u - 0.5) * Math.cos(Math.PI / 6) + (v - 0.5) * 0.5 > 0 ? 1 : 0), integral: 0.5, variance: 0.25 },
  Disk: { at: (u, v) => (Math.hypot(u - 0.5, v - 0.5) < 0.35 ? 1 : 0), integral: Math.PI * 0.35 ** 2, variance: Math.PI * 0.35 ** 2 * (1 - Math.PI * 0.35 ** 2) },
  Linear: { at: (u, v) => u * Math.cos(Math.PI / 6) + v * 0.5, integral: (Math.cos(Math.PI / 6) + 0.5) / 2, variance: 1 / 12 },
};

function errorsOf(tile, { at, integral }, folder = made.folder) {
  const numbers = samplesOf(folder, tile);
  const { spp } = tile;
  return Float64Array.from({ length: numbers.length / 2 / spp }, (_, i) => {
    let sum = 0;
    for (let s = 2 * i * spp; s < 2 * (i + 1) * spp; s += 2) sum += at((numbers[s] + 0.5) / 65536, (numbers[s + 1] + 0.5) / 65536);
    return sum / spp - integral;
  });
}

/** The whole animation after a kernel: every tap of each plane, then every slice. */
function filtered(errors, { width, height, frames }, kernel) {
  if (!kernel) return errors;
  const wrap = (value, period) => ((value % period) + period) % period;
  const result = new Float64Array(errors.length);
  kernel.planes.forEach((plane, number) => {
    const spatial = errors.map((_, i) => {
      const [x, y, start] = [i % width, Math.floor(i / width) % height, Math.floor(i / width / height) * width * height];
      let sum = 0;
      for (let k = 0; k < plane.weights.length; k += 1) {
        const [dx, dy] = [plane.x + (k % plane.width), plane.y + Math.floor(k / plane.width)];
        sum += plane.weights[k] * errors[start + wrap(y + dy, height) * width + wrap(x + dx, width)];
      }
      return sum;
    });
    for (const { dt, scale } of kernel.slices.filter((slice) => slice.plane === number)) {
      for (let t = 0; t < frames; t += 1) {
        const [to, from] = [t, wrap(t + dt, frames)].map((frame) => frame * width * height);
        for (let i = 0; i < width * height; i += 1) result[to + i] += scale * spatial[from + i];
      }
    }
  });
  return result;
}

/** Of a part of a tile, the pixels for which the kernel does not reach beyond its ends. */
function inner(values, { width, height, frames }, { planes, slices }) {
  const stays = (at, length, taps) => taps.every(([first, last]) => at + first >= 0 && at + last < length);
  return values.filter((_, i) => {
    const [x, y, t] = [i % width, Math.floor(i / width) % height, Math.floor(i / width / height)];
    return (
      stays(x, width, planes.map((plane) => [plane.x, plane.x + plane.width - 1])) &&
      stays(y, height, planes.map((plane) => [plane.y, plane.y + plane.height - 1])) &&
      stays(t, frames, slices.map(({ dt }) => [dt, dt]))
    );
  });
}

/** What picture and figure of a tile must be. */
function expected(tile, of, kernel) {
  const values = filtered(errorsOf(tile, of), tile, kernel);
  const counted = tile.whole || !kernel ? values : inner(values, tile, kernel);
  const mean = counted.reduce((sum, value) => sum + value * value, 0) / counted.length;
  return { values, ratio: mean / ((of.variance * (kernel?.power ?? 1)) / tile.spp) };
}

/** Compares the first frame that is shown with what it must be; gain 4, nothing moved. */
function compare({ width, height, values }, { values: right }, tile, label) {
  const wrap = (value, period) => ((value % period) + period) % period;
  const left = Math.floor(tile.width / 2 - width / 2);
  const top = Math.floor(tile.height / 2 - height / 2);
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1) {
      const value = right[wrap(top + y, tile.height) * tile.width + wrap(left + x, tile.width)];
      const grey = Math.min(Math.max(127.5 + 255 * 4 * value, 0), 255);
      const shown = values[y * width + x];
      assert.ok(Math.abs(shown - grey) <= 1, `${label}, pixel ${x} ${y}: ${shown} for ${grey}`);
    }
  }
}

test('pictures and figures are those of the definition, in every view', async () => {
  const { page, close } = await open(browser, made.folder);
  assert.equal(await page.getAttribute('#viewer', 'data-frame'), '0');
  const tiles = firstTiles();
  for (const [number, { name, kernel }] of data.views.entries()) {
    await radio(page, name).check();
    await ready(page);
    const found = await ratios(page);
    for (const [slot, tile] of tiles.entries()) {
      const right = expected(tile, FUNCTIONS.Edge, kernel);
      assert.ok(Math.abs(found[slot] / right.ratio - 1) < 1e-4, `${name} of ${tile.name}: ${found[slot]} for ${right.ratio}`);
      compare(await greys(page, slot), right, tile, `${name} (${number}) of ${tile.name}`);
    }
    const words = await page.locator('#viewer .pv-words').first().textContent();
    assert.match(words.toLowerCase(), new RegExp(`of white noise’s error, ${name.toLowerCase()}`));
  }
  await close();
});

test('pictures and figures are those of the definition, for every integrand', async () => {
  const { page, close } = await open(browser, made.folder);
  const [view] = data.views.filter(({ kernel }) => kernel);
  const seen = new Set();
  for (const [name, of] of Object.entries(FUNCTIONS)) {
    await radio(page, name).check();
    await ready(page);
    const right = expected(data.tiles[0], of, view.kernel);
    const [ratio] = await ratios(page);
    assert.ok(Math.abs(ratio / right.ratio - 1) < 1e-4, `${name}: ${ratio} for ${right.ratio}`);
    compare(await greys(page, 0), right, data.tiles[0], name);
    seen.add(await pictures(page));
  }
  for (const name of ['Bump', 'Soft shadow']) {
    await radio(page, name).check();
    await ready(page);
    const noise = (await ratios(page)).at(-1);
    assert.ok(noise > 0.6 && noise < 1.5, `white noise, ${name}: ${noise}`);
    seen.add(await pictures(page));
  }
  assert.equal(seen.size, 5);
  await close();
});

test('tiles of several samples, of one dimension and parts of tiles are right, too', { skip: REPORT !== null }, async () => {
  const { page, close } = await open(browser, made.folder);
  const picker = page.getByLabel('Tile 1');
  await picker.selectOption({ label: data.tiles[1].name });
  await ready(page);
  const right = expected(data.tiles[1], FUNCTIONS.Edge, data.views[1].kernel);
  assert.ok(Math.abs((await ratios(page))[0] / right.ratio - 1) < 1e-4);
  compare(await greys(page, 0), right, data.tiles[1], 'several');

  await picker.selectOption({ label: 'one dimension' });
  await ready(page);
  await slide(page, 'Angle', 0);
  await slide(page, 'Offset', 0.2);
  await ready(page);
  const line = { at: (u) => (u > 0.7 ? 1 : 0), integral: 0.3, variance: 0.21 };
  const ratio = expected(data.tiles[2], line, data.views[1].kernel).ratio;
  assert.ok(Math.abs((await ratios(page))[0] / ratio - 1) < 1e-4);

  await picker.selectOption({ label: 'part (part of the tile)' });
  await slide(page, 'Offset', 0);
  await slide(page, 'Angle', 30);
  await ready(page);
  assert.match(await page.locator('#viewer .pv-note').first().textContent(), /, part of the tile$/);
  const cut = expected(data.tiles[3], FUNCTIONS.Edge, data.views[1].kernel);
  assert.ok(Math.abs((await ratios(page))[0] / cut.ratio - 1) < 1e-4);
  assert.deepEqual((({ width, height }) => [width, height])(await greys(page, 0)), [64, 64]);
  await close();
});

test('a tile of one dimension has a soft shadow of its own', { skip: REPORT !== null }, async () => {
  const { page, close } = await open(browser, made.folder);
  await page.getByLabel('Tile 2').selectOption({ label: 'one dimension' });
  await radio(page, 'Raw').check();
  await radio(page, 'Soft shadow').check();
  await ready(page);
  // One sample is all of the light or nothing of it, so truth and error together are, too.
  for (const slot of [0, 1]) {
    const { values } = await greys(page, slot);
    for (const grey of values) assert.ok(Math.abs(grey - 25.5) < 1 || Math.abs(grey - 229.5) < 1, `${grey}`);
  }
  await close();
});

test('a tile that cannot be loaded says so, and the others play', { skip: REPORT !== null }, async () => {
  const broken = temporary();
  writeFixture(broken.folder);
  rmSync(join(broken.folder, 'tiles', '3.js'));
  const { page, context, complaints } = await open(browser, broken.folder);
  const states = await page.evaluate(async () => {
    const pane = document.querySelector('#viewer .pv-pane');
    const square = () => getComputedStyle(pane.querySelector('.pv-layer'), '::after').content;
    const state = () => [pane.querySelector('.pv-ratio').value, pane.querySelector('.pv-note').textContent, pane.querySelector('.pv-canvas').hidden, square()];
    const angle = [...document.querySelectorAll('#viewer input[type=range]')].find((input) => input.labels[0].textContent === 'Angle');
    // The tile is chosen while other work is under way, which goes on for a moment.
    angle.value = '31';
    angle.dispatchEvent(new Event('input', { bubbles: true }));
    const select = pane.querySelector('select');
    select.value = '3';
    select.dispatchEvent(new Event('change', { bubbles: true }));
    const chosen = state();
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    return [chosen, state()];
  });
  for (const [figure, , hidden] of states) assert.deepEqual([figure, hidden], ['–', true]);
  assert.equal(states[0][3], '"preparing"');
  assert.equal(states[0][1], '64 × 64 × 16, part of the tile');
  await ready(page);
  const pane = page.locator('#viewer .pv-pane').first();
  assert.match(await pane.textContent(), /tiles\/3\.js could not be loaded/);
  assert.equal(await pane.locator('.pv-layer').evaluate((layer) => getComputedStyle(layer, '::after').content), '"no picture"');
  // Nothing of the tile before it is left.
  assert.equal(await pane.locator('.pv-ratio').textContent(), '–');
  assert.ok(!(await pane.locator('.pv-canvas').isVisible()));
  assert.deepEqual((({ width, height }) => [width, height])(await greys(page, 0)), [1, 1]);
  assert.ok((await ratios(page))[1] > 0.5);
  assert.ok(complaints.every((text) => /tiles\/3\.js|ERR_FILE_NOT_FOUND/.test(text)), complaints.join());
  await context.close();
  broken.remove();
});

// --- What the controls do ------------------------------------------------------------------------

test('sliders change the picture, and say their value', async () => {
  const { page, close } = await open(browser, made.folder);
  const moves = {
    Edge: [['Angle', 77, '77°'], ['Offset', 0.2, '0.20']],
    Disk: [['Centre, across', 0.3, '0.30'], ['Centre, down', 0.8, '0.80'], ['Radius', 0.2, '0.20']],
    Bump: [['Centre, across', 0.3, '0.30'], ['Centre, down', 0.8, '0.80'], ['Width', 0.1, '0.10']],
    Linear: [['Angle', 200, '200°']],
    'Soft shadow': [['Size', 0.3, '0.30'], ['Softness', 0.7, '0.70']],
  };
  for (const [kind, sliders] of Object.entries(moves)) {
    await radio(page, kind).check();
    await ready(page);
    for (const [name, value, words] of sliders) {
      const before = await pictures(page);
      await slide(page, name, value);
      await ready(page);
      assert.notEqual(await pictures(page), before, `${kind}: ${name}`);
      assert.equal(await page.locator('#viewer').getByRole('slider', { name, exact: true }).getAttribute('aria-valuetext'), words);
    }
  }
  const gain = page.locator('#viewer').getByRole('slider', { name: 'Gain' });
  assert.ok(await gain.isDisabled());
  let before = await pictures(page);
  await radio(page, 'Error').check();
  await ready(page);
  assert.notEqual(await pictures(page), before);
  assert.ok(!(await gain.isDisabled()));
  before = await pictures(page);
  await slide(page, 'Gain', 5);
  await settle(page);
  assert.notEqual(await pictures(page), before);
  await close();
});

test('a slider that is dragged fast ends at its last value', async () => {
  const { page, close } = await open(browser, made.folder);
  await page.locator('#viewer').getByRole('slider', { name: 'Angle' }).evaluate(async (node) => {
    for (let value = 31; value <= 120; value += 1) {
      node.value = String(value);
      node.dispatchEvent(new Event('input', { bubbles: true }));
      if (value % 10 === 0) await new Promise((done) => setTimeout(done, 20));
    }
  });
  await ready(page);
  const dragged = [await pictures(page), await ratios(page)];
  await slide(page, 'Angle', 10);
  await ready(page);
  await slide(page, 'Angle', 120);
  await ready(page);
  assert.deepEqual([await pictures(page), await ratios(page)], dragged);
  await close();
});

test('playback steps', async () => {
  const { page, close } = await open(browser, made.folder);
  const viewer = page.locator('#viewer');
  const frame = async () => Number(await page.getAttribute('#viewer', 'data-frame'));
  const first = await pictures(page);
  await viewer.getByRole('button', { name: 'One frame on' }).click();
  await settle(page);
  assert.equal(await frame(), 1);
  assert.notEqual(await pictures(page), first);
  await viewer.getByRole('button', { name: 'One frame back' }).click();
  await viewer.getByRole('button', { name: 'One frame back' }).click();
  await settle(page);
  assert.equal(await frame(), Math.max(...firstTiles().map(({ frames }) => frames)) - 1);
  await slide(page, 'Frame', 1);
  await settle(page);
  assert.equal(await pictures(page), first);
  await close();
});

test('playback starts, stops and keeps its speed', async () => {
  const { page, close } = await open(browser, made.folder, { still: true });
  const viewer = page.locator('#viewer');
  const shown = async (speed) => {
    await viewer.getByLabel('Speed').selectOption({ label: speed });
    await page.clock.runFor(160);
    const before = await paints(page);
    await page.clock.runFor(1600);
    return (await paints(page)) - before;
  };
  await viewer.getByRole('button', { name: 'Play' }).click();
  // A display that is refreshed every 16 ms counts as one of 60 frames a second.
  for (const [speed, share] of [['full', 1], ['½', 1 / 2], ['¼', 1 / 4]]) {
    const frames = await shown(speed);
    assert.ok(Math.abs(frames / (1.6 * data.fps * share) - 1) < 0.06, `${speed}: ${frames} in 1.6 s`);
  }
  await viewer.getByRole('button', { name: 'Pause' }).click();
  await page.clock.runFor(100);
  const paused = await pictures(page);
  await page.clock.runFor(200);
  assert.equal(await pictures(page), paused);
  await close();
});

test('the slider of the frame says of how many', { skip: REPORT !== null }, async () => {
  const { page, close } = await open(browser, made.folder);
  const slider = page.locator('#viewer').getByRole('slider', { name: 'Frame' });
  const [long, short] = [data.tiles[0], data.tiles[1]];
  assert.equal(await slider.getAttribute('aria-valuetext'), `1 of ${long.frames}`);
  for (const name of ['Tile 1', 'Tile 2', 'Tile 3', 'Tile 4']) await page.getByLabel(name).selectOption('1');
  assert.equal(await slider.getAttribute('aria-valuetext'), `1 of ${short.frames}`);
  assert.equal(await page.locator('#viewer .pv-transport output').first().textContent(), `1 of ${short.frames}`);
  await ready(page);
  await close();
});

test('while it plays, the slider of the frame moves', { skip: REPORT !== null }, async () => {
  const { page, close } = await open(browser, made.folder, { still: true });
  await page.locator('#viewer').getByRole('button', { name: 'Play' }).click();
  const slider = page.locator('#viewer').getByRole('slider', { name: 'Frame' });
  const seen = new Set();
  for (let turn = 0; turn < 8; turn += 1) {
    await page.clock.runFor(250);
    seen.add(await slider.inputValue());
  }
  assert.ok(seen.size >= 3, [...seen].join());
  await close();
});

test('stepping is even for tiles of unequal periods, in both directions', { skip: REPORT !== null }, async () => {
  const odd = temporary();
  const sizes = [['long', 16], ['short', 5]];
  writeReport(odd.folder, sizes.map(([name, frames]) => ({ name, width: 24, height: 24, frames, whole: frames > 8, numbers: whiteNoise({ width: 24, height: 24, frames }, frames) })));
  const { page, close } = await open(browser, odd.folder);
  // The kernel has eight frames.
  assert.deepEqual(await page.locator('#viewer .pv-note').allTextContents(), ['24 × 24 × 16', '24 × 24 × 5, part of the tile, ends wrap']);
  await radio(page, 'Raw').check();
  await ready(page);
  const tiles = dataOf(odd.folder, 'viewer-data').tiles;
  const right = tiles.map((tile) => errorsOf(tile, FUNCTIONS.Edge, odd.folder));
  const check = async (frame) => {
    await settle(page);
    for (const [slot, tile] of tiles.entries()) {
      const t = ((frame % tile.frames) + tile.frames) % tile.frames;
      const values = right[slot].slice(t * 576, (t + 1) * 576);
      compare(await greys(page, slot), { values }, tile, `frame ${frame} of ${tile.name}`);
    }
    assert.equal(await page.getAttribute('#viewer', 'data-frame'), String((frame + 160) % 16));
  };
  const step = (name) => page.locator('#viewer').getByRole('button', { name }).click();
  await slide(page, 'Frame', 15);
  for (const frame of [15, 16, 17]) {
    await step('One frame on');
    await check(frame);
  }
  await slide(page, 'Frame', 1);
  await check(16);
  await step('One frame back');
  await check(15);
  await slide(page, 'Frame', 1);
  for (const frame of [-1, -2]) {
    await step('One frame back');
    await check(frame);
  }
  await close();
  odd.remove();
});

test('the soft shadow is at one place in all pictures, whatever their periods', { skip: REPORT !== null }, async () => {
  // A common loop of few frames, and one that would be too long.
  for (const frames of [[16, 10], [63, 64]]) {
    const odd = temporary();
    // Many samples are close to the shadow itself.
    const shapes = frames.map((count) => ({ width: 64, height: 64, frames: count, spp: 4 }));
    writeReport(odd.folder, shapes.map((shape, number) => ({ name: `tile ${number}`, ...shape, numbers: whiteNoise(shape, number + 1) })));
    const { page, close } = await open(browser, odd.folder);
    await radio(page, 'Soft shadow').check();
    await ready(page);
    const last = Number(await page.locator('#viewer').getByRole('slider', { name: 'Frame' }).getAttribute('max'));
    for (const share of [0.3, 0.6, 0.95]) {
      await slide(page, 'Frame', Math.ceil(share * last));
      await settle(page);
      const [first, second] = [await greys(page, 0), await greys(page, 1)];
      const apart = first.values.reduce((sum, grey, i) => sum + Math.abs(grey - second.values[i]), 0) / first.values.length;
      assert.ok(apart < 8, `${frames} at ${share} of ${last}: ${apart}`);
    }
    await close();
    odd.remove();
  }
});

test('a pause and another speed do not make the display slow', async () => {
  const { page, close } = await open(browser, made.folder);
  const viewer = page.locator('#viewer');
  // A display of exactly 60 refreshes a second, whatever this machine has.
  await page.evaluate(() => {
    let time = performance.now();
    window.refreshes = 0;
    const refresh = (run) => {
      window.refreshes += 1;
      run((time = Math.max(time + 1000 / 60, window.leap ?? 0)));
    };
    window.requestAnimationFrame = (run) => setTimeout(() => refresh(run), 4);
  });
  const seconds = async (count) => {
    const end = (await page.evaluate(() => window.refreshes)) + 60 * count;
    await page.waitForFunction((all) => window.refreshes >= all, end, { polling: 50 });
  };
  await page.evaluate(() => {
    window.told = new Set();
    const status = document.querySelector('#viewer .pv-status');
    new MutationObserver(() => window.told.add(status.textContent)).observe(status, { childList: true });
  });
  const play = viewer.getByRole('button', { name: 'Play' });
  const pause = viewer.getByRole('button', { name: 'Pause' });
  await play.click();
  await seconds(2.5);
  await pause.click();
  await page.evaluate(() => (window.leap = performance.now() + 60000));
  await play.click();
  await seconds(2.5);
  await viewer.getByLabel('Speed').selectOption({ label: '¼' });
  await seconds(2.5);
  await viewer.getByLabel('Speed').selectOption({ label: 'full' });
  await seconds(2.5);
  const told = await page.evaluate(() => [...window.told].filter((text) => text.startsWith('This display')));
  assert.deepEqual(told, []);
  await close();
});

test('pictures come and go, up to four', async () => {
  const { page, close } = await open(browser, made.folder);
  const add = page.getByRole('button', { name: 'Add a picture' });
  const shown = () => page.locator('#viewer .pv-pane:not([hidden]) select').evaluateAll((lists) => lists.map(({ value }) => Number(value)));
  const first = firstTiles().map((tile) => data.tiles.indexOf(tile));
  assert.deepEqual(await shown(), first);
  for (let count = first.length; count < 4; count += 1) {
    await add.click();
    await ready(page);
  }
  assert.equal((await ratios(page)).length, 4);
  assert.ok(!(await add.isVisible()));
  for (let count = 4; count > 1; count -= 1) {
    await page.locator('#viewer').getByRole('button', { name: /^Remove/ }).first().click();
    await ready(page);
  }
  assert.equal((await ratios(page)).length, 1);
  assert.equal(await page.locator('#viewer').getByRole('button', { name: /^Remove/ }).count(), 0);
  // Comparing takes two.
  await radio(page, 'Swipe').check();
  await ready(page);
  assert.equal((await ratios(page)).length, 2);
  await close();
});

// --- Zoom and pan --------------------------------------------------------------------------------

test('zoom and pan show the same place of every picture', async () => {
  const { page, close } = await open(browser, made.folder);
  const [start] = await camera(page);
  const frame = page.locator('#viewer .pv-frame:visible').first();
  const box = await frame.boundingBox();
  const middle = [box.x + box.width / 2, box.y + box.height / 2];
  const before = await greys(page, 0);

  await page.mouse.move(...middle);
  await page.mouse.down();
  await page.mouse.move(middle[0] - 7 * start, middle[1] - 3 * start, { steps: 4 });
  await page.mouse.up();
  await settle(page);
  assert.deepEqual(await camera(page), [start, 7, 3]);
  const moved = await greys(page, 0);
  for (let y = 0; y < moved.height - 3; y += 1) {
    for (let x = 0; x < moved.width - 7; x += 1) {
      assert.equal(moved.values[y * moved.width + x], before.values[(y + 3) * before.width + x + 7]);
    }
  }

  // The wheel zooms the frame that has the focus. That it was turned is told before the page knows.
  await page.mouse.wheel(0, -100);
  await page.waitForFunction((zoom) => Number(document.getElementById('viewer').dataset.camera.split(' ')[0]) > zoom, start);
  await slide(page, 'Zoom', 8);
  await settle(page);
  const large = await greys(page, 0);
  assert.ok(large.width <= Math.ceil(box.width / 8) + 1);
  const style = await page.locator('#viewer .pv-canvas').first().evaluate((canvas) => [canvas.offsetWidth / canvas.width, getComputedStyle(canvas).imageRendering]);
  assert.deepEqual(style, [8, 'pixelated']);
  await page.locator('#viewer').getByRole('button', { name: 'Centre' }).click();
  await settle(page);
  assert.deepEqual(await camera(page), [start, 0, 0]);
  assert.deepEqual(await greys(page, 0), before);

  await page.locator('#viewer').getByRole('radio', { checked: true }).first().focus();
  await page.mouse.move(...middle);
  await page.mouse.wheel(0, -100);
  await page.waitForTimeout(100);
  assert.equal((await camera(page))[0], start, 'without the focus the wheel scrolls the page');
  await close();
});

test('the picture of the soft shadow does not leave its frame', async () => {
  const { page, close } = await open(browser, made.folder);
  await radio(page, 'Soft shadow').check();
  await ready(page);
  await slide(page, 'Zoom', 4);
  const frame = page.locator('#viewer .pv-frame:visible').first();
  await frame.focus();
  for (let press = 0; press < 80; press += 1) await page.keyboard.press('ArrowLeft');
  await settle(page);
  const [, x] = await camera(page);
  const box = await frame.boundingBox();
  assert.ok(x >= -128 + box.width / 8 - 1 && x < 0, `${x}`);
  await close();
});

// --- Swipe and flicker ---------------------------------------------------------------------------

test('the divider moves by hand and by keys', async () => {
  const { page, close } = await open(browser, made.folder);
  await radio(page, 'Swipe').check();
  await ready(page);
  const divider = page.locator('#viewer').getByRole('slider', { name: /Divider/ });
  const now = async () => Number(await divider.getAttribute('aria-valuenow'));
  const clip = () => page.locator('#viewer .pv-layer').nth(1).evaluate((layer) => layer.style.clipPath);
  assert.equal(await now(), 50);
  const stage = await page.locator('#viewer .pv-stage').boundingBox();
  const grip = await divider.boundingBox();
  await page.mouse.move(grip.x + grip.width / 2, grip.y + grip.height / 2);
  await page.mouse.down();
  await page.mouse.move(stage.x + stage.width / 4, grip.y + 20, { steps: 5 });
  await page.mouse.up();
  assert.equal(await now(), 25);
  assert.match(await clip(), /25/);
  const [, x, y] = await camera(page);
  assert.deepEqual([x, y], [0, 0]);
  for (const [key, value] of [['ArrowRight', 27], ['ArrowLeft', 25], ['PageUp', 35], ['PageDown', 25], ['Home', 0], ['End', 100]]) {
    await divider.press(key);
    assert.equal(await now(), value, key);
  }
  assert.equal(await page.getAttribute('#viewer', 'data-frame'), '0', 'the arrows did not step');
  await divider.press('g');
  assert.equal(await page.getAttribute('#viewer', 'data-mode'), 'grid', 'other keys work on it, too');
  await close();
});

test('what is left and right of the divider are the two tiles', async () => {
  const { page, close } = await open(browser, made.folder);
  await radio(page, 'Swipe').check();
  await ready(page);
  const kernel = data.views.find((view) => view.kernel)?.kernel;
  const tiles = data.tiles.slice(0, 2);
  for (const [slot, tile] of tiles.entries()) {
    compare(await greys(page, slot), expected(tile, FUNCTIONS.Edge, kernel), tile, tile.name);
  }
  assert.deepEqual(await page.locator('#viewer .pv-stage .pv-tag').allTextContents(), tiles.map(({ name }) => name));
  // The page really shows the first on the left: its pixels are those of the first canvas.
  const canvas = page.locator('#viewer .pv-stage canvas').first();
  assert.equal(await canvas.evaluate((node) => {
    const box = node.getBoundingClientRect();
    return document.elementsFromPoint(box.left + 10, box.top + box.height - 10).find((at) => at.matches('canvas')) === node;
  }), true);
  await close();
});

test('flicker takes turns by itself and by hand', async () => {
  const { page, close } = await open(browser, made.folder, { reducedMotion: 'no-preference', still: true });
  await radio(page, 'Flicker').check();
  const stage = page.locator('#viewer .pv-stage');
  const turn = () => stage.getAttribute('data-turn');
  for (const expected of ['0', '1', '0', '1']) {
    assert.equal(await turn(), expected, 'two turns a second');
    await page.clock.runFor(500);
  }
  await page.locator('#viewer').getByRole('button', { name: 'Show the other' }).click();
  const before = await turn();
  await page.clock.runFor(700);
  assert.equal(await turn(), before, 'by hand it stays');
  await page.keyboard.press('t');
  assert.notEqual(await turn(), before);
  assert.equal(await page.locator('#viewer').getByLabel('Turns').inputValue(), '0');
  await page.locator('#viewer').getByLabel('Turns').selectOption('4');
  await page.clock.runFor(250);
  assert.equal(await turn(), before);
  await close();
});

// --- Keys ----------------------------------------------------------------------------------------

test('the tabulator reaches every control, and each shows the focus', async () => {
  const { page, close } = await open(browser, made.folder);
  for (const mode of ['Grid', 'Swipe', 'Flicker']) {
    await radio(page, mode).check();
    await ready(page);
    const wanted = await page.evaluate(() => {
      const groups = new Set();
      return [...document.querySelectorAll('#viewer :is(button, select, input, [tabindex="0"])')].filter((node) => {
        if (node.disabled || !node.checkVisibility({ visibilityProperty: true })) return false;
        if (node.type !== 'radio') return true;
        const fresh = !groups.has(node.name);
        groups.add(node.name);
        return fresh;
      }).length;
    });
    await page.evaluate(() => {
      document.activeElement.blur();
      const anchor = document.getElementById('viewer');
      anchor.tabIndex = -1;
      anchor.focus();
      anchor.removeAttribute('tabindex');
    });
    let reached = 0;
    for (;;) {
      await page.keyboard.press('Tab');
      const state = await page.evaluate(() => {
        const node = document.activeElement;
        if (!node.closest('#viewer')) return 'out';
        const drawn = node.type === 'radio' ? node.nextElementSibling : node.matches('[role=slider]') ? node.firstElementChild : node;
        return getComputedStyle(drawn).outlineStyle !== 'none' ? 'seen' : `${node.outerHTML} hides its focus`;
      });
      if (state === 'out') break;
      assert.equal(state, 'seen');
      reached += 1;
      assert.ok(reached <= wanted, 'the focus is caught');
    }
    assert.equal(reached, wanted, mode);
  }
  await close();
});

test('short keys work inside the viewer and nowhere else', async () => {
  const { page, close } = await open(browser, made.folder);
  const mode = () => page.getAttribute('#viewer', 'data-mode');
  const frame = () => page.getAttribute('#viewer', 'data-frame');
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press('s');
  assert.equal(await mode(), 'grid');
  // Only the list of keys opens from everywhere.
  const help = page.getByRole('dialog', { name: 'Keys' });
  await page.keyboard.press('?');
  assert.ok(await help.isVisible());
  await page.keyboard.press('?');
  assert.ok(!(await help.isVisible()));

  await page.locator('#viewer').getByRole('slider', { name: 'Gain' }).focus();
  await page.keyboard.press('s');
  assert.equal(await mode(), 'swipe');
  await page.keyboard.press('f');
  assert.equal(await mode(), 'flicker');
  await page.keyboard.press('g');
  assert.equal(await mode(), 'grid');
  for (const [number, { name }] of data.views.entries()) {
    await page.keyboard.press(String(number + 1));
    assert.ok(await radio(page, name).isChecked(), name);
  }
  const words = await page.locator('#viewer').getByRole('slider', { name: 'Gain' }).getAttribute('aria-valuetext');
  await page.keyboard.press('ArrowRight');
  assert.equal(await frame(), '0', 'a slider keeps its arrows');
  assert.notEqual(await page.locator('#viewer').getByRole('slider', { name: 'Gain' }).getAttribute('aria-valuetext'), words);

  await page.locator('#viewer').getByRole('button', { name: 'Centre' }).focus();
  await page.keyboard.press('ArrowRight');
  assert.equal(await frame(), '1');
  await page.keyboard.press('ArrowLeft');
  assert.equal(await frame(), '0');
  const [zoom] = await camera(page);
  await page.keyboard.press('+');
  assert.equal((await camera(page))[0], zoom + 1);
  await page.keyboard.press('-');
  assert.equal((await camera(page))[0], zoom);

  const pane = page.locator('#viewer .pv-frame:visible').first();
  await pane.focus();
  await page.keyboard.press('ArrowDown');
  const [, x, y] = await camera(page);
  assert.ok(x === 0 && y > 0, 'on a picture the arrows move it');
  assert.equal(await frame(), '0');
  await page.keyboard.press('0');
  assert.deepEqual((await camera(page)).slice(1), [0, 0]);
  await page.keyboard.press(' ');
  await page.locator('#viewer').getByRole('button', { name: 'Pause' }).waitFor();
  await page.keyboard.press(' ');
  await page.locator('#viewer').getByRole('button', { name: 'Play' }).waitFor();

  await page.keyboard.press('?');
  assert.ok(await help.isVisible());
  assert.match(await help.textContent(), /more than two numbers, the first two are used/);
  await page.keyboard.press('Escape');
  assert.ok(!(await help.isVisible()));
  await page.getByRole('button', { name: 'Keys ?' }).click();
  assert.ok(await help.isVisible());
  await help.getByRole('button', { name: 'Close' }).click();
  assert.ok(!(await help.isVisible()));

  await page.locator('#viewer').getByLabel('Speed').focus();
  await page.keyboard.press('f');
  assert.equal(await mode(), 'grid', 'a list keeps its letters');
  await close();
});

test('keys go on working when what had the focus is hidden', async () => {
  const { page, close } = await open(browser, made.folder);
  const mode = () => page.getAttribute('#viewer', 'data-mode');
  const focused = () => page.evaluate(() => document.activeElement.className);
  await page.locator('#viewer .pv-frame:visible').first().click();
  for (const [key, name] of [['s', 'swipe'], ['g', 'grid'], ['f', 'flicker'], ['g', 'grid'], ['s', 'swipe']]) {
    await page.keyboard.press(key);
    await settle(page);
    assert.equal(await mode(), name);
    assert.match(await focused(), name === 'grid' ? /^pv-frame$/ : /pv-stage/);
  }
  await page.locator('#viewer').getByRole('slider', { name: /Divider/ }).press('f');
  await settle(page);
  await page.keyboard.press('t');
  assert.equal(await page.locator('#viewer .pv-stage').getAttribute('data-turn'), '1');
  await page.locator('#viewer').getByRole('button', { name: 'Show the other' }).press('s');
  await settle(page);
  assert.match(await focused(), /pv-stage/);
  if (scenes) {
    const root = page.locator('.pv-scenes');
    await root.getByRole('slider', { name: /Divider/ }).press('f');
    await settle(page);
    await page.keyboard.press('t');
    assert.equal(await root.locator('.pv-stage').getAttribute('data-turn'), '1');
    await root.getByRole('button', { name: 'Show the other' }).press('s');
    await settle(page);
    assert.match(await focused(), /pv-stage/);
  }
  await close();
});

// --- Touch, phones, themes, motion ---------------------------------------------------------------

test('fingers move the divider, pan and pinch', async () => {
  const { page, context, close } = await open(browser, made.folder, { hasTouch: true, isMobile: true, viewport: { width: 360, height: 740 } });
  const session = await context.newCDPSession(page);
  const touch = async (type, ...points) => {
    await session.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
    await page.waitForTimeout(30);
  };
  await radio(page, 'Swipe').check();
  await ready(page);
  const stage = page.locator('#viewer .pv-stage');
  await stage.scrollIntoViewIfNeeded();
  const divider = page.locator('#viewer').getByRole('slider', { name: /Divider/ });
  const box = await stage.boundingBox();
  const middle = [box.x + box.width / 2, box.y + box.height / 2];
  await touch('touchStart', middle);
  for (let step = 1; step <= 5; step += 1) await touch('touchMove', [middle[0] + (step * box.width) / 20, middle[1]]);
  await touch('touchEnd');
  assert.equal(await divider.getAttribute('aria-valuenow'), '75');

  const [zoom] = await camera(page);
  const left = box.x + box.width / 4;
  await touch('touchStart', [left - 15, middle[1]], [left + 15, middle[1]]);
  for (let step = 1; step <= 6; step += 1) await touch('touchMove', [left - 15 - 5 * step, middle[1]], [left + 15 + 5 * step, middle[1]]);
  await touch('touchEnd');
  const [pinched] = await camera(page);
  assert.ok(pinched >= zoom + 1, `${zoom} to ${pinched}`);

  const before = await camera(page);
  await touch('touchStart', [left, middle[1]]);
  for (let step = 1; step <= 4; step += 1) await touch('touchMove', [left - 10 * step, middle[1] + 5 * step]);
  await touch('touchEnd');
  const after = await camera(page);
  assert.ok(after[1] > before[1] && after[2] < before[2], `${before} to ${after}`);
  await close();
});

test('on a phone nothing scrolls sideways', async () => {
  const { page, close } = await open(browser, made.folder, { viewport: { width: 360, height: 740 } });
  const widths = () => page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.clientWidth]);
  const longest = data.tiles.reduce((most, { name }, number) => (name.length > data.tiles[most].name.length ? number : most), 0);
  await page.getByLabel('Tile 1').selectOption(String(longest));
  for (const mode of ['Grid', 'Swipe', 'Flicker']) {
    await radio(page, mode).check();
    for (const kind of ['Edge', 'Disk', 'Soft shadow']) {
      await radio(page, kind).check();
      await ready(page);
      const [content, window] = await widths();
      assert.ok(content <= window, `${mode}, ${kind}: ${content}`);
    }
  }
  await page.getByRole('button', { name: 'Keys ?' }).click();
  const box = await page.getByRole('dialog', { name: 'Keys' }).boundingBox();
  assert.ok(box.x >= 0 && box.x + box.width <= 360);
  await close();
});

for (const colorScheme of ['light', 'dark']) {
  test(`axe finds nothing in the ${colorScheme} theme`, async () => {
    const { page, close } = await open(browser, made.folder, { colorScheme });
    assert.deepEqual(await breaches(page), []);
    await radio(page, 'Flicker').check();
    await radio(page, 'Soft shadow').check();
    await ready(page);
    assert.deepEqual(await breaches(page, '#viewer'), []);
    await radio(page, 'Swipe').check();
    await ready(page);
    await page.getByRole('button', { name: 'Keys ?' }).click();
    assert.deepEqual(await breaches(page, '#viewer'), []);
    await close();
  });
}

test('it plays by itself, unless less motion is wished', async () => {
  for (const reducedMotion of ['reduce', 'no-preference']) {
    const { page, close } = await open(browser, made.folder, { reducedMotion, still: true });
    const before = await pictures(page);
    await page.clock.runFor(150);
    const moves = (await pictures(page)) !== before;
    assert.equal(moves, reducedMotion === 'no-preference');
    await radio(page, 'Flicker').check();
    assert.equal(await page.locator('#viewer').getByLabel('Turns').inputValue(), reducedMotion === 'reduce' ? '0' : '2');
    await close();
  }
});

test('out of sight it rests', async () => {
  const { page, close } = await open(browser, made.folder, { reducedMotion: 'no-preference', viewport: { width: 1200, height: 400 }, still: true });
  await page.evaluate(() => {
    document.getElementById('viewer').style.marginTop = '3000px';
    window.scrollTo(0, 0);
  });
  // The browser says what is in sight when it has the time.
  let [before, now] = [null, await pictures(page)];
  for (let look = 0; look < 1000 && now !== before; look += 1) {
    await page.clock.runFor(200);
    [before, now] = [now, await pictures(page)];
  }
  assert.equal(now, before);
  await close();
});

// --- Scenes --------------------------------------------------------------------------------------

test('scenes are compared, with the reference at hand', async (t) => {
  if (!scenes) return t.skip('no renders in this report');
  const { page, close } = await open(browser, made.folder);
  const root = page.locator('.pv-scenes');
  await root.scrollIntoViewIfNeeded();
  const shown = () => root.locator('.pv-stage .pv-render').evaluateAll((images) => images.map((image) => image.getAttribute('src')));
  const place = () => root.locator('.pv-stage').getAttribute('data-camera');
  assert.equal(await page.locator('#scenes figure:visible').count(), 0, 'the plain pictures give way');

  const scene = scenes[0];
  // Each view has methods of its own.
  for (const view of scene.views) {
    await root.getByLabel('View').selectOption(view);
    for (const side of ['Left', 'Right']) {
      for (const picture of scene.pictures.filter((one) => one.view === view)) {
        await root.getByLabel(side).selectOption(picture.name);
        assert.equal((await shown())[side === 'Left' ? 0 : 1], picture.file);
      }
    }
  }
  const sizes = await root.locator('.pv-stage .pv-render').evaluateAll((images) => Promise.all(images.slice(0, 2).map((image) => image.decode().then(() => image.naturalWidth))));
  assert.deepEqual(sizes, [scene.width, scene.width]);

  const divider = root.getByRole('slider', { name: /Divider/ });
  await divider.focus();
  await page.keyboard.press('End');
  assert.equal(await divider.getAttribute('aria-valuenow'), '100');

  if (scene.reference) {
    const reference = root.locator('.pv-layer', { hasText: 'Reference' });
    const held = root.getByRole('button', { name: 'Hold for the reference' });
    assert.deepEqual(await held.evaluate((node) => [getComputedStyle(node).touchAction, getComputedStyle(node).userSelect]), ['none', 'none']);
    await held.hover();
    await page.mouse.down();
    assert.ok(await reference.isVisible());
    assert.equal(await held.getAttribute('aria-pressed'), 'true');
    await page.mouse.up();
    assert.ok(!(await reference.isVisible()));
    await page.keyboard.down('r');
    assert.ok(await reference.isVisible());
    await page.keyboard.up('r');
    assert.ok(!(await reference.isVisible()));
    await held.focus();
    await page.keyboard.down(' ');
    assert.ok(await reference.isVisible());
    await page.keyboard.up(' ');
    assert.ok(!(await reference.isVisible()));
  }

  await radio(page, 'Flicker', '.pv-scenes').check();
  await root.getByRole('button', { name: 'Show the other' }).click();
  assert.equal(await root.locator('.pv-stage').getAttribute('data-turn'), '1');
  await root.getByRole('radio', { name: 'Flicker' }).press('t');
  assert.equal(await root.locator('.pv-stage').getAttribute('data-turn'), '0');
  // After turns by hand, and where less motion is wished, they can still be had by themselves.
  assert.equal(await root.getByLabel('Turns').inputValue(), '0');
  await root.getByLabel('Turns').selectOption('4');
  await root.locator('.pv-stage[data-turn="1"]').waitFor();
  await root.locator('.pv-stage[data-turn="0"]').waitFor();

  await slide(page, 'Zoom', 4, '.pv-scenes');
  assert.match(await place(), /^4 0\.0 0\.0$/);
  await root.locator('.pv-stage').focus();
  await page.keyboard.press('ArrowRight');
  assert.match(await place(), /^4 4\.0 0\.0$/);
  if (scene.crops.length > 0) {
    const { x, y, size } = scene.crops[0];
    await root.getByRole('button', { name: /^Crop 1 of/ }).first().click();
    const [zoom, left, top] = (await place()).split(' ').map(Number);
    assert.ok(zoom >= 1);
    // The crop's middle, or as near to it as the picture's end allows.
    const near = (found, wish, length) => {
      const most = Math.max((length - length / zoom) / 2, 0);
      assert.ok(Math.abs(found - Math.min(Math.max(wish, -most), most)) < 0.6, `${found} for ${wish}`);
    };
    near(left, x + size / 2 - scene.width / 2, scene.width);
    near(top, y + size / 2 - scene.height / 2, scene.height);
    const last = root.getByRole('button', { name: /^Crop . of/ }).last();
    await page.setViewportSize({ width: 1200, height: 300 });
    await last.click();
    const stage = await root.locator('.pv-stage').boundingBox();
    assert.ok(stage.y < 300 && stage.y + stage.height > 0, 'it is in sight');
    await page.setViewportSize({ width: 1200, height: 1000 });
  }
  await root.getByRole('button', { name: 'Whole picture' }).click();
  assert.match(await place(), /^1 -?0\.0 -?0\.0$/);
  if (scenes.length > 1) {
    await root.getByLabel('Scene').selectOption({ label: scenes[1].name });
    assert.ok(scenes[1].pictures.some(({ file }) => file) && (await shown()).slice(0, 2).every((file) => scenes[1].pictures.some((one) => one.file === file)));
  }
  await close();
});

test('without script the pictures of the scenes are there', async (t) => {
  if (!scenes) return t.skip('no renders in this report');
  const context = await newContext(browser, { javaScriptEnabled: false });
  const page = await context.newPage();
  await page.goto(`file://${made.folder}/index.html`);
  assert.ok((await page.locator('#scenes img:visible').count()) >= scenes.length);
  await context.close();
});

test('on paper the pictures of the scenes stand in place of the viewers', async (t) => {
  const { page, close } = await open(browser, made.folder);
  await page.emulateMedia({ media: 'print' });
  assert.equal(await page.locator('.pv:visible').count(), 0);
  if (!scenes) t.diagnostic('no renders in this report');
  else assert.ok((await page.locator('#scenes img:visible').count()) >= scenes.length);
  await page.emulateMedia({ media: 'screen' });
  assert.ok(await page.locator('#viewer').isVisible());
  assert.equal(await page.locator('#scenes figure:visible').count(), 0);
  await close();
});

// --- Time ----------------------------------------------------------------------------------------

test('a frame of four large tiles is quick, once it is prepared', async (t) => {
  const large = REPORT ? { folder: REPORT, remove: () => {} } : temporary();
  if (!REPORT) writeLarge(large.folder);
  const start = performance.now();
  const { page, context, close } = await open(browser, large.folder, { reducedMotion: 'no-preference', viewport: { width: 1300, height: 1000 } });
  const first = performance.now() - start;
  const load = await page.evaluate(() => performance.getEntriesByType('navigation')[0].loadEventEnd);
  t.diagnostic(`page loaded in ${load.toFixed(0)} ms, four tiles prepared after ${first.toFixed(0)} ms`);

  const add = page.getByRole('button', { name: 'Add a picture' });
  while (await add.isVisible()) await add.click();
  // Every pixel of the tiles is drawn.
  await slide(page, 'Zoom', 1);
  await ready(page);
  // The other views are worked out ahead; then the page has nothing to do but play.
  await page.waitForTimeout(4000);
  const session = await context.newCDPSession(page);
  // Of a processor's time, as the machine may be busy with other things.
  await session.send('Performance.enable', { timeDomain: 'threadTicks' });
  const metrics = async () => Object.fromEntries((await session.send('Performance.getMetrics')).metrics.map(({ name, value }) => [name, value]));
  const [frames, before] = [await paints(page), await metrics()];
  await page.waitForFunction((all) => window.paints.count >= all, frames + 120, { polling: 250 });
  const [count, now] = [(await paints(page)) - frames, await metrics()];
  const per = (name) => (1000 * (now[name] - before[name])) / count;
  const sizes = await page.locator('#viewer .pv-canvas').evaluateAll((all) => all.map(({ width, height }) => `${width} × ${height}`));
  t.diagnostic(`a frame takes a median of ${await page.getAttribute('#viewer', 'data-frame-ms')} ms (${sizes.join(', ')})`);
  t.diagnostic(`per frame ${per('ScriptDuration').toFixed(2)} ms script, ${per('ThreadTime').toFixed(2)} ms main thread in all`);
  assert.ok(per('ScriptDuration') <= 16, `${per('ScriptDuration')} ms`);
  await close();
  large.remove();
});

test('while it prepares, no script holds the page up', async (t) => {
  const { page, close } = await open(browser, made.folder, { reducedMotion: 'no-preference' });
  await browser.startTracing(page, { categories: ['toplevel'] });
  await page.evaluate(async () => {
    const angle = [...document.querySelectorAll('#viewer input[type=range]')].find((input) => input.labels[0].textContent === 'Angle');
    for (let value = 0; value < 40; value += 1) {
      angle.value = String(value);
      angle.dispatchEvent(new Event('input', { bubbles: true }));
      await new Promise((done) => setTimeout(done, 30));
    }
  });
  const { traceEvents } = JSON.parse(await browser.stopTracing());
  const mains = traceEvents.filter(({ name, args }) => name === 'thread_name' && args.name === 'CrRendererMain');
  const tasks = traceEvents.filter(({ name, pid, tid }) => /RunTask$/.test(name) && mains.some((main) => main.pid === pid && main.tid === tid));
  // Of a processor's time, in microseconds.
  const times = tasks.map(({ tdur }) => tdur).filter((time) => time !== undefined);
  assert.ok(times.length > 100, `${times.length} of ${tasks.length} tasks`);
  const longest = Math.max(...times) / 1000;
  t.diagnostic(`longest of ${times.length} tasks while a slider moves: ${longest.toFixed(1)} ms`);
  assert.ok(longest < 100, `${longest} ms`);
  await ready(page);
  await close();
});

test('where no worker may be had, the page does the work itself', { skip: REPORT !== null }, async () => {
  const context = await newContext(browser, { reducedMotion: 'reduce', viewport: { width: 1200, height: 1000 } });
  const page = await context.newPage();
  await page.addInitScript(() => {
    window.Worker = class {
      constructor() {
        throw new Error('no workers here');
      }
    };
  });
  await page.goto(`file://${made.folder}/index.html`);
  await ready(page);
  const right = expected(data.tiles[0], FUNCTIONS.Edge, data.views[1].kernel);
  assert.ok(Math.abs((await ratios(page))[0] / right.ratio - 1) < 1e-4);
  compare(await greys(page, 0), right, data.tiles[0], 'without worker');
  await context.close();
});
