// A real report against the JSON of `perceptile evaluate`.
//
//     perceptile evaluate TILE... --baselines white --json > scores.json
//     perceptile report OUT TILE...
//     REPORT=OUT SCORES=scores.json npm test
//
// Every number of the report's tables is an element with three attributes:
//
//     data-tile   the tile's name, as in the JSON's "tiles"
//     data-score  where the number stands in that tile's entry: /scores/residual
//                 (a JSON pointer; scores.residual is understood as well)
//     data-value  the number in full; the text shows three digits of it
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import test, { after, before } from 'node:test';
import { REPORT, dataOf, launch, open } from './harness.mjs';
import { script } from './sources.mjs';

const skip = REPORT === null && 'REPORT is not given';

let browser;
before(async () => {
  if (!skip) browser = await launch();
});
after(() => browser?.close());

/** The value at a pointer or a path of dots. */
function valueAt(entry, pointer) {
  const keys = pointer.startsWith('/') ? pointer.slice(1).split('/') : pointer.split('.');
  return keys.reduce((value, key) => value?.[key.replaceAll('~1', '/').replaceAll('~0', '~')], entry);
}

test('every score is what evaluate says', { skip: skip || (!process.env.SCORES && 'SCORES is not given') }, async (t) => {
  const { tiles } = JSON.parse(readFileSync(process.env.SCORES, 'utf8'));
  const entries = new Map(tiles.map((entry) => [entry.name, entry]));
  const { page, close } = await open(browser, REPORT);
  const numbers = await page.locator('[data-score]').evaluateAll((nodes) => nodes.map(({ dataset, textContent }) => ({ ...dataset, text: textContent.trim() })));
  assert.ok(numbers.length > 0, 'the report has no scores');
  for (const { tile, score, value, text } of numbers) {
    const label = `${score} of ${tile}`;
    assert.ok(entries.has(tile), `evaluate knows no tile ${tile}`);
    const expected = valueAt(entries.get(tile), score);
    assert.equal(typeof expected, 'number', label);
    assert.equal(Number(value), expected, label);
    // Three digits, and one of an error: off by half of the last one at most.
    const rounding = score.endsWith('/standard_error') ? 0.501 : 0.00501;
    assert.ok(Math.abs(Number(text) - expected) <= rounding * Math.abs(expected), `${label}: ${text} for ${expected}`);
  }
  const shown = new Set(numbers.map(({ tile }) => tile));
  for (const name of entries.keys()) assert.ok(shown.has(name), `the report has no scores of ${name}`);
  t.diagnostic(`${numbers.length} numbers of ${shown.size} tiles`);
  await close();
});

test('the page holds the viewer as it stands in the sources', { skip }, () => {
  const flat = (text) => text.replace(/\s+/g, ' ').trim();
  const page = flat(readFileSync(`${REPORT}/index.html`, 'utf8'));
  assert.ok(page.includes(flat(script())));
});

test('white noise is the last tile, in the shape of the first', { skip }, () => {
  const { tiles } = dataOf(REPORT, 'viewer-data');
  const shape = ({ width, height, frames, spp }) => [width, height, frames, spp];
  assert.equal(tiles.at(-1).name, 'White noise');
  assert.deepEqual(shape(tiles.at(-1)), shape(tiles[0]));
});

test('the button overrides the theme of the system', { skip }, async () => {
  for (const colorScheme of ['light', 'dark']) {
    const { page, close } = await open(browser, REPORT, { colorScheme });
    const paper = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
    const before = await paper();
    const button = page.getByRole('button', { name: /theme/i });
    await button.click();
    assert.notEqual(await paper(), before);
    await button.click();
    assert.equal(await paper(), before);
    await close();
  }
});
