// The viewer of tiles: puts its parts together, and decides what is worked on and what is shown.
//
// A *target* is what the controls ask for; `current` is the last target that was finished, and
// what plays until the next one is. So nothing flashes or stalls while a slider is moved.
(function (perceptile) {
  'use strict';

  const { modulo, element, button, choice, slider, picker, ownsKey, keepFocus, freshId } = perceptile;
  const { Camera, ZOOM, steer, Stage, Turns, Pane, toneOf, Clock, Rate, Durations, Engine, KEEP, integrand } = perceptile;

  const MOST_PANES = 4;
  /** Sides of the soft shadow's picture: the tile repeats up to about this many pixels. */
  const PICTURE = 256;
  /** Pixels of all frames of the soft shadow's loop, at most. */
  const LOOP_PIXELS = 2 ** 23;
  /** So long after a change work that is under way goes on, before newer wishes replace it. */
  const PATIENCE = 250;
  /** After so long without a change the other views are worked out. */
  const QUIET = 600;
  /** While it plays, the number of the frame is said this often: each time costs a layout. */
  const SAYING = 100;

  const degrees = (value) => `${value}°`;
  const decimal = (value) => value.toFixed(2);
  const angle = ['angle', 'Angle', { min: 0, max: 359, step: 1 }, degrees];
  const across = ['x', 'Centre, across', { min: 0, max: 1, step: 0.01 }, decimal];
  const down = ['y', 'Centre, down', { min: 0, max: 1, step: 0.01 }, decimal];

  /** The integrands: their names, first values and sliders. */
  const INTEGRANDS = {
    edge: {
      name: 'Edge',
      values: { angle: 30, offset: 0 },
      sliders: [angle, ['offset', 'Offset', { min: -0.45, max: 0.45, step: 0.01 }, decimal]],
    },
    disk: {
      name: 'Disk',
      values: { x: 0.5, y: 0.5, radius: 0.35 },
      sliders: [across, down, ['radius', 'Radius', { min: 0.05, max: 0.65, step: 0.01 }, decimal]],
    },
    bump: {
      name: 'Bump',
      values: { x: 0.5, y: 0.5, sigma: 0.18 },
      sliders: [across, down, ['sigma', 'Width', { min: 0.05, max: 0.4, step: 0.01 }, decimal]],
    },
    linear: { name: 'Linear', values: { angle: 30 }, sliders: [angle] },
    shadow: {
      name: 'Soft shadow',
      values: { size: 0.22, softness: 0.4 },
      sliders: [
        ['size', 'Size', { min: 0.05, max: 0.45, step: 0.01 }, decimal],
        ['softness', 'Softness', { min: 0.05, max: 0.8, step: 0.01 }, decimal],
      ],
    },
  };

  const HELP = [
    ['Space', 'play or pause'],
    ['← →', 'one frame back or on'],
    ['1 – 4', 'views'],
    ['G  S  F', 'grid, swipe, flicker'],
    ['T', 'the other picture (flicker)'],
    ['+  −  0', 'zoom in, out, back to the start'],
    ['?', 'this help, anywhere on the page'],
    ['On a picture', 'drag or arrow keys move it, pinch or wheel zooms (click it first, or hold Ctrl)'],
    ['On the divider', 'drag, arrow keys, Page Up and Down, Home, End'],
  ];

  /** The name of a view inside a sentence: "as perceived", but "TAA, as perceived". */
  const inSentence = (name) => (/^.[a-z]/.test(name) ? name[0].toLowerCase() + name.slice(1) : name);

  /** The least common multiple. */
  function commonMultiple(a, b) {
    let [divisor, rest] = [a, b];
    while (rest > 0) [divisor, rest] = [rest, divisor % rest];
    return (a / divisor) * b;
  }

  class TileViewer {
    /**
     * @param {HTMLElement} root
     * @param {object} data what the page's viewer-data says
     * @param {string} source text of this script, for the worker
     */
    constructor(root, data, source) {
      this.root = root;
      this.tiles = data.tiles;
      this.views = data.views;
      this.clock = new Clock(data.fps);
      this.rate = new Rate();
      this.durations = new Durations(60);
      this.loaded = this.tiles.map(() => 'no');
      this.still = window.matchMedia('(prefers-reduced-motion: reduce)').matches;
      this.mode = 'grid';
      this.view = data.first;
      this.kind = 'edge';
      this.values = Object.fromEntries(Object.entries(INTEGRANDS).map(([kind, { values }]) => [kind, { ...values }]));
      this.loop = this.tiles[0].frames > 32 ? 1 : this.tiles[0].frames > 16 ? 2 : 4;
      this.show = 'picture';
      this.gain = 4;
      this.target = null;
      this.current = null;
      this.stale = false;
      this.since = 0;
      this.visible = false;
      this.frameRequest = 0;
      this.said = 0;
      this.panes = [];
      this.engine = new Engine(source, () => this.advance());
      this.camera = new Camera(
        () => this.bounds(),
        () => this.cameraMoved(),
      );

      this.build();
      this.firstTiles().forEach((tile) => this.addPane(tile));
      this.arrange();
      this.sync();
      this.watch();
    }

    // --- The page -------------------------------------------------------------------------

    build() {
      const views = this.views.map(({ name }, number) => [String(number), name]);
      this.viewChoice = choice('View', views, (value) => this.setView(Number(value)));
      this.modeChoice = choice('Compare', [['grid', 'Grid'], ['swipe', 'Swipe'], ['flicker', 'Flicker']], (value) => this.setMode(value));
      const kinds = Object.entries(INTEGRANDS).map(([kind, { name }]) => [kind, name]);
      this.kindChoice = choice('What is integrated', kinds, (value) => this.setKind(value));

      this.helpPanel = this.makeHelp();
      const help = button('Keys ?', { class: 'pv-button pv-quiet', 'aria-haspopup': 'dialog' });
      help.popoverTargetElement = this.helpPanel;

      this.stage = new Stage('Two pictures: arrow keys move them');
      steer(this.stage.root, this.camera, () => this.unit());
      this.turns = new Turns(this.stage, this.still);
      this.grid = element('div', { class: 'pv-grid' });
      this.add = button('Add a picture', { class: 'pv-button pv-quiet', onclick: () => this.morePanes() });
      this.status = element('p', { class: 'pv-status' });

      this.root.classList.add('pv');
      this.root.append(
        element('div', { class: 'pv-bar-top' }, this.viewChoice.root, this.modeChoice.root, help, this.helpPanel),
        this.stage.root,
        this.turns.root,
        this.grid,
        this.add,
        this.makeTransport(),
        element(
          'div',
          { class: 'pv-settings' },
          element('div', { class: 'pv-group' }, this.kindChoice.root, this.makeParameters()),
          this.makePictureSettings(),
        ),
      );
      this.root.addEventListener('keydown', (event) => this.key(event));
      // Who looks for the keys has mostly not found the viewer yet.
      document.addEventListener('keydown', (event) => this.keyAnywhere(event));
    }

    makeHelp() {
      const rows = HELP.flatMap(([keys, what]) => [element('dt', {}, keys), element('dd', {}, what)]);
      const title = freshId();
      const close = button('Close', { class: 'pv-button' });
      const panel = element(
        'div',
        { class: 'pv-help', popover: 'auto', role: 'dialog', 'aria-labelledby': title },
        element('h3', { id: title }, 'Keys'),
        element('dl', {}, ...rows),
        element(
          'p',
          {},
          'The number below a picture is its mean squared error over the whole period, as a part of what white noise has on average. ' +
            'Of a part of a tile, pixels and frames count only if the kernel stays inside the part; “ends wrap” says that none would be left.',
        ),
        element('p', {}, 'Of samples with more than two numbers, the first two are used.'),
        close,
      );
      close.popoverTargetElement = panel;
      close.popoverTargetAction = 'hide';
      return panel;
    }

    makeTransport() {
      this.playButton = button('', { class: 'pv-button pv-play', onclick: () => this.setPlaying(!this.clock.playing) });
      this.frameSlider = slider(
        'Frame',
        { min: 1, max: 1, step: 1 },
        (value) => `${value} of ${this.frameSlider?.input.max ?? 1}`,
        (value) => this.step(value - 1 - modulo(this.clock.frame, this.period)),
      );
      const speeds = [['1', 'full'], ['0.5', '½'], ['0.25', '¼']];
      const speed = picker('Speed', speeds, (value) => this.setSpeed(Number(value)));
      return element(
        'div',
        { class: 'pv-transport', role: 'group', 'aria-label': 'Playback' },
        this.playButton,
        button('‹', { class: 'pv-button pv-step', 'aria-label': 'One frame back', title: 'One frame back', onclick: () => this.step(-1) }),
        button('›', { class: 'pv-button pv-step', 'aria-label': 'One frame on', title: 'One frame on', onclick: () => this.step(1) }),
        this.frameSlider.root,
        speed.root,
        this.status,
      );
    }

    makeParameters() {
      this.sliders = {};
      this.preview = element('canvas', { class: 'pv-preview', width: 64, height: 64, role: 'img', 'aria-label': 'The function on the unit square' });
      const groups = Object.entries(INTEGRANDS).map(([kind, { sliders }]) => {
        const made = sliders.map(([name, text, range, words]) => {
          const one = slider(text, range, words, (value) => {
            this.values[kind][name] = value;
            this.sync();
          });
          one.set(this.values[kind][name]);
          return one;
        });
        this.sliders[kind] = element('div', { class: 'pv-sliders' }, ...made.map(({ root }) => root));
        return this.sliders[kind];
      });
      const loops = [1, 2, 4, 8].map((times) => [String(times), times === 1 ? 'each period' : `every ${times} periods`]);
      const loop = picker('Goes round', loops, (value) => {
        this.loop = Number(value);
        this.sync();
      });
      loop.set(String(this.loop));
      this.showChoice = choice('Show', [['picture', 'Picture'], ['error', 'Error']], (value) => {
        this.show = value;
        this.sync();
      });
      this.sliders.shadow.append(loop.root, this.showChoice.root);
      return element('div', { class: 'pv-parameters' }, this.preview, ...groups);
    }

    makePictureSettings() {
      this.gainSlider = slider(
        'Gain',
        { min: -1, max: 6, step: 0.25 },
        (value) => `${(2 ** value).toPrecision(2)}×`,
        (value) => {
          this.gain = 2 ** value;
          this.sync();
        },
      );
      this.zoomSlider = slider(
        'Zoom',
        { min: ZOOM.min, max: ZOOM.max, step: 1 },
        (value) => `${value}×`,
        (value) => this.camera.zoomTo(value),
      );
      const reset = button('Centre', { class: 'pv-button pv-quiet', onclick: () => this.resetCamera() });
      return element('div', { class: 'pv-group pv-picture' }, this.gainSlider.root, this.zoomSlider.root, reset);
    }

    // --- What the controls do ---------------------------------------------------------------

    setView(view) {
      this.view = view;
      this.sync();
    }

    setMode(mode) {
      if (mode !== 'grid' && this.tiles.length > 1 && this.panes.length < 2) this.addPane(this.tiles.length - 1);
      this.mode = mode;
      keepFocus(this.root, mode === 'grid' ? this.panes[0].frame : this.stage.root, () => this.arrange());
      this.sync();
    }

    setKind(kind) {
      this.kind = kind;
      this.camera.settle();
      this.sync();
    }

    setPlaying(playing) {
      if (playing) this.clock.play();
      else this.clock.stop();
      this.sync();
    }

    setSpeed(speed) {
      this.clock.speed = speed;
      this.rate.forget();
      this.sayStatus();
    }

    /**
     * Stops so many frames on. The clock itself counts on, or below 0, as going round with the
     * longest tile would be a leap for the others.
     */
    step(frames) {
      this.clock.stop(this.clock.frame + frames);
      this.sync();
    }

    /** The tiles that are shown at first: as many as there is room for, the last one, white noise, among them. */
    firstTiles() {
      const all = this.tiles.map((_, tile) => tile);
      return all.length > MOST_PANES ? [...all.slice(0, MOST_PANES - 1), all.at(-1)] : all;
    }

    addPane(tile) {
      const pane = new Pane(
        this.tiles,
        (number) => {
          pane.setTile(number, pane.picker.label.textContent);
          this.arrange();
          this.sync();
        },
        () => this.dropPane(pane),
      );
      pane.setTile(tile, 'Tile');
      steer(pane.frame, this.camera, () => this.unit());
      this.sizes?.observe(pane.frame);
      this.panes.push(pane);
    }

    /** Adds a picture of the first tile that has none. */
    morePanes() {
      const free = this.tiles.findIndex((_, number) => this.panes.every(({ tile }) => tile !== number));
      this.addPane(Math.max(free, 0));
      this.arrange();
      this.sync();
      this.panes.at(-1).picker.input.focus();
    }

    dropPane(pane) {
      this.panes = this.panes.filter((other) => other !== pane);
      pane.root.remove();
      this.arrange();
      this.sync();
      this.add.focus();
    }

    key(event) {
      const { key, target } = event;
      if (event.ctrlKey || event.metaKey || event.altKey || ownsKey(target, key)) return;
      const view = '1234'.indexOf(key);
      const actions = {
        ' ': () => this.setPlaying(!this.clock.playing),
        ArrowLeft: () => this.step(-1),
        ArrowRight: () => this.step(1),
        g: () => this.setMode('grid'),
        s: () => this.setMode('swipe'),
        f: () => this.setMode('flicker'),
        t: () => this.mode === 'flicker' && this.turns.byHand(),
        '+': () => this.camera.zoomTo(this.camera.zoom + 1),
        '-': () => this.camera.zoomTo(this.camera.zoom - 1),
        0: () => this.resetCamera(),
      };
      const action = view >= 0 && view < this.views.length ? () => this.setView(view) : actions[key.toLowerCase()] ?? actions[key];
      if (!action) return;
      event.preventDefault();
      action();
    }

    /** Opens and closes the list of keys, wherever on the page the focus is. */
    keyAnywhere(event) {
      const { key, target } = event;
      if (key !== '?' || event.ctrlKey || event.metaKey || event.altKey || ownsKey(target, key)) return;
      event.preventDefault();
      this.helpPanel.togglePopover();
    }

    // --- Where things are -------------------------------------------------------------------

    /** The panes that are seen: all in the grid, the first two otherwise. */
    get shown() {
      return this.mode === 'grid' ? this.panes : this.panes.slice(0, 2);
    }

    /** Frames of the longest animation that is shown. */
    get period() {
      return Math.max(...this.shown.map(({ tile }) => this.shapeOf(tile).frames));
    }

    /** Puts the panes where the mode has them. */
    arrange() {
      const compared = this.mode !== 'grid';
      this.root.dataset.mode = this.mode;
      this.stage.root.hidden = !compared;
      this.turns.root.hidden = this.mode !== 'flicker';
      this.add.hidden = compared || this.panes.length >= MOST_PANES;
      this.grid.style.setProperty('--panes', String(compared ? 2 : this.panes.length));
      const { shown } = this;
      this.panes.forEach((pane, number) => {
        const home = pane.frame.firstChild;
        const place = compared ? [this.stage.first, this.stage.second][number] ?? home : home;
        if (pane.canvas.parentNode !== place) place.append(pane.canvas);
        if (pane.root.parentNode !== this.grid) this.grid.append(pane.root);
        pane.frame.hidden = compared;
        pane.root.hidden = !shown.includes(pane);
        pane.remove.hidden = compared || this.panes.length < 2;
        pane.setTile(pane.tile, compared ? ['Left', 'Right'][number] ?? 'Tile' : `Tile ${number + 1}`);
      });
      if (compared) {
        if (this.mode === 'flicker') this.panes.slice(0, 2).forEach((pane, number) => (pane.picker.label.textContent = ['First', 'Second'][number]));
        this.stage.setNames(this.tiles[shown[0].tile].name, shown[1] ? this.tiles[shown[1].tile].name : '');
        this.stage.setMode(this.mode);
      }
      this.measure();
    }

    /** Asks for the room that pictures have. */
    measure() {
      const frame = this.mode === 'grid' ? this.panes[0].frame : this.stage.root;
      this.room = { width: frame.clientWidth, height: frame.clientHeight };
      this.invalidate();
    }

    /** Whole device pixels of one pixel of a picture. */
    get scale() {
      return Math.max(1, Math.round(this.camera.zoom * window.devicePixelRatio));
    }

    unit() {
      return this.scale / window.devicePixelRatio;
    }

    /** How far the camera may go: anywhere over pictures that repeat, else to their ends. */
    bounds() {
      const { shown } = this;
      if (shown.length === 0 || shown.every(({ tile }) => this.repeats(tile))) return null;
      const shapes = shown.map(({ tile }) => this.shapeOf(tile));
      const seen = (room) => room / this.unit();
      return [
        Math.max(...shapes.map(({ width }) => (width - seen(this.room.width)) / 2), 0),
        Math.max(...shapes.map(({ height }) => (height - seen(this.room.height)) / 2), 0),
      ];
    }

    cameraMoved() {
      this.zoomSlider.set(this.camera.zoom);
      for (const frame of [this.stage.root, ...this.panes.map((pane) => pane.frame)]) {
        frame.classList.toggle('pv-zoomed', this.camera.zoom > this.firstZoom);
      }
      this.root.dataset.camera = [this.camera.zoom, this.camera.x.toFixed(1), this.camera.y.toFixed(1)].join(' ');
      this.invalidate();
    }

    /** The zoom at which a picture of usual size about fills its frame. */
    get firstZoom() {
      return this.room.width >= 2 * PICTURE ? 2 : 1;
    }

    resetCamera() {
      this.camera.show(this.firstZoom);
    }

    /** Starts when the viewer comes into sight, and rests while it is out of it. */
    watch() {
      this.sizes = new ResizeObserver(() => this.measure());
      this.sizes.observe(this.stage.root);
      this.panes.forEach(({ frame }) => this.sizes.observe(frame));
      this.measure();
      this.resetCamera();
      const sight = new IntersectionObserver(
        (entries) => {
          const first = this.started !== true;
          this.visible = entries.at(-1).isIntersecting;
          if (this.visible && first) {
            this.started = true;
            if (!this.still) this.clock.play();
            this.sync();
          }
          this.invalidate();
        },
        { rootMargin: '200px' },
      );
      sight.observe(this.root);
    }

    // --- What is worked on ------------------------------------------------------------------

    repeats(tile) {
      return this.tiles[tile].whole && this.kind !== 'shadow';
    }

    /** The shape of a tile's animation under the present integrand. */
    shapeOf(tile) {
      const { width, height, frames } = this.tiles[tile];
      return this.kind === 'shadow' ? { ...this.shadowSize(tile), frames: this.shadowFrames } : { width, height, frames };
    }

    /** Sides of the soft shadow's picture for a tile. */
    shadowSize(tile) {
      const { width, height } = this.tiles[tile];
      const times = Math.max(1, Math.floor(PICTURE / Math.max(width, height)));
      return { width: width * times, height: height * times };
    }

    /** Frames of the soft shadow's loop: the same for all that is shown, as it is one shadow. */
    get shadowFrames() {
      const periods = this.shown.map(({ tile }) => this.tiles[tile].frames);
      const most = Math.min(
        ...this.shown.map(({ tile }) => {
          const { width, height } = this.shadowSize(tile);
          return Math.floor(LOOP_PIXELS / (width * height));
        }),
      );
      const longest = Math.max(...periods);
      const common = periods.reduce(commonMultiple);
      const even = common * Math.ceil((longest * this.loop) / common);
      if (even <= most) return even;
      // The others then have a seam where the loop ends.
      return longest * Math.max(1, Math.min(this.loop, Math.floor(most / longest)));
    }

    /** The job of a tile's animation as a view, or of the exact soft shadow. */
    job(kind, tile, view) {
      const { width, height, frames, spp, dims, whole } = this.tiles[tile];
      const shape = this.shapeOf(tile);
      const description = { kind: this.kind, ...this.values[this.kind] };
      const subject = kind === 'truth' ? ['truth', dims] : [tile, view];
      return {
        key: JSON.stringify([subject, description, shape]),
        kind,
        tile,
        tileShape: { width, height, frames, spp, dims, whole },
        shape,
        integrand: description,
        kernel: kind === 'truth' ? null : this.views[view].kernel,
      };
    }

    /** Brings page and work in line with the controls. */
    sync() {
      this.viewChoice.set(String(this.view));
      this.modeChoice.set(this.mode);
      this.kindChoice.set(this.kind);
      this.showChoice.set(this.show);
      this.gainSlider.set(Math.log2(this.gain));
      this.gainSlider.input.disabled = this.kind === 'shadow' && this.show === 'picture';
      this.playButton.textContent = this.clock.playing ? 'Pause' : 'Play';
      Object.entries(this.sliders).forEach(([kind, group]) => (group.hidden = kind !== this.kind));
      this.frameSlider.limit(this.period);
      this.drawPreview();
      this.ask();
      this.sayFrame();
      this.invalidate();
    }

    /** Loads the samples of a tile by a script tag: a page opened from a file may not fetch. */
    load(tile) {
      if (this.loaded[tile] !== 'no') return;
      this.loaded[tile] = 'loading';
      const failed = () => {
        this.loaded[tile] = 'failed';
        this.ask();
      };
      document.head.append(element('script', { src: this.tiles[tile].file, async: true, onerror: failed }));
    }

    /** Called by the scripts of the tiles. */
    receive(tile, text) {
      if (this.loaded[tile] !== 'loading') return;
      this.loaded[tile] = 'yes';
      this.engine.addTile(tile, text);
      this.ask();
    }

    /** Makes a target of the controls, unless younger work deserves a moment to finish. */
    ask() {
      if (!this.started) return;
      const waiting = this.target !== null && this.target !== this.current && this.target.asked;
      const age = performance.now() - this.since;
      if (waiting && age < PATIENCE) {
        if (!this.stale) setTimeout(() => this.stale && this.ask(), PATIENCE - age + 1);
        this.stale = true;
        return;
      }
      this.stale = false;
      const { shown } = this;
      shown.forEach(({ tile }) => this.load(tile));
      const slots = shown.map(({ tile }) => {
        const field = this.job('error', tile, this.view);
        const truth = this.kind === 'shadow' ? this.job('truth', tile, this.view) : null;
        return { tile, field, truth, kind: this.kind, repeats: this.repeats(tile) };
      });
      const jobs = slots
        .filter(({ tile }) => this.loaded[tile] === 'yes')
        .flatMap(({ field, truth }) => (truth ? [truth, field] : [field]));
      this.target = { slots, view: this.view, asked: jobs.length > 0 };
      this.since = performance.now();
      this.want(jobs);
      this.advance();
      clearTimeout(this.ahead);
      this.ahead = setTimeout(() => this.workAhead(), QUIET);
    }

    want(jobs) {
      const kept = this.current?.slots.flatMap(({ field, truth }) => [field.key, truth?.key]) ?? [];
      this.engine.want(jobs, kept);
    }

    /** With the target finished, works out the other views, if they are not too large to keep. */
    workAhead() {
      if (this.target !== this.current) return;
      const { slots } = this.target;
      const bytes = slots.reduce((sum, { field: { shape } }) => sum + 4 * shape.width * shape.height * shape.frames, 0);
      if (bytes * (this.views.length + 1) > KEEP) return;
      const ready = slots.filter(({ tile }) => this.loaded[tile] === 'yes');
      const present = ready.flatMap(({ field, truth }) => (truth ? [truth, field] : [field]));
      const others = ready.flatMap(({ tile }) => this.views.map((_, view) => this.job('error', tile, view)));
      const known = new Set(present.map(({ key }) => key));
      this.want([...present, ...others.filter(({ key }) => !known.has(key))]);
    }

    resultOf(job) {
      return this.engine.results.get(job.key);
    }

    /** Why a slot will never have a picture; empty if it may. */
    failureOf({ tile, field, truth }) {
      if (this.loaded[tile] === 'failed') return `${this.tiles[tile].file} could not be loaded`;
      return this.resultOf(field)?.failure || (truth && this.resultOf(truth)?.failure) || '';
    }

    /** Looks at what has been finished; called whenever something has. */
    advance() {
      const { target } = this;
      if (!target) return;
      const parts = target.slots.flatMap((slot) => {
        if (this.failureOf(slot)) return [1];
        return [slot.field, slot.truth].filter((job) => job).map((job) => {
          const result = this.resultOf(job);
          return result?.done ? 1 : Math.min(result?.share ?? 0, 0.99);
        });
      });
      const share = parts.reduce((sum, part) => sum + part, 0) / parts.length;
      const finished = parts.every((part) => part === 1);
      if (finished && this.current !== target) {
        this.current = target;
        this.sayRatios();
        if (this.stale) this.ask();
      }
      this.share = share;
      this.sayStatus();
      this.invalidate();
    }

    // --- What is said -----------------------------------------------------------------------

    sayRatios() {
      const { slots, view } = this.current;
      const words = inSentence(this.views[view].name);
      this.shown.forEach((pane, number) => {
        const slot = slots[number];
        if (slot?.tile !== pane.tile) return;
        const failure = this.failureOf(slot);
        const { ratio, wraps } = failure ? { ratio: NaN, wraps: false } : this.resultOf(slot.field);
        pane.say(ratio, words);
        pane.explain(failure, wraps);
      });
    }

    sayStatus() {
      const ready = this.current !== null && this.target === this.current;
      const rate = this.rate.value;
      const slow = this.clock.playing && rate !== null && rate < 0.9 * this.clock.fps * this.clock.speed;
      const text = !ready
        ? `Preparing ${Math.floor(100 * (this.share ?? 0))} %`
        : slow
          ? `This display shows ${Math.round(rate)} of ${Math.round(this.clock.fps * this.clock.speed)} frames a second.`
          : '';
      if (this.status.textContent !== text) this.status.textContent = text;
      this.root.dataset.state = ready && !this.stale ? 'ready' : 'preparing';
    }

    sayFrame() {
      const frame = modulo(this.clock.frame, this.period);
      this.frameSlider.set(frame + 1);
      this.root.dataset.frame = String(frame);
    }

    /** The function as a picture of the unit square. */
    drawPreview() {
      this.preview.hidden = this.kind === 'shadow';
      if (this.kind === 'shadow') return;
      const { at } = integrand({ kind: this.kind, ...this.values[this.kind] }, false);
      const { width, height } = this.preview;
      const context = this.preview.getContext('2d');
      const image = context.createImageData(width, height);
      const top = this.kind === 'linear' ? 1.5 : 1;
      for (let i = 0; i < width * height; i += 1) {
        const value = at(((i % width) + 0.5) / width, (Math.floor(i / width) + 0.5) / height);
        const grey = this.kind === 'linear' ? 127 + (255 * (value - at(0.5, 0.5))) / top : 40 + 200 * value;
        image.data.set([grey, grey, grey, 255], 4 * i);
      }
      context.putImageData(image, 0, 0);
    }

    // --- What is shown ----------------------------------------------------------------------

    /** Draws once more as soon as may be; while playing, for ever. */
    invalidate() {
      if (!this.frameRequest) this.frameRequest = requestAnimationFrame((now) => this.refresh(now));
    }

    refresh(now) {
      this.frameRequest = 0;
      const start = performance.now();
      const before = this.clock.frame;
      if (this.visible) this.clock.tick(now);
      else this.clock.last = null;
      const { frame } = this.clock;
      this.draw(frame);
      if (!this.clock.playing || !this.visible) {
        this.rate.forget();
        return;
      }
      this.invalidate();
      if (frame === before) return;
      if (this.rate.add(now)) this.sayStatus();
      if (now - this.said >= SAYING) {
        this.said = now;
        this.sayFrame();
      }
      this.durations.add(performance.now() - start);
      if (this.durations.full) this.root.dataset.frameMs = this.durations.median.toFixed(2);
    }

    /** Which slot to draw into a pane: what is finished of its tile, else what is being made. */
    slotOf(number, tile) {
      return [this.current, this.target].map((made) => made?.slots[number]).find((slot) => slot?.tile === tile);
    }

    draw(frame) {
      const ratio = window.devicePixelRatio;
      const room = { width: this.room.width * ratio, height: this.room.height * ratio };
      this.shown.forEach((pane, number) => {
        const slot = this.slotOf(number, pane.tile);
        if (!slot) return;
        const { field, truth, kind, repeats } = slot;
        const t = modulo(frame, field.shape.frames);
        const errors = this.resultOf(field)?.frames[t];
        const exact = truth ? this.resultOf(truth)?.frames[t] : null;
        const tone = toneOf(kind, this.show, this.gain);
        if (!errors || (tone.perTruth && !exact)) return;
        const picture = { key: `${field.key}${t}`, shape: field.shape, errors, truth: tone.perTruth ? exact : null, tone, repeats };
        pane.paint(picture, this.camera, room, this.scale);
      });
    }
  }

  Object.assign(perceptile, { TileViewer });
})((globalThis.perceptileViewer ??= {}));
