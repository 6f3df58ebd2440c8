// The clock of an animation: which frame is due when.
(function (perceptile) {
  'use strict';

  /** How far from a whole number of frames a refresh of the display may be to count as one. */
  const TOLERANCE = 0.06;
  /** How much the last refresh counts in the estimate of the display's rate. */
  const MEMORY = 0.02;
  /** After so many milliseconds without a refresh the page has been resting. */
  const REST = 500;

  /**
   * Counts frames by the display's refreshes. Where the display runs at the animation's rate, or
   * at a multiple of it, every refresh counts the same; adding up its jittering times would skip
   * and double frames.
   */
  class Clock {
    /** @param {number} fps frames per second at speed 1 */
    constructor(fps) {
      this.fps = fps;
      this.speed = 1;
      this.playing = false;
      this.position = 0;
      this.last = null;
      this.refresh = 1000 / 60;
      this.seen = 0;
    }

    get frame() {
      return Math.floor(this.position + 1e-6);
    }

    /** Goes to a frame, which may lie before the first, and stays there. */
    stop(frame = this.frame) {
      this.playing = false;
      this.position = frame;
      this.last = null;
    }

    play() {
      this.playing = true;
      this.last = null;
    }

    /** @param {number} now time of this refresh in milliseconds */
    tick(now) {
      if (!this.playing) return;
      if (this.last !== null) this.position += this.passed(now - this.last);
      this.last = now;
    }

    /** How many frames pass in a time between two refreshes. */
    passed(elapsed) {
      // After a pause of the page, a fresh start is better than a leap.
      if (elapsed > REST) return 1;
      const refreshes = Math.max(1, Math.round(elapsed / this.refresh));
      this.seen += 1;
      this.refresh += Math.max(1 / this.seen, MEMORY) * (elapsed / refreshes - this.refresh);
      const perRefresh = (this.refresh / 1000) * this.fps * this.speed;
      const whole = perRefresh >= 1 ? Math.round(perRefresh) : 1 / Math.round(1 / perRefresh);
      const steady = Math.abs(perRefresh / whole - 1) < TOLERANCE;
      return refreshes * (steady ? whole : perRefresh);
    }
  }

  /** How many frames a second are really shown, once a second. */
  class Rate {
    constructor() {
      this.forget();
    }

    /** Starts anew, as what was counted says nothing about what comes. */
    forget() {
      this.value = null;
      this.start = null;
    }

    /**
     * Counts a frame.
     *
     * @param {number} now when it is shown, in milliseconds
     * @returns {boolean} whether there is a new value
     */
    add(now) {
      if (this.start === null || now - this.last > REST) {
        this.start = now;
        this.count = 0;
      } else {
        this.count += 1;
      }
      this.last = now;
      if (now - this.start < 1000) return false;
      this.value = (1000 * this.count) / (now - this.start);
      this.start = now;
      this.count = 0;
      return true;
    }
  }

  /** The last so many durations; says their median. */
  class Durations {
    constructor(count) {
      this.values = new Float64Array(count);
      this.added = 0;
    }

    add(value) {
      this.values[this.added % this.values.length] = value;
      this.added += 1;
    }

    get full() {
      return this.added > 0 && this.added % this.values.length === 0;
    }

    get median() {
      return this.values.slice().sort()[this.values.length >> 1];
    }
  }

  Object.assign(perceptile, { Clock, Rate, Durations });
})((globalThis.perceptileViewer ??= {}));
