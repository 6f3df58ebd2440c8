// Builders of the controls, all of them native elements with names.
(function (perceptile) {
  'use strict';

  let made = 0;
  const freshId = () => `pv-${(made += 1)}`;

  /**
   * Makes an element. Properties that start with `on` are listeners, `class` and names with a
   * dash are attributes, all others properties.
   */
  function element(tag, properties = {}, ...children) {
    const node = document.createElement(tag);
    for (const [name, value] of Object.entries(properties)) {
      if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
      else if (name === 'class' || name === 'role' || name === 'for' || name.includes('-')) node.setAttribute(name, value);
      else node[name] = value;
    }
    node.append(...children);
    return node;
  }

  function button(text, properties) {
    return element('button', { type: 'button', class: 'pv-button', ...properties }, text);
  }

  /**
   * A row of radio buttons.
   *
   * @param {string} legend
   * @param {[string, string][]} options value and text of each
   * @param {(value: string) => void} chosen
   * @returns {{root: HTMLElement, set: (value: string) => void}}
   */
  function choice(legend, options, chosen) {
    const name = freshId();
    const inputs = options.map(([value, text]) => {
      const input = element('input', { type: 'radio', name, value, onchange: () => chosen(value) });
      return [input, element('label', {}, input, element('span', {}, text))];
    });
    const row = element('div', { class: 'pv-segments' }, ...inputs.map(([, label]) => label));
    const root = element('fieldset', { class: 'pv-choice' }, element('legend', {}, legend), row);
    const set = (value) => inputs.forEach(([input]) => (input.checked = input.value === value));
    return { root, set };
  }

  /**
   * A slider with its value in words.
   *
   * @param {string} text
   * @param {{min: number, max: number, step: number}} range
   * @param {(value: number) => string} words
   * @param {(value: number) => void} moved
   */
  function slider(text, { min, max, step }, words, moved) {
    const id = freshId();
    const input = element('input', { type: 'range', id, min, max, step });
    const output = element('output', { for: id });
    const root = element('div', { class: 'pv-slider' }, element('label', { for: id }, text), input, output);
    const show = () => {
      output.value = words(input.valueAsNumber);
      input.setAttribute('aria-valuetext', output.value);
    };
    input.addEventListener('input', () => {
      show();
      moved(input.valueAsNumber);
    });
    const set = (value) => {
      if (input.valueAsNumber === value && output.value !== '') return;
      input.value = value;
      show();
    };
    const limit = (most) => {
      input.max = most;
      show();
    };
    return { root, input, set, limit };
  }

  /**
   * A drop-down list.
   *
   * @param {string} text its label
   * @param {[string, string][]} options value and text of each
   * @param {(value: string) => void} chosen
   */
  function picker(text, options, chosen) {
    const id = freshId();
    const input = element('select', { id, onchange: () => chosen(input.value) });
    const fill = (list) => input.replaceChildren(...list.map(([value, name]) => element('option', { value }, name)));
    fill(options);
    const label = element('label', { for: id }, text);
    const root = element('div', { class: 'pv-picker' }, label, input);
    const set = (value) => (input.value = value);
    return { root, input, label, set, fill };
  }

  /** Whether a key pressed on `target` has a meaning of its own there. */
  function ownsKey(target, key) {
    if (target.matches('select, textarea')) return true;
    const arrows = key.startsWith('Arrow') || key === 'Home' || key === 'End';
    if (target.matches('input[type=range]')) return arrows || key.startsWith('Page');
    if (target.matches('input[type=radio]')) return arrows;
    return target.matches('button, summary, a') && (key === ' ' || key === 'Enter');
  }

  /**
   * Makes a change after which what has the focus inside `root` may be hidden: then `heir` gets
   * the focus, as without it the keys are dead.
   */
  function keepFocus(root, heir, change) {
    const { activeElement } = document;
    change();
    if (root.contains(activeElement) && activeElement.getClientRects().length === 0) heir.focus();
  }

  Object.assign(perceptile, { element, button, choice, slider, picker, ownsKey, keepFocus, freshId });
})((globalThis.perceptileViewer ??= {}));
