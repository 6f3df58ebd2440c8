// The viewer of rendered scenes: two methods in one frame, and crops of all of them in rows.
//
// Pictures of a page that was opened from a file may be shown but not read, so all of this is
// <img> and CSS.
(function (perceptile) {
  'use strict';

  const { element, button, choice, slider, picker, ownsKey, keepFocus, freshId, Camera, ZOOM, steer, Stage, Turns } = perceptile;

  const CROP_ZOOM = 3;
  /** Widest frame in CSS pixels. */
  const MOST_WIDTH = 768;

  /**
   * @typedef {{name: string, view: string, file: string, value: number, ratio: number}} Picture
   * @typedef {{name: string, caption: string, width: number, height: number,
   *   reference: string | null, views: string[], pictures: Picture[],
   *   crops: {x: number, y: number, size: number}[]}} Scene
   */

  /** The figures of a picture in words. */
  const figures = ({ value, ratio }) => `${value.toPrecision(3)}, ${ratio.toPrecision(3)} of white noise`;

  class SceneViewer {
    /**
     * @param {HTMLElement} section
     * @param {Scene[]} scenes
     */
    constructor(section, scenes) {
      this.scenes = scenes;
      this.scene = scenes[0];
      this.view = this.scene.views[0];
      this.mode = 'swipe';
      this.sides = ['', ''];
      this.fit = 1;
      this.camera = new Camera(
        () => this.bounds(),
        () => this.place(),
      );
      this.build(section);
      this.setScene(0);
      new ResizeObserver(() => this.resize()).observe(this.root);
    }

    build(section) {
      const still = window.matchMedia('(prefers-reduced-motion: reduce)').matches;
      this.stage = new Stage('The rendered scene: arrow keys move it');
      this.turns = new Turns(this.stage, still);
      steer(this.stage.root, this.camera, () => this.unit);
      this.images = [this.stage.first, this.stage.second].map((layer) => {
        const image = element('img', { class: 'pv-render', draggable: false });
        layer.append(image);
        return image;
      });
      this.referenceImage = element('img', { class: 'pv-render', draggable: false });
      this.referenceLayer = element('div', { class: 'pv-layer', hidden: true }, this.referenceImage, element('span', { class: 'pv-tag' }, 'Reference'));
      this.stage.root.insertBefore(this.referenceLayer, this.stage.divider.root);

      const names = this.scenes.map(({ name }, number) => [String(number), name]);
      this.scenePicker = picker('Scene', names, (value) => this.setScene(Number(value)));
      this.viewPicker = picker('View', [], (value) => this.setView(value));
      this.sidePickers = [0, 1].map((side) => picker('', [], (value) => this.setSide(side, value)));
      this.sideFigures = [0, 1].map(() => element('output', { class: 'pv-note' }));
      this.modeChoice = choice('Compare', [['swipe', 'Swipe'], ['flicker', 'Flicker']], (value) => this.setMode(value));
      this.zoomSlider = slider('Zoom', { min: ZOOM.min, max: ZOOM.max, step: 1 }, (value) => `${value}×`, (value) => this.camera.zoomTo(value));
      this.caption = element('p', { class: 'pv-caption' });
      this.crops = element('div', { class: 'pv-crops' });

      const title = freshId();
      this.root = element(
        'div',
        { class: 'pv pv-scenes', role: 'group', 'aria-labelledby': title },
        element('h3', { id: title, class: 'pv-title' }, 'Side by side'),
        element('div', { class: 'pv-bar-top' }, this.scenePicker.root, this.viewPicker.root, this.modeChoice.root),
        this.caption,
        this.stage.root,
        this.turns.root,
        element(
          'div',
          { class: 'pv-sides' },
          ...[0, 1].map((side) => element('div', {}, this.sidePickers[side].root, this.sideFigures[side])),
        ),
        element('div', { class: 'pv-transport' }, this.makeReferenceButton(), this.zoomSlider.root, button('Whole picture', { class: 'pv-button pv-quiet', onclick: () => this.camera.show(1) })),
        this.crops,
      );
      this.root.addEventListener('keydown', (event) => this.key(event));
      this.root.addEventListener('keyup', (event) => event.key.toLowerCase() === 'r' && this.showReference(false));
      // What the page shows without script gives way, but not on paper.
      const figuresOfPage = section.querySelectorAll('figure');
      figuresOfPage.forEach((figure) => figure.classList.add('pv-replaced'));
      if (figuresOfPage.length > 0) figuresOfPage[0].before(this.root);
      else section.append(this.root);
    }

    makeReferenceButton() {
      const held = button('Hold for the reference', { class: 'pv-button pv-held', 'aria-pressed': 'false', title: 'Or hold R' });
      const show = () => this.showReference(true);
      const hide = () => this.showReference(false);
      held.addEventListener('pointerdown', (event) => {
        held.setPointerCapture(event.pointerId);
        show();
      });
      for (const name of ['pointerup', 'pointercancel', 'blur', 'keyup']) held.addEventListener(name, hide);
      held.addEventListener('keydown', (event) => (event.key === ' ' || event.key === 'Enter') && show());
      held.addEventListener('contextmenu', (event) => event.preventDefault());
      this.referenceButton = held;
      return held;
    }

    key(event) {
      if (event.ctrlKey || event.metaKey || event.altKey || ownsKey(event.target, event.key)) return;
      const actions = {
        s: () => this.setMode('swipe'),
        f: () => this.setMode('flicker'),
        t: () => this.mode === 'flicker' && this.turns.byHand(),
        r: () => this.showReference(true),
        '+': () => this.camera.zoomTo(this.camera.zoom + 1),
        '-': () => this.camera.zoomTo(this.camera.zoom - 1),
        0: () => this.camera.show(1),
      };
      const action = actions[event.key.toLowerCase()];
      if (!action) return;
      event.preventDefault();
      action();
    }

    // --- What the controls do ---------------------------------------------------------------

    setScene(number) {
      this.scene = this.scenes[number];
      const { name, caption, width, height, views, reference } = this.scene;
      this.view = views.includes(this.view) ? this.view : views[0];
      this.scenePicker.set(String(number));
      this.scenePicker.root.hidden = this.scenes.length < 2;
      this.viewPicker.fill(views.map((view) => [view, view]));
      this.viewPicker.set(this.view);
      this.viewPicker.root.hidden = views.length < 2;
      this.caption.textContent = this.scenes.length < 2 ? `${name}. ${caption}` : caption;
      this.stage.root.style.aspectRatio = `${width} / ${height}`;
      this.stage.root.setAttribute('aria-label', `${name}: arrow keys move the picture`);
      this.referenceButton.hidden = !reference;
      if (reference) Object.assign(this.referenceImage, { src: reference, alt: `${name}, reference`, width, height });
      this.fillView();
      this.camera.show(1);
      this.resize();
    }

    setView(view) {
      this.view = view;
      this.fillView();
    }

    /** Offers the methods that have a picture in the view; keeps the chosen ones if it can. */
    fillView() {
      const names = this.pictures.map(({ name }) => name);
      const best = this.pictures.reduce((least, picture) => (picture.value < least.value ? picture : least), this.pictures[0]);
      const fallback = [best?.name ?? '', names.includes('White noise') ? 'White noise' : names.at(-1) ?? ''];
      this.sides = this.sides.map((name, side) => (names.includes(name) ? name : fallback[side]));
      this.sidePickers.forEach(({ fill }) => fill(names.map((name) => [name, name])));
      this.fillSides();
      this.fillCrops();
    }

    setSide(side, name) {
      this.sides[side] = name;
      this.fillSides();
    }

    setMode(mode) {
      this.mode = mode;
      keepFocus(this.root, this.stage.root, () => {
        this.fillSides();
        this.stage.setMode(mode);
      });
    }

    showReference(shown) {
      this.referenceLayer.hidden = !shown || !this.scene.reference;
      this.referenceButton.setAttribute('aria-pressed', String(!this.referenceLayer.hidden));
    }

    /** @returns {Picture[]} those of the present scene and view */
    get pictures() {
      return this.scene.pictures.filter(({ view }) => view === this.view);
    }

    fillSides() {
      this.modeChoice.set(this.mode);
      this.turns.root.hidden = this.mode !== 'flicker';
      const labels = this.mode === 'swipe' ? ['Left', 'Right'] : ['First', 'Second'];
      this.sides.forEach((name, side) => {
        const picture = this.pictures.find((one) => one.name === name);
        this.sidePickers[side].set(name);
        this.sidePickers[side].label.textContent = labels[side];
        this.sideFigures[side].value = picture ? figures(picture) : '';
        const { width, height } = this.scene;
        const alt = `${this.scene.name}, ${name}, ${this.view}`;
        if (picture) Object.assign(this.images[side], { src: picture.file, alt, width, height });
      });
      this.stage.setNames(...this.sides);
      this.place();
    }

    // --- Where things are -------------------------------------------------------------------

    get room() {
      return { width: this.stage.root.clientWidth, height: this.stage.root.clientHeight };
    }

    /** Makes the frame as wide as whole device pixels for each pixel of the picture allow. */
    resize() {
      const { width } = this.scene;
      const ratio = window.devicePixelRatio;
      const most = Math.min(this.root.clientWidth, MOST_WIDTH) / width;
      this.fit = (most * ratio >= 1 ? Math.floor(most * ratio) / ratio : most) || 1;
      this.stage.root.style.width = `${width * this.fit}px`;
      this.camera.settle();
    }

    /** CSS pixels of a pixel of the picture. */
    get unit() {
      return this.fit * this.camera.zoom;
    }

    bounds() {
      const { width, height } = this.scene;
      const { room, unit } = this;
      return [Math.max((width - room.width / unit) / 2, 0), Math.max((height - room.height / unit) / 2, 0)];
    }

    place() {
      const { width, height } = this.scene;
      const { room, unit, camera } = this;
      const left = Math.round(room.width / 2 - (width / 2 + camera.x) * unit);
      const top = Math.round(room.height / 2 - (height / 2 + camera.y) * unit);
      for (const image of [...this.images, this.referenceImage]) {
        image.style.transform = `translate(${left}px, ${top}px) scale(${unit})`;
        image.style.imageRendering = unit >= 1 ? 'pixelated' : 'auto';
      }
      this.stage.root.classList.toggle('pv-zoomed', camera.zoom > 1);
      this.stage.root.dataset.camera = [camera.zoom, camera.x.toFixed(1), camera.y.toFixed(1)].join(' ');
      this.zoomSlider.set(camera.zoom);
    }

    // --- The crops --------------------------------------------------------------------------

    fillCrops() {
      const { reference, crops, name } = this.scene;
      const pictures = this.pictures.map((picture) => ({ ...picture, words: figures(picture) }));
      if (reference) pictures.push({ name: 'Reference', file: reference, words: '' });
      const rows = crops.map((crop, number) => {
        const cells = pictures.map((picture) => this.makeCrop(crop, picture, `Crop ${number + 1} of ${name}, ${picture.name}`));
        return element('div', { class: 'pv-crop-row', role: 'group', 'aria-label': `Crop ${number + 1}` }, ...cells);
      });
      this.crops.replaceChildren(...rows);
      this.crops.hidden = rows.length === 0;
    }

    makeCrop(crop, { name, file, words }, label) {
      const { width, height } = this.scene;
      const image = element('img', { loading: 'lazy', src: file, alt: '', width: width * CROP_ZOOM, height: height * CROP_ZOOM, draggable: false });
      image.style.transform = `translate(${-crop.x * CROP_ZOOM}px, ${-crop.y * CROP_ZOOM}px)`;
      const glass = element('button', { type: 'button', class: 'pv-crop', 'aria-label': `${label}: show it above`, onclick: () => this.visit(crop) }, image);
      glass.style.width = `${crop.size * CROP_ZOOM}px`;
      glass.style.height = `${crop.size * CROP_ZOOM}px`;
      const cell = element('div', { class: 'pv-crop-cell' }, glass, element('strong', {}, name), element('span', { class: 'pv-note' }, words));
      cell.style.width = glass.style.width;
      return cell;
    }

    /** Moves the big view to a crop, as large as fits, and the page to the big view. */
    visit({ x, y, size }) {
      const { width, height } = this.scene;
      const zoom = Math.floor(Math.min(width, height) / size);
      this.camera.show(Math.min(Math.max(zoom, ZOOM.min), ZOOM.max), x + size / 2 - width / 2, y + size / 2 - height / 2);
      this.stage.root.scrollIntoView({ block: 'nearest' });
    }
  }

  Object.assign(perceptile, { SceneViewer });
})((globalThis.perceptileViewer ??= {}));
