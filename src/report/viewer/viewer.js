// The report's viewer: plays what tiles do to pictures, and compares rendered scenes.
//
// It is one classic script without dependencies, inline in the page, of
// these files in this order:
//
//     integrands.js  functions and their exact integrals
//     filter.js      the kernel, and the ratio to white noise
//     work.js        jobs, done in a worker: this same script, started from a blob
//     player.js      which frame is due when
//     controls.js    buttons, sliders, lists
//     compare.js     divider, flicker, zoom and pan
//     panes.js       one picture of the viewer of tiles
//     tiles.js       the viewer of tiles, in <section id="viewer">
//     scenes.js      the viewer of scenes, in <section id="scenes">
//     viewer.js      starts all this
//
// The page may forbid everything else. Chromium accepts this policy for pages from files, too:
//
//     default-src 'none'; img-src 'self' file: data:; style-src 'unsafe-inline';
//     script-src 'self' file: 'unsafe-inline'; worker-src blob:; base-uri 'none'; form-action 'none'
//
// ('self' is enough for Chromium; `file:` is for browsers in which a file has no self.) Where the
// worker is refused, the page itself does the work, in slices.
(function (perceptile) {
  'use strict';

  function dataOf(id) {
    const script = document.getElementById(id);
    return script ? JSON.parse(script.textContent) : null;
  }

  function start(source) {
    const tiles = dataOf('viewer-data');
    const viewer = document.getElementById('viewer');
    if (viewer && tiles?.tiles.length > 0) {
      const made = new perceptile.TileViewer(viewer, tiles, source);
      globalThis.perceptileTile = (number, text) => made.receive(number, text);
    }
    const scenes = dataOf('scenes-data');
    const section = document.getElementById('scenes');
    if (section && scenes?.length > 0) new perceptile.SceneViewer(section, scenes);
  }

  if (typeof document !== 'undefined') {
    const source = document.currentScript?.textContent ?? '';
    if (document.readyState === 'loading') document.addEventListener('DOMContentLoaded', () => start(source));
    else start(source);
  } else if (typeof importScripts === 'function') {
    perceptile.serve(globalThis);
  }
})((globalThis.perceptileViewer ??= {}));
