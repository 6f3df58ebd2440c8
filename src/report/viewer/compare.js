// Two pictures in one frame, by a divider or in turns, and the view that is zoomed and moved.
(function (perceptile) {
  'use strict';

  const { clamp, element, button, picker } = perceptile;

  /** What the keys, the wheel and the fingers do to a view of a picture. */
  const ZOOM = { min: 1, max: 8 };
  const KEY_PAN = 16;

  /** Which part of a picture is seen: a zoom, and the distance of the middle from the picture's. */
  class Camera {
    /**
     * @param {() => [number, number] | null} bounds how far the middle may go; null for any way
     * @param {() => void} changed
     */
    constructor(bounds, changed) {
      this.zoom = 1;
      this.x = 0;
      this.y = 0;
      this.bounds = bounds;
      this.changed = changed;
    }

    settle() {
      const bounds = this.bounds();
      if (bounds) {
        this.x = clamp(this.x, -bounds[0], bounds[0]);
        this.y = clamp(this.y, -bounds[1], bounds[1]);
      }
      this.changed();
    }

    /**
     * @param {number} zoom
     * @param {[number, number]} at the point, from the middle in pictures' pixels, that stays
     */
    zoomTo(zoom, [x, y] = [0, 0]) {
      const next = clamp(zoom, ZOOM.min, ZOOM.max);
      const stay = 1 - this.zoom / next;
      this.x += x * stay;
      this.y += y * stay;
      this.zoom = next;
      this.settle();
    }

    pan(x, y) {
      this.x += x;
      this.y += y;
      this.settle();
    }

    /** Shows the point (x, y) from the picture's middle in the middle. */
    show(zoom, x = 0, y = 0) {
      Object.assign(this, { zoom, x, y });
      this.settle();
    }
  }

  /**
   * Lets a frame be dragged, pinched, wheeled and steered by keys. The plain wheel scrolls the
   * page unless the frame has the focus, and a single finger scrolls it up and down until the
   * picture is zoomed.
   *
   * @param {HTMLElement} frame
   * @param {Camera} camera
   * @param {() => number} unit how many CSS pixels a pixel of the picture takes
   */
  function steer(frame, camera, unit) {
    /** @type {Map<number, {x: number, y: number}>} */
    const fingers = new Map();
    // A gesture of a fraction of a step must not be lost to a camera that rounds.
    let wish = 0;

    const fromMiddle = (x, y) => {
      const box = frame.getBoundingClientRect();
      return [(x - box.left - box.width / 2) / unit(), (y - box.top - box.height / 2) / unit()];
    };
    const zoomBy = (factor, x, y) => {
      wish = clamp(wish * factor, ZOOM.min, ZOOM.max);
      if (Math.round(wish) !== camera.zoom) camera.zoomTo(Math.round(wish), fromMiddle(x, y));
    };
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return { size: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
    };

    frame.addEventListener('pointerdown', (event) => {
      if (event.button !== 0 || event.target.closest('[role=slider]')) return;
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      frame.setPointerCapture(event.pointerId);
      wish = camera.zoom;
    });
    frame.addEventListener('pointermove', (event) => {
      const finger = fingers.get(event.pointerId);
      if (!finger) return;
      const before = fingers.size === 2 ? spread() : finger;
      const size = before.size;
      const { x, y } = before;
      Object.assign(finger, { x: event.clientX, y: event.clientY });
      const after = fingers.size === 2 ? spread() : finger;
      camera.pan((x - after.x) / unit(), (y - after.y) / unit());
      if (fingers.size === 2 && size > 0) zoomBy(after.size / size, after.x, after.y);
    });
    const lift = (event) => fingers.delete(event.pointerId);
    frame.addEventListener('pointerup', lift);
    frame.addEventListener('pointercancel', lift);

    let lastWheel = 0;
    frame.addEventListener(
      'wheel',
      (event) => {
        if (!event.ctrlKey && !frame.contains(document.activeElement)) return;
        event.preventDefault();
        if (event.timeStamp - lastWheel > 300) wish = camera.zoom;
        lastWheel = event.timeStamp;
        // A notch is 100 pixels or more: enough for the next whole zoom, also from the smallest.
        const pixels = event.deltaMode === 0 ? event.deltaY : event.deltaY * 33;
        zoomBy(Math.exp(-pixels * (event.ctrlKey ? 0.01 : 0.005)), event.clientX, event.clientY);
      },
      { passive: false },
    );

    frame.addEventListener('keydown', (event) => {
      if (event.target !== frame || event.ctrlKey || event.metaKey || event.altKey) return;
      const step = KEY_PAN / camera.zoom;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      const move = moves[event.key];
      if (!move) return;
      event.preventDefault();
      event.stopPropagation();
      camera.pan(...move);
    });
  }

  /** The line between two pictures; what is left of it shows the first, right of it the second. */
  class Divider {
    /** @param {() => void} moved called when `share`, 0 to 1 from the left, has changed */
    constructor(moved) {
      this.moved = moved;
      this.root = element(
        'div',
        {
          class: 'pv-divider',
          role: 'slider',
          tabIndex: 0,
          'aria-label': 'Divider between the two pictures',
          'aria-valuemin': '0',
          'aria-valuemax': '100',
          'aria-orientation': 'horizontal',
        },
        element('span', { class: 'pv-grip' }),
      );
      this.root.addEventListener('pointerdown', (event) => this.grab(event));
      this.root.addEventListener('pointermove', (event) => this.drag(event));
      this.root.addEventListener('keydown', (event) => this.key(event));
      this.put(0.5);
    }

    grab(event) {
      if (event.button !== 0) return;
      event.preventDefault();
      this.root.focus({ focusVisible: false });
      this.root.setPointerCapture(event.pointerId);
    }

    drag(event) {
      if (!this.root.hasPointerCapture(event.pointerId)) return;
      const box = this.root.parentElement.getBoundingClientRect();
      this.set((event.clientX - box.left) / box.width);
    }

    key(event) {
      const steps = { ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageDown: -0.1, PageUp: 0.1 };
      const ends = { Home: 0, End: 1 };
      if (event.key in steps) this.set(this.share + steps[event.key]);
      else if (event.key in ends) this.set(ends[event.key]);
      else return;
      event.preventDefault();
      event.stopPropagation();
    }

    set(share) {
      this.put(clamp(share, 0, 1));
      this.moved();
    }

    put(share) {
      this.share = share;
      const percent = Math.round(this.share * 100);
      this.root.style.left = `${this.share * 100}%`;
      this.root.setAttribute('aria-valuenow', String(percent));
      this.root.setAttribute('aria-valuetext', `${percent} % from the left`);
    }
  }

  /**
   * A frame with two layers, of which it shows parts (swipe) or one (flicker).
   *
   * The layers are any elements of the frame's size; the stage only clips and hides them.
   */
  class Stage {
    /** @param {string} label what is in the frame */
    constructor(label) {
      this.first = element('div', { class: 'pv-layer' });
      this.second = element('div', { class: 'pv-layer' });
      this.divider = new Divider(() => this.arrange());
      this.names = ['', ''];
      this.tags = [element('span', { class: 'pv-tag' }), element('span', { class: 'pv-tag pv-tag-right' })];
      this.root = element(
        'div',
        { class: 'pv-frame pv-stage', tabIndex: 0, role: 'group', 'aria-label': label },
        this.first,
        this.second,
        ...this.tags,
        this.divider.root,
      );
      this.mode = 'swipe';
      this.turn = 0;
      this.timer = 0;
      this.rate = 0;
      this.arrange();
    }

    /** @param {'swipe' | 'flicker'} mode */
    setMode(mode) {
      this.mode = mode;
      this.turn = 0;
      this.setRate(this.rate);
    }

    setNames(first, second) {
      this.names = [first, second];
      this.arrange();
    }

    /** @param {number} rate turns per second; 0 leaves the turns to the hand */
    setRate(rate) {
      this.rate = rate;
      clearInterval(this.timer);
      if (this.mode === 'flicker' && rate > 0) this.timer = setInterval(() => this.toggle(), 1000 / rate);
      this.arrange();
    }

    /** Shows the other picture. */
    toggle() {
      this.turn = 1 - this.turn;
      this.arrange();
    }

    arrange() {
      const swipe = this.mode === 'swipe';
      const { share } = this.divider;
      const [left, right] = this.tags;
      this.second.style.clipPath = swipe ? `inset(0 0 0 ${share * 100}%)` : 'none';
      this.second.style.visibility = swipe || this.turn === 1 ? 'visible' : 'hidden';
      this.divider.root.hidden = !swipe;
      right.hidden = !swipe || share > 0.95;
      left.hidden = swipe && share < 0.05;
      left.textContent = this.names[swipe ? 0 : this.turn];
      right.textContent = this.names[1];
      this.root.dataset.turn = swipe ? '' : String(this.turn);
    }
  }

  /** The controls of a stage's turns: so many a second, or one by hand. */
  class Turns {
    /**
     * @param {Stage} stage
     * @param {boolean} still whether nothing may move by itself at first
     */
    constructor(stage, still) {
      this.stage = stage;
      const rates = [['0', 'by hand'], ['1', '1 a second'], ['2', '2 a second'], ['4', '4 a second']];
      this.rate = picker('Turns', rates, (value) => stage.setRate(Number(value)));
      const other = button('Show the other', { onclick: () => this.byHand() });
      this.root = element('div', { class: 'pv-turns' }, this.rate.root, other);
      this.setRate(still ? 0 : 2);
    }

    setRate(rate) {
      this.rate.set(String(rate));
      this.stage.setRate(rate);
    }

    byHand() {
      this.setRate(0);
      this.stage.toggle();
    }
  }

  Object.assign(perceptile, { Camera, ZOOM, steer, Stage, Turns });
})((globalThis.perceptileViewer ??= {}));
