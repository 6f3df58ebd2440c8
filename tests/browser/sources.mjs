// The viewer's files, in the order in which a page holds them.
import { readFileSync } from 'node:fs';
import { fileURLToPath } from 'node:url';
import vm from 'node:vm';

const folder = new URL('../../src/report/viewer/', import.meta.url);

export const ORDER = [
  'integrands.js',
  'filter.js',
  'work.js',
  'player.js',
  'controls.js',
  'compare.js',
  'panes.js',
  'tiles.js',
  'scenes.js',
  'viewer.js',
];

export const read = (name) => readFileSync(new URL(name, folder), 'utf8');

/** The whole script, as a page has it. */
export const script = () => ORDER.map(read).join('');

/** The parts that know of no page, run here. */
export function load() {
  const context = vm.createContext({ performance, atob });
  for (const name of ['integrands.js', 'filter.js', 'work.js', 'player.js']) {
    vm.runInContext(read(name), context, { filename: fileURLToPath(new URL(name, folder)) });
  }
  return context.perceptileViewer;
}
