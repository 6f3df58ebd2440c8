// One picture of the viewer: its canvas, the choice of its tile, and its figure in words.
(function (perceptile) {
  'use strict';

  const { element, button, picker, modulo } = perceptile;

  /** The soft shadow is shown from dark to light grey, so that errors beyond 0 and 1 show, too. */
  const TONE = { dark: 0.1, range: 0.8 };

  /** Greys of 0 to 255 as pixels of a canvas. */
  const GREYS = Uint32Array.from({ length: 256 }, (_, grey) => (0xff000000 | (grey * 0x010101)) >>> 0);

  /** What a slot shows, as grey = base + perError · error + perTruth · truth, in units of 1/255. */
  function toneOf(kind, show, gain) {
    if (kind === 'shadow' && show === 'picture') {
      return { base: 255 * TONE.dark, perError: 255 * TONE.range, perTruth: 255 * TONE.range };
    }
    return { base: 127.5, perError: 255 * gain, perTruth: 0 };
  }

  /**
   * Maps a part of a frame to greys, wrapping around at its ends.
   *
   * @param {Uint32Array} pixels `width` × `height` of them
   * @param {{x: number, y: number, width: number, height: number}} part
   * @param {{width: number, height: number}} shape of the frame
   */
  function develop(pixels, part, shape, errors, truth, { base, perError, perTruth }) {
    const left = modulo(part.x, shape.width);
    let to = 0;
    for (let j = 0; j < part.height; j += 1) {
      const row = modulo(part.y + j, shape.height) * shape.width;
      let column = left;
      for (let i = 0; i < part.width; i += 1) {
        let grey = base + perError * errors[row + column];
        if (truth) grey += perTruth * truth[row + column];
        pixels[to] = GREYS[grey <= 0 ? 0 : grey >= 255 ? 255 : (grey + 0.5) | 0];
        to += 1;
        column += 1;
        if (column === shape.width) column = 0;
      }
    }
  }

  /** A ratio in three significant digits, and never in powers of ten where it is large. */
  function ratioText(ratio) {
    if (!Number.isFinite(ratio)) return '–';
    return ratio < 100 ? ratio.toPrecision(3) : ratio.toFixed(0);
  }

  class Pane {
    /**
     * @param {{name: string, width: number, height: number, frames: number, spp: number,
     *   dims: number, whole: boolean}[]} tiles
     * @param {(number: number) => void} picked another tile
     * @param {() => void} removed the pane is no longer wanted
     */
    constructor(tiles, picked, removed) {
      this.tiles = tiles;
      this.tile = null;
      const names = tiles.map(({ name, whole }, number) => [String(number), whole ? name : `${name} (part of the tile)`]);
      this.picker = picker('Tile', names, (value) => picked(Number(value)));
      this.remove = button('Remove', { class: 'pv-button pv-quiet', onclick: removed });
      this.canvas = element('canvas', { class: 'pv-canvas', role: 'img', width: 1, height: 1 });
      this.context = this.canvas.getContext('2d', { alpha: false });
      this.frame = element(
        'div',
        { class: 'pv-frame', tabIndex: 0, role: 'group' },
        element('div', { class: 'pv-layer' }, this.canvas),
      );
      this.figure = element('output', { class: 'pv-ratio' });
      this.words = element('span', { class: 'pv-words' });
      this.bar = element('span', { class: 'pv-bar', 'aria-hidden': 'true' }, element('span'));
      this.note = element('span', { class: 'pv-note' });
      this.root = element(
        'figure',
        { class: 'pv-pane' },
        element('div', { class: 'pv-head' }, this.picker.root, this.remove),
        this.frame,
        element('figcaption', {}, element('span', {}, this.figure, ' ', this.words), this.bar, this.note),
      );
      this.image = null;
    }

    /** @param {number} number of the tile */
    setTile(number, label) {
      if (number !== this.tile) {
        this.tile = number;
        this.clear();
      }
      this.picker.set(String(number));
      this.picker.label.textContent = label;
      const { name } = this.tiles[number];
      this.frame.setAttribute('aria-label', `Picture of ${name}: arrow keys move it`);
      this.remove.setAttribute('aria-label', `Remove the picture of ${name}`);
    }

    /** Shows nothing, so that no picture or figure of another tile stands under this one's name. */
    clear() {
      this.setRatio(NaN);
      this.words.textContent = '';
      this.explain('', false);
      this.canvas.setAttribute('aria-label', this.tiles[this.tile].name);
      this.canvas.hidden = true;
      this.canvas.width = 1;
      this.canvas.height = 1;
      this.shown = '';
    }

    /** Says the ratio in words; without one, only of what it would be. */
    say(ratio, view) {
      this.setRatio(ratio);
      this.words.textContent = `of white noise’s error, ${view}`;
      this.canvas.setAttribute('aria-label', `${this.tiles[this.tile].name}, ${view}`);
    }

    /** @param {number} ratio NaN for a dash */
    setRatio(ratio) {
      this.figure.value = ratioText(ratio);
      this.figure.dataset.ratio = Number.isFinite(ratio) ? String(ratio) : '';
      this.bar.firstChild.style.transform = `scaleX(${Math.min(Number.isFinite(ratio) ? ratio : 0, 1)})`;
    }

    /**
     * @param {string} failure why there is no picture, or nothing
     * @param {boolean} wraps whether the figure takes the ends of a part for those of the tile
     */
    explain(failure, wraps) {
      const { width, height, frames, spp, whole } = this.tiles[this.tile];
      const samples = spp > 1 ? `, ${spp} samples` : '';
      const size = `${width} × ${height} × ${frames}${samples}${whole ? '' : ', part of the tile'}${wraps ? ', ends wrap' : ''}`;
      this.note.textContent = failure ? `No picture: ${failure}` : size;
      this.note.classList.toggle('pv-failure', failure !== '');
      this.canvas.classList.toggle('pv-none', failure !== '');
    }

    /**
     * Draws a frame.
     *
     * @param {object} picture
     * @param {string} picture.key of the frame; the same key with the same view draws nothing
     * @param {{width: number, height: number}} picture.shape
     * @param {Float32Array} picture.errors
     * @param {Float32Array | null} picture.truth
     * @param {{base: number, perError: number, perTruth: number}} picture.tone
     * @param {boolean} picture.repeats whether the picture goes on beyond its ends
     * @param {{x: number, y: number}} camera
     * @param {{width: number, height: number}} room device pixels of the frame
     * @param {number} scale whole device pixels of one pixel of the picture
     */
    paint({ key, shape, errors, truth, tone, repeats }, camera, room, scale) {
      const across = Math.ceil(room.width / scale);
      const down = Math.ceil(room.height / scale);
      const width = repeats ? across : Math.min(Math.floor(room.width / scale), shape.width);
      const height = repeats ? down : Math.min(Math.floor(room.height / scale), shape.height);
      if (width < 1 || height < 1) return;
      let x = Math.floor(shape.width / 2 + camera.x - width / 2);
      let y = Math.floor(shape.height / 2 + camera.y - height / 2);
      if (!repeats) {
        x = Math.min(Math.max(x, 0), shape.width - width);
        y = Math.min(Math.max(y, 0), shape.height - height);
      }
      const shown = [key, x, y, width, height, scale, tone.base, tone.perError].join();
      if (shown === this.shown) return;
      this.shown = shown;
      this.resize(width, height, scale);

      const part = { x, y, width: Math.min(width, shape.width), height: Math.min(height, shape.height) };
      if (this.image?.width !== part.width || this.image.height !== part.height) {
        this.image = this.context.createImageData(part.width, part.height);
        this.pixels = new Uint32Array(this.image.data.buffer);
      }
      develop(this.pixels, part, shape, errors, truth, tone);
      this.context.putImageData(this.image, 0, 0);
      // Beyond the picture's ends it is itself again: each copy doubles what is there.
      for (let done = part.width; done < width; done *= 2) {
        this.context.drawImage(this.canvas, 0, 0, done, part.height, done, 0, done, part.height);
      }
      for (let done = part.height; done < height; done *= 2) {
        this.context.drawImage(this.canvas, 0, 0, width, done, 0, done, width, done);
      }
    }

    resize(width, height, scale) {
      const { canvas } = this;
      canvas.hidden = false;
      if (canvas.width !== width) canvas.width = width;
      if (canvas.height !== height) canvas.height = height;
      const unit = scale / window.devicePixelRatio;
      canvas.style.width = `${width * unit}px`;
      canvas.style.height = `${height * unit}px`;
    }
  }

  Object.assign(perceptile, { Pane, toneOf });
})((globalThis.perceptileViewer ??= {}));
