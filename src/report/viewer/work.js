// The work behind the pictures: samples are decoded, integrated and filtered, away from the page.
//
// A `Bench` knows how to do a job; a `Queue` does jobs in slices of a few milliseconds; an
// `Engine` is what the page talks to. The engine's queue runs in a worker, which is this very
// script started from a blob, and in the page itself where no worker can be had.
(function (perceptile) {
  'use strict';

  const { integrand, Shadow, filter, counted, sumOf, ratio } = perceptile;

  /**
   * A job makes one animation. Its `key` names the result.
   *
   * @typedef {object} Job
   * @property {string} key
   * @property {'error' | 'truth'} kind the filtered error of a tile, or the exact soft shadow
   * @property {number} [tile] number of the tile (kind error)
   * @property {{width: number, height: number, frames: number, spp: number, dims: number,
   *   whole: boolean}} tileShape
   * @property {{width: number, height: number, frames: number}} shape of the animation
   * @property {object} integrand a description, see integrands.js
   * @property {object | null} kernel
   */

  /** Characters of base64 that are decoded at once; whole bytes and whole numbers come of it. */
  const CHUNK = 4 * 3 * 16384;
  /** The worker's queue looks for messages this often, in milliseconds. */
  const WORKER_SLICE = 10;
  /** What the queue may take of a frame where it runs in the page, in milliseconds. */
  const PAGE_SLICE = 3;
  /** Bytes of results that are kept for views and integrands that may be chosen again. */
  const KEEP = 160 * 2 ** 20;

  /** Decodes little-endian 16-bit numbers from base64; returns them at the end. */
  function* decode(text) {
    const padding = text.endsWith('==') ? 2 : text.endsWith('=') ? 1 : 0;
    const numbers = new Uint16Array(((text.length / 4) * 3 - padding) / 2);
    let at = 0;
    for (let start = 0; start < text.length; start += CHUNK) {
      const bytes = atob(text.slice(start, start + CHUNK));
      for (let i = 0; i + 1 < bytes.length; i += 2) {
        numbers[at] = bytes.charCodeAt(i) | (bytes.charCodeAt(i + 1) << 8);
        at += 1;
      }
      yield Math.min(1, (start + CHUNK) / text.length);
    }
    return numbers;
  }

  /** Whether the second coordinate is the 1/2 that tiles of one dimension are given. */
  const isFlat = ({ tileShape }) => tileShape.dims === 1;

  const coordinate = (number) => (number + 0.5) / 65536;

  /** The error of each pixel, its mean of f over the samples less the integral, into `errors`. */
  function* plainErrors(numbers, job, errors) {
    const { spp, frames } = job.tileShape;
    const flat = isFlat(job);
    const { at, integral } = integrand(job.integrand, flat);
    const pixels = errors.length / frames;
    let from = 0;
    for (let t = 0; t < frames; t += 1) {
      for (let i = t * pixels; i < (t + 1) * pixels; i += 1) {
        let sum = 0;
        for (let s = 0; s < spp; s += 1) {
          sum += at(coordinate(numbers[from]), flat ? 0.5 : coordinate(numbers[from + 1]));
          from += 2;
        }
        errors[i] = sum / spp - integral;
      }
      yield (t + 1) / frames;
    }
  }

  /** The same for the soft shadow, on a picture over which the tile repeats. */
  function* shadowErrors(numbers, job, truth, errors) {
    const { tileShape, shape } = job;
    const { spp } = tileShape;
    const flat = isFlat(job);
    const shadow = new Shadow(job.integrand, shape, flat);
    const squared = shadow.radius * shadow.radius;
    let i = 0;
    for (let t = 0; t < shape.frames; t += 1) {
      const [startX, startY] = shadow.start(t);
      for (let y = 0; y < shape.height; y += 1) {
        const cy = startY - y * shadow.step;
        const row = ((t % tileShape.frames) * tileShape.height + (y % tileShape.height)) * tileShape.width;
        for (let x = 0; x < shape.width; x += 1, i += 1) {
          const free = truth[i];
          if (free === 0 || free === 1) continue;
          const cx = startX - x * shadow.step;
          let from = (row + (x % tileShape.width)) * spp * 2;
          let sum = 0;
          for (let s = 0; s < spp; s += 1, from += 2) {
            const dx = coordinate(numbers[from]) - cx;
            const dy = (flat ? 0.5 : coordinate(numbers[from + 1])) - cy;
            if (dx * dx + dy * dy >= squared) sum += 1;
          }
          errors[i] = sum / spp - free;
        }
      }
      yield (t + 1) / shape.frames;
    }
  }

  /** The exact soft shadow, into `truth`. */
  function* shadowTruth(description, shape, flat, truth) {
    const shadow = new Shadow(description, shape, flat);
    let i = 0;
    for (let t = 0; t < shape.frames; t += 1) {
      const [startX, startY] = shadow.start(t);
      for (let y = 0; y < shape.height; y += 1) {
        const cy = startY - y * shadow.step;
        for (let x = 0; x < shape.width; x += 1, i += 1) truth[i] = shadow.free(startX - x * shadow.step, cy);
      }
      yield (t + 1) / shape.frames;
    }
  }

  /** Runs a generator as the part of a job between two shares; returns what it returns. */
  function* part(work, low, high) {
    for (;;) {
      const { value, done } = work.next();
      if (done) return value;
      yield low + value * (high - low);
    }
  }

  /** Does jobs, and keeps what the next ones can use. */
  class Bench {
    constructor() {
      /** @type {Map<number, Uint16Array>} */
      this.tiles = new Map();
      /** The last errors of each tile, and the last exact shadow. */
      this.errors = new Map();
      this.truth = { key: '', values: new Float32Array(0) };
    }

    *addTile(number, text) {
      this.tiles.set(number, yield* decode(text));
    }

    /** The samples of a job's tile, which must be as many as its shape says. */
    samplesOf({ tile, tileShape: { width, height, frames, spp } }) {
      const numbers = this.tiles.get(tile);
      const expected = width * height * frames * spp * 2;
      if (numbers?.length !== expected) {
        throw new Error(`tile ${tile} holds ${numbers?.length ?? 0} numbers, not ${expected}`);
      }
      return numbers;
    }

    *truthOf(job) {
      const { integrand: description, shape } = job;
      const key = JSON.stringify([description, shape, isFlat(job)]);
      if (this.truth.key !== key) {
        const values = new Float32Array(shape.width * shape.height * shape.frames);
        yield* shadowTruth(description, shape, isFlat(job), values);
        this.truth = { key, values };
      }
      return this.truth.values;
    }

    *errorsOf(job) {
      const numbers = this.samplesOf(job);
      const key = JSON.stringify([job.integrand, job.shape]);
      const known = this.errors.get(job.tile);
      if (known?.key === key) return known;
      this.errors.delete(job.tile);
      const { width, height, frames } = job.shape;
      const values = new Float32Array(width * height * frames);
      let truth = null;
      if (job.integrand.kind === 'shadow') {
        truth = yield* part(this.truthOf(job), 0, 0.5);
        yield* part(shadowErrors(numbers, job, truth, values), 0.5, 1);
      } else {
        yield* plainErrors(numbers, job, values);
      }
      const made = { key, values, truth };
      this.errors.set(job.tile, made);
      return made;
    }

    /**
     * @param {Job} job
     * @param {(message: object) => void} emit gets `frame` messages and one `done`
     */
    *work(job, emit) {
      if (job.kind === 'truth') {
        const values = yield* part(this.truthOf(job), 0, 0.9);
        yield* part(
          filter(values, job.shape, null, (t, frame) => emit({ type: 'frame', key: job.key, t, values: frame })),
          0.9,
          1,
        );
        emit({ type: 'done', key: job.key, ratio: NaN, wraps: false });
        return;
      }
      const { values, truth } = yield* part(this.errorsOf(job), 0, 0.4);
      const { width, height } = job.shape;
      const inner = counted(job.shape, job.tileShape, job.kernel);
      const pixels = inner.columns.length * inner.rows.length * inner.frames.size;
      let [square, noise] = [0, 0];
      const send = (t, frame) => {
        if (inner.frames.has(t)) {
          square += sumOf(inner, width, (i) => frame[i] * frame[i]) / pixels;
          const start = t * width * height;
          if (truth) noise += sumOf(inner, width, (i) => truth[start + i] * (1 - truth[start + i])) / pixels;
        }
        emit({ type: 'frame', key: job.key, t, values: frame });
      };
      yield* part(filter(values, job.shape, job.kernel, send), 0.4, 1);
      const variance = truth ? noise : integrand(job.integrand, isFlat(job)).variance;
      const score = ratio(square, variance, job.kernel, job.tileShape.spp);
      emit({ type: 'done', key: job.key, ratio: score, wraps: inner.wraps });
    }
  }

  /** Does the wanted jobs one after the other, in slices, and forgets those no longer wanted. */
  class Queue {
    /**
     * @param {(message: object) => void} emit
     * @param {number} slice milliseconds of one go
     * @param {(run: () => void) => void} later how to wait for the next go
     */
    constructor(emit, slice, later) {
      this.bench = new Bench();
      this.emit = emit;
      this.slice = slice;
      this.later = later;
      this.decoding = [];
      this.jobs = [];
      this.current = null;
      this.waiting = false;
    }

    receive(message) {
      if (message.type === 'tile') {
        this.decoding.push(message);
      } else {
        this.jobs = message.jobs;
        const { key = null } = this.current ?? {};
        if (key !== null && this.jobs[0]?.key !== key) this.current = null;
      }
      this.wake();
    }

    wake() {
      if (this.waiting) return;
      this.waiting = true;
      this.later(() => {
        this.waiting = false;
        this.run();
      });
    }

    /** What to do next: tiles first, since jobs need them. */
    next() {
      if (this.decoding.length > 0) {
        const { number, text } = this.decoding.shift();
        return { key: null, work: this.bench.addTile(number, text) };
      }
      const job = this.jobs[0];
      return job ? { key: job.key, work: this.bench.work(job, this.emit) } : null;
    }

    run() {
      const end = performance.now() + this.slice;
      try {
        while (performance.now() < end) {
          this.current ??= this.next();
          if (!this.current) return;
          const { key, work } = this.current;
          const { value, done } = work.next();
          if (done) {
            this.current = null;
            if (key !== null) this.jobs = this.jobs.filter((job) => job.key !== key);
          } else if (key !== null) {
            this.current.share = value;
          }
        }
        const { key, share } = this.current ?? {};
        if (key) this.emit({ type: 'progress', key, share });
      } catch (error) {
        const key = this.current?.key ?? null;
        this.current = null;
        this.jobs = this.jobs.filter((job) => job.key !== key);
        this.emit({ type: 'failed', key, message: String(error) });
      }
      this.wake();
    }
  }

  /** The worker's side: jobs come in as messages, frames go out. */
  function serve(scope) {
    const { port1, port2 } = new MessageChannel();
    let next = null;
    port1.onmessage = () => next();
    const later = (run) => {
      next = run;
      port2.postMessage(null);
    };
    const emit = (message) => scope.postMessage(message, message.values ? [message.values.buffer] : []);
    const queue = new Queue(emit, WORKER_SLICE, later);
    scope.onmessage = ({ data }) => queue.receive(data);
    emit({ type: 'ready' });
  }

  /**
   * @typedef {object} Result
   * @property {Float32Array[]} frames with holes where they are not finished
   * @property {number} arrived how many frames are finished
   * @property {number} share of the work that is done
   * @property {boolean} done
   * @property {number} ratio to white noise, when done
   * @property {boolean} wraps whether a part's ends had to count in the ratio
   * @property {string} failure empty, or why there will be no result
   */

  /** @returns {Result} */
  function emptyResult(job) {
    return { frames: new Array(job.shape.frames), arrived: 0, share: 0, done: false, ratio: NaN, wraps: false, failure: '' };
  }

  /** The page's side: asks for results and keeps them. */
  class Engine {
    /**
     * @param {string} source this script's text; empty where it is not known
     * @param {() => void} changed called when a result has come or grown
     */
    constructor(source, changed) {
      this.changed = changed;
      /** @type {Map<string, Result>} least recently used first */
      this.results = new Map();
      this.wanted = new Set();
      this.kept = new Set();
      this.waiting = [];
      this.post = (message) => this.waiting.push(message);
      this.start(source);
    }

    start(source) {
      if (!source || typeof Worker === 'undefined') {
        this.runHere();
        return;
      }
      try {
        const url = URL.createObjectURL(new Blob([source], { type: 'text/javascript' }));
        const worker = new Worker(url);
        worker.onerror = () => this.runHere();
        worker.onmessage = ({ data }) => {
          if (data.type !== 'ready') {
            this.receive(data);
            return;
          }
          URL.revokeObjectURL(url);
          this.place = 'worker';
          this.send((message) => worker.postMessage(message));
        };
      } catch {
        this.runHere();
      }
    }

    runHere() {
      if (this.place) return;
      this.place = 'page';
      const queue = new Queue((message) => this.receive(message), PAGE_SLICE, (run) => setTimeout(run, 4));
      this.send((message) => queue.receive(message));
    }

    /** Opens the way to the queue for what has been waiting and all that follows. */
    send(post) {
      this.post = post;
      this.waiting.splice(0).forEach(post);
    }

    addTile(number, text) {
      this.post({ type: 'tile', number, text });
    }

    /**
     * Says what is wanted from now on; whatever else is under way is dropped.
     *
     * @param {Job[]} jobs the most urgent first
     * @param {Iterable<string>} kept keys of results that must stay, as they are being shown
     */
    want(jobs, kept) {
      this.wanted = new Set(jobs.map((job) => job.key));
      this.kept = new Set(kept);
      for (const [key, result] of this.results) {
        if (!result.done && !result.failure && !this.wanted.has(key)) this.results.delete(key);
      }
      const open = [];
      for (const job of jobs) {
        const result = this.results.get(job.key);
        this.results.delete(job.key);
        this.results.set(job.key, result ?? emptyResult(job));
        if (!result?.done && !result?.failure) open.push(job);
      }
      this.forget();
      this.post({ type: 'want', jobs: open });
    }

    /** Drops the results that were not used for longest, down to what may be kept. */
    forget() {
      const size = (result) => result.frames.reduce((sum, frame) => sum + (frame?.byteLength ?? 0), 0);
      let total = [...this.results.values()].reduce((sum, result) => sum + size(result), 0);
      for (const [key, result] of this.results) {
        if (total <= KEEP) return;
        if (this.wanted.has(key) || this.kept.has(key)) continue;
        total -= size(result);
        this.results.delete(key);
      }
    }

    receive({ type, key, t, values, share, ratio: score, wraps, message }) {
      const result = this.results.get(key);
      if (!result) return;
      if (type === 'frame') {
        if (!result.frames[t]) result.arrived += 1;
        result.frames[t] = values;
      } else if (type === 'progress') {
        result.share = share;
      } else if (type === 'failed') {
        result.failure = message;
      } else if (result.arrived === result.frames.length) {
        // Otherwise it is the end of a job that was dropped and is wanted again: all comes anew.
        Object.assign(result, { share: 1, done: true, ratio: score, wraps });
      }
      if (type !== 'frame') this.changed();
    }
  }

  Object.assign(perceptile, { decode, Bench, Queue, Engine, serve, KEEP });
})((globalThis.perceptileViewer ??= {}));
