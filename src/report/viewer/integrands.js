// The functions that the viewer integrates over the unit square, with their exact integrals.
//
// Nothing here knows of pages: it runs in the page, in the worker and in the tests alike. An
// integrand is first a plain description ({kind: 'edge', angle: 20, offset: 0.1}), which travels
// to the worker, then what `integrand` makes of it. Tiles of one dimension are `flat`: their
// second coordinate is always 1/2, and integrals run along that line.
(function (perceptile) {
  'use strict';

  /** Radius of the way of the soft shadow, in widths of the picture. */
  const ORBIT = 0.2;

  /**
   * @typedef {object} Integrand
   * @property {(x: number, y: number) => number} at the function
   * @property {number} integral its exact mean over the square (flat: over the line y = 1/2)
   * @property {number} variance of the function around that mean
   */

  const radians = (degrees) => (degrees * Math.PI) / 180;
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  /** Cosine and sine of degrees, without the dust that would tilt an edge along an axis. */
  function direction(degrees) {
    const tidy = (value) => (Math.abs(value) < 1e-12 ? 0 : value);
    return [tidy(Math.cos(radians(degrees))), tidy(Math.sin(radians(degrees)))];
  }

  /** The part of the unit square where c·(x − 1/2) + s·(y − 1/2) > offset. */
  function halfPlane(c, s, offset) {
    if (offset < 0) return 1 - halfPlane(c, s, -offset);
    const long = Math.max(Math.abs(c), Math.abs(s));
    const short = Math.min(Math.abs(c), Math.abs(s));
    const end = (long + short) / 2;
    if (offset >= end) return 0;
    // The density along the direction is a trapezoid: flat in the middle, falling to the ends.
    if (offset <= (long - short) / 2) return 0.5 - offset / long;
    return (end - offset) ** 2 / (2 * long * short);
  }

  /** The part of the line y = 1/2 where c·(x − 1/2) > offset. */
  function halfLine(c, offset) {
    if (c === 0) return offset < 0 ? 1 : 0;
    const crossing = clamp(0.5 + offset / c, 0, 1);
    return c > 0 ? 1 - crossing : crossing;
  }

  /** Area of [0, a] × [0, b] inside a disk of radius r around the origin; a and b not below 0. */
  function corner(a, b, r) {
    const right = Math.min(a, r);
    const top = Math.min(b, r);
    if (right * right + top * top <= r * r) return right * top;
    const meets = Math.sqrt(Math.max(r * r - top * top, 0));
    const under = (x) => (x * Math.sqrt(Math.max(r * r - x * x, 0)) + r * r * Math.asin(x / r)) / 2;
    return top * meets + under(right) - under(meets);
  }

  /** Area of the unit square inside a disk around (x, y). */
  function diskInSquare(x, y, r) {
    const signed = (a, b) => Math.sign(a) * Math.sign(b) * corner(Math.abs(a), Math.abs(b), r);
    const area = signed(1 - x, 1 - y) - signed(-x, 1 - y) - signed(1 - x, -y) + signed(-x, -y);
    return clamp(area, 0, 1);
  }

  /** Length of the line y = 1/2 of the unit square inside a disk around (x, y). */
  function diskOnLine(x, y, r) {
    const squared = r * r - (0.5 - y) ** 2;
    if (squared <= 0) return 0;
    const half = Math.sqrt(squared);
    return Math.max(Math.min(x + half, 1) - Math.max(x - half, 0), 0);
  }

  /** ∫ exp(−(x − centre)²/(2σ²)) over [0, 1] by Simpson's rule; off by less than 10⁻⁷. */
  function gaussian(centre, sigma) {
    const intervals = 1024;
    let sum = 0;
    for (let i = 0; i <= intervals; i += 1) {
      const weight = i === 0 || i === intervals ? 1 : i % 2 === 1 ? 4 : 2;
      const z = (i / intervals - centre) / sigma;
      sum += weight * Math.exp(-0.5 * z * z);
    }
    return sum / (3 * intervals);
  }

  /** @returns {Integrand} of a function that is 1 on `share` of its domain and 0 elsewhere */
  function indicator(at, share) {
    return { at, integral: share, variance: share * (1 - share) };
  }

  function edge({ angle, offset }, flat) {
    const [c, s] = direction(angle);
    const at = (x, y) => (c * (x - 0.5) + s * (y - 0.5) > offset ? 1 : 0);
    return indicator(at, flat ? halfLine(c, offset) : halfPlane(c, s, offset));
  }

  function disk({ x: cx, y: cy, radius }, flat) {
    const squared = radius * radius;
    const at = (x, y) => ((x - cx) ** 2 + (y - cy) ** 2 < squared ? 1 : 0);
    return indicator(at, flat ? diskOnLine(cx, cy, radius) : diskInSquare(cx, cy, radius));
  }

  function bump({ x: cx, y: cy, sigma }, flat) {
    const scale = -1 / (2 * sigma * sigma);
    const at = (x, y) => Math.exp(scale * ((x - cx) ** 2 + (y - cy) ** 2));
    // The square of a Gaussian is one that is narrower by √2.
    const narrow = sigma / Math.SQRT2;
    const level = Math.exp(scale * (0.5 - cy) ** 2);
    const across = flat ? level : gaussian(cy, sigma);
    const acrossSquare = flat ? level * level : gaussian(cy, narrow);
    const integral = gaussian(cx, sigma) * across;
    const square = gaussian(cx, narrow) * acrossSquare;
    return { at, integral, variance: square - integral * integral };
  }

  function linear({ angle }, flat) {
    const [c, s] = direction(angle);
    const at = (x, y) => c * x + s * y;
    return { at, integral: (c + s) / 2, variance: flat ? (c * c) / 12 : 1 / 12 };
  }

  const forms = { edge, disk, bump, linear };

  /** Makes the function of a description; not for `shadow`, which differs from pixel to pixel. */
  function integrand(description, flat) {
    return forms[description.kind](description, flat);
  }

  /**
   * The soft shadow: a disk moves between a floor and a square light. Seen from a point of the
   * floor it is a disk on the unit square of the light's points, so what of the light is free has
   * a closed form. `size` is the radius of the shadow's middle line and `softness` the width of
   * its rim, both in units of the picture's width. The shadow's centre goes once around the
   * picture's centre in `frames` frames.
   */
  class Shadow {
    /**
     * @param {{size: number, softness: number}} description
     * @param {{width: number, height: number, frames: number}} shape of the picture
     * @param {boolean} flat whether the light is sampled along its middle line only
     */
    constructor(description, shape, flat) {
      this.shape = shape;
      this.softness = description.softness;
      this.radius = description.size / description.softness;
      this.flat = flat;
      this.step = 1 / (shape.width * description.softness);
    }

    /**
     * The blocker on the light's square, seen from the middle of pixel (0, 0) of frame t; from
     * pixel (x, y) it stands at (cx − x·step, cy − y·step).
     */
    start(t) {
      const { width, height, frames } = this.shape;
      const turn = (2 * Math.PI * t) / frames;
      const shadowX = 0.5 + ORBIT * Math.cos(turn);
      const shadowY = height / width / 2 + ORBIT * Math.sin(turn);
      const seen = (at) => 0.5 + (at - 0.5 / width) / this.softness;
      return [seen(shadowX), seen(shadowY)];
    }

    /** What part of the light a pixel sees when the blocker stands at (cx, cy) on its square. */
    free(cx, cy) {
      const r = this.radius;
      if (this.flat) return 1 - diskOnLine(cx, cy, r);
      // Most pixels are quite free or quite dark: the square's nearest and farthest point tell.
      const nearX = Math.max(-cx, cx - 1, 0);
      const nearY = Math.max(-cy, cy - 1, 0);
      if (nearX * nearX + nearY * nearY >= r * r) return 1;
      const farX = Math.max(cx, 1 - cx);
      const farY = Math.max(cy, 1 - cy);
      if (farX * farX + farY * farY <= r * r) return 0;
      return 1 - diskInSquare(cx, cy, r);
    }
  }

  Object.assign(perceptile, { clamp, diskInSquare, integrand, Shadow });
})((globalThis.perceptileViewer ??= {}));
