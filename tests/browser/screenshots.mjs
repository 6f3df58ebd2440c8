// The pictures of a report that README and docs/report.md show:
//
//     node tests/browser/screenshots.mjs REPORT FOLDER
//
// writes report-viewer.png and report-scenes.png into FOLDER.

import path from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium } from 'playwright-core';

const [report, folder] = process.argv.slice(2);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--disable-gpu'],
});
const page = await browser.newPage({ viewport: { width: 1000, height: 860 } });
await page.goto(pathToFileURL(path.resolve(report, 'index.html')).href);

const viewer = page.locator('#viewer');
await viewer.scrollIntoViewIfNeeded();
await viewer.getByRole('radio', { name: 'Soft shadow' }).check();
await viewer.evaluate((element) => element.scrollIntoView());
// It looks ready until the other pictures are begun.
await page.waitForTimeout(500);
await page.waitForSelector('#viewer[data-state=ready]', { timeout: 0 });
await page.waitForTimeout(500);
await page.screenshot({ path: path.join(folder, 'report-viewer.png') });

const scenes = page.locator('#scenes');
if (await scenes.count()) {
  await scenes.getByLabel('Scene').selectOption({ label: 'Teapot' });
  await scenes.evaluate((element) => element.scrollIntoView());
  await page.waitForTimeout(1500);
  await page.screenshot({ path: path.join(folder, 'report-scenes.png') });
}
await browser.close();
