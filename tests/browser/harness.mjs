// What the browser tests share: a browser, a report, pages that note every complaint.
//
// CHROMIUM names the browser (/usr/bin/chromium). REPORT names the folder of a report to test in
// place of the fixture.
import assert from 'node:assert/strict';
import { mkdtempSync, readFileSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';
import axe from 'axe-core';
import { chromium } from 'playwright-core';
import { writeFixture } from './fixture.mjs';

/** Milliseconds that nothing takes, also on a busy machine: what hangs is to fail, and not to hang. */
export const LONG = 300000;

export const REPORT = process.env.REPORT ? resolve(process.env.REPORT) : null;

export const launch = () =>
  chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: ['--no-sandbox', '--disable-gpu'],
    timeout: LONG,
  });

/** A folder that `remove` takes away again, or the end of the tests. */
export function temporary() {
  const folder = mkdtempSync(join(tmpdir(), 'perceptile-browser-'));
  const remove = () => rmSync(folder, { recursive: true, force: true });
  process.on('exit', remove);
  return { folder, remove };
}

/** The report under test: REPORT, or the fixture. */
export function report() {
  if (REPORT) return { folder: REPORT, remove: () => {} };
  const made = temporary();
  writeFixture(made.folder);
  return made;
}

/** A JSON script of the page. */
export function dataOf(folder, id) {
  const page = readFileSync(join(folder, 'index.html'), 'utf8');
  const found = page.match(new RegExp(`<script[^>]*id="${id}"[^>]*>([\\s\\S]*?)</script>`));
  return found ? JSON.parse(found[1]) : null;
}

/** The samples of a tile as the report has them. */
export function samplesOf(folder, { file }) {
  const [, text] = readFileSync(join(folder, file), 'utf8').match(/"([^"]*)"/);
  const bytes = Buffer.from(text, 'base64');
  return Uint16Array.from({ length: bytes.length / 2 }, (_, i) => bytes.readUInt16LE(2 * i));
}

/** A context for pages whose waits have an end. */
export async function newContext(browser, options) {
  const context = await browser.newContext(options);
  context.setDefaultTimeout(LONG);
  return context;
}

/**
 * Opens the report. Closing it fails if the page complained or asked for what is not its own.
 *
 * @param {import('playwright-core').Browser} browser
 * @param {string} folder
 * @param {object} options of the browser's context; and `still`: once the page is ready, time passes
 *   in it by `page.clock.runFor` alone, however fast the machine is
 */
export async function open(browser, folder, { still = false, ...options } = {}) {
  const context = await newContext(browser, { viewport: { width: 1200, height: 1000 }, reducedMotion: 'reduce', ...options });
  const page = await context.newPage();
  if (still) await page.clock.install();
  const home = pathToFileURL(folder).href + '/';
  const complaints = [];
  page.on('console', (message) => ['error', 'warning'].includes(message.type()) && complaints.push(message.text()));
  page.on('pageerror', (error) => complaints.push(error.stack));
  page.on('requestfailed', (request) => complaints.push(`failed: ${request.url()}`));
  page.on('request', (request) => {
    const url = request.url();
    if (!url.startsWith(home) && !/^(blob|data):/.test(url)) complaints.push(`foreign: ${url}`);
  });
  await page.goto(`${home}index.html`);
  await page.locator('#viewer').scrollIntoViewIfNeeded();
  await ready(page);
  if (still) await page.clock.pauseAt(await page.evaluate(() => Date.now() + 1000));
  const close = async () => {
    assert.deepEqual(complaints, []);
    await context.close();
  };
  return { page, context, complaints, close };
}

/** Waits until what is asked for is shown. */
export async function ready(page) {
  await page.waitForSelector('#viewer[data-state=ready]');
  await settle(page);
}

/** Waits until the next frame has been drawn. */
export const settle = (page) =>
  page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done)))));

/** Reads canvases by a copy: reading the viewer's own would slow it down, and the browser says so. */
function readCanvases() {
  return [...document.querySelectorAll('#viewer .pv-canvas')].map((canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    return copy.getImageData(0, 0, canvas.width, canvas.height);
  });
}

/** Counts the pictures that are painted into the first canvas, from the first call on. */
export const paints = (page) =>
  page.evaluate(() => (window.paints ??= (() => {
    const state = { count: 0 };
    const context = document.querySelector('#viewer .pv-canvas').getContext('2d');
    const put = context.putImageData.bind(context);
    context.putImageData = (...all) => {
      state.count += 1;
      put(...all);
    };
    return state;
  })()).count);

/** The greys of a picture, row by row. */
export const greys = (page, number) =>
  page.evaluate(`(() => {
    const { width, height, data } = (${readCanvases})()[${number}];
    return { width, height, values: Array.from({ length: data.length / 4 }, (_, i) => data[4 * i]) };
  })()`);

/** Something short that changes with any pixel of any picture. */
export const pictures = (page) =>
  page.evaluate(`(${readCanvases})().map(({ data }) => data.reduce((hash, byte) => (hash * 31 + byte) | 0, 7)).join()`);

/** The ratios below the pictures that are seen. */
export const ratios = (page) =>
  page.evaluate(() => [...document.querySelectorAll('#viewer .pv-pane:not([hidden]) .pv-ratio')].map(({ dataset }) => Number(dataset.ratio)));

/** Moves a slider, as a hand does. */
export async function slide(page, name, value, within = '#viewer') {
  const input = page.locator(within).getByRole('slider', { name, exact: true });
  await input.evaluate((node, to) => {
    node.value = to;
    node.dispatchEvent(new Event('input', { bubbles: true }));
  }, String(value));
}

/** The breaches of WCAG 2 A and AA that axe finds. */
export async function breaches(page, where = 'body') {
  await page.evaluate(axe.source);
  const { violations } = await page.evaluate(
    (selector) => globalThis.axe.run(selector, { runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa'] }),
    where,
  );
  return violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html, failureSummary }) => `${html} ${failureSummary}`).join('; ')}`);
}
