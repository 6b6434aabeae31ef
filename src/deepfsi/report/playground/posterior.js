// Posterior of the scene, look after look: deepfsi.adaptive.posterior in the browser.

import { dot, factorise, softmax, squaredLength, temperatureAt } from "./numbers.js";

const DIMMEST = 1e-6; // least light of a scene through a mask, over that of the whole mean scene
const LARGEST_SIZE = 1e9; // of the negative binomial law; beyond, it is Poisson's
const LEAST_WEIGHT = 1e-30; // of a class, of which odds are taken
const UNLIKELY = 1e-12; // probability below which a scene is left out of sums

/** Add a vector times a factor, in place; the vector is read from a place on. */
export function add(to, factor, vector, start = 0) {
  for (let i = 0; i < to.length; i++) to[i] += factor * vector[start + i];
  return to;
}

/** Training scenes as sums of a mean and components; those near them differ normally, by I. */
export class Prior {
  constructor({ mean, components, steps, levels, members, sizes, spread, temperatures }) {
    Object.assign(this, { mean, sizes, spread, temperatures });
    const most = members.reduce((a, b) => Math.max(a, b), 1);
    this.logs = Float64Array.from(members, (each) => Math.log(each / most)); // before all counts
    this.parts = steps.length; // d
    const pixels = mean.length;
    const turned = (_, i) => components[(i % this.parts) * pixels + Math.floor(i / this.parts)];
    this.components = Float32Array.from(components, turned); // those of a pixel side by side
    this.count = levels.length / this.parts; // n
    this.coefficients = Float32Array.from(levels, (level, i) => level * steps[i % this.parts]);
    this.labels = sizes.flatMap((size, place) => new Array(size).fill(place));
    this.whole = mean.reduce((a, b) => a + b, 0);
    const sums = sizes.map(() => 0);
    this.labels.forEach((label, scene) => (sums[label] += members[scene]));
    const all = sums.reduce((a, b) => a + b, 0);
    this.shares = sums.map((sum) => Math.log(sum / all)); // logarithms of those of the classes
  }

  /** Light of the mean scene through what a readout sees (N), and of each component. */
  light(seen) {
    const parts = new Float64Array(this.parts);
    seen.forEach((share, pixel) => share && add(parts, share, this.components, pixel * this.parts));
    return { mean: dot(seen, this.mean), parts };
  }

  /** Coefficients as differences from the mean scene (N). */
  picture(coefficients) {
    return Float64Array.from(this.mean, (_, pixel) => dot(coefficients, this.components, pixel * this.parts));
  }
}

/** Optics of a look: what its readouts see, and what they count. */
export class LookOptics {
  constructor({ rails, detectors, labels, dark, summed_reflectance }, photons) {
    Object.assign(this, { arms: rails, detectors, labels, dark, photons, gain: photons / summed_reflectance });
  }

  detector(pixel) {
    return this.labels ? this.labels[pixel] : 0;
  }

  /** Pixels that each readout sees, arm by arm, detector by detector. */
  readouts(mask) {
    const places = Array.from({ length: this.arms * this.detectors }, (_, place) => place);
    return places.map((place) => {
      const [arm, detector] = [Math.floor(place / this.detectors), place % this.detectors];
      return Float64Array.from(mask, (on, i) => (this.detector(i) === detector ? (arm ? 1 - on : on) : 0));
    });
  }

  /** Expected counts of a scene for a share of the exposure. */
  expected(mask, scene, share) {
    return this.readouts(mask).map((seen) => dot(seen, scene) * this.gain * share + this.dark * share);
  }
}

export class Posterior {
  constructor(prior, optics) {
    Object.assign(this, { prior, optics, known: [] });
    this.logs = Float64Array.from(prior.logs);
    this.taken = 0; // looks
    this.shift = new Float64Array(prior.parts); // mean of what the scene differs from those known
    this.weigh();
  }

  /** Squared distance of counts behind the next mask from those expected, in the metric of their covariance. */
  misfit(mask, counts, share) {
    const { prior, optics, weights } = this;
    const gain = optics.gain * share;
    const lights = optics.readouts(mask).map((seen) => prior.light(seen));
    const left = lights.map(({ parts }) => this.unknown(parts));
    const scenes = left.map((each) => weights.map((_, scene) => dot(each, prior.coefficients, scene * prior.parts)));
    const middle = scenes.map((each) => dot(each, weights));
    const expected = lights.map(({ mean, parts }, i) => {
      const light = mean + dot(parts, this.shift) + middle[i];
      return Math.max(light, 0) * gain + optics.dark * share;
    });
    const covariance = (i, j) => {
      const among = weights.reduce((sum, weight, scene) => {
        return sum + weight * (scenes[i][scene] - middle[i]) * (scenes[j][scene] - middle[j]);
      }, 0);
      return (among + (prior.spread ? dot(left[i], lights[j].parts) : 0)) * gain ** 2;
    };
    const noise = (i, j) => (i === j ? Math.max(expected[i], 1e-6) : 0);
    const matrix = expected.flatMap((_, i) => expected.map((_, j) => covariance(i, j) + noise(i, j)));
    return squaredLength(expected.map((mean, i) => counts[i] - mean), factorise(matrix, expected.length));
  }

  /** Take in the counts of a mask that was shown for a share of the exposure. */
  update(mask, counts, share) {
    const here = this.middle;
    this.optics.readouts(mask).forEach((seen, place) => this.take(here, counts[place], seen, share));
    this.taken += 1;
    this.weigh();
  }

  take(here, count, seen, share) {
    const { prior, optics, logs } = this;
    const { mean, parts } = prior.light(seen);
    const [gain, dark] = [optics.gain * share, optics.dark * share];
    const least = DIMMEST * prior.whole;
    const left = this.unknown(parts); // what scenes change of the light, given all before
    const offset = mean + dot(parts, this.shift);
    const usual = Math.max(offset + dot(left, here), least) * gain + dark;
    const variance = prior.spread ? Math.max(dot(parts, left), 0) : 0;
    const size = Math.min(usual ** 2 / Math.max(variance * gain ** 2, 1e-30), LARGEST_SIZE);
    const part = usual / (usual + size);
    for (let scene = 0; scene < prior.count; scene++) {
      const light = Math.max(offset + dot(left, prior.coefficients, scene * prior.parts), least);
      const ratio = (light * gain + dark) / usual;
      logs[scene] += count * Math.log(ratio);
      logs[scene] -= prior.spread ? (count + size) * Math.log1p((ratio - 1) * part) : (ratio - 1) * usual;
    }
    if (!prior.spread) return;
    const total = variance + usual / gain ** 2;
    add(this.shift, ((count - dark) / gain - offset) / total, left);
    this.known.push(left.map((each) => each / Math.sqrt(total)));
  }

  /** Probabilities of scenes and classes, and the coefficients of scenes by them, class by class. */
  weigh() {
    const { prior } = this;
    this.weights = softmax(this.logs);
    this.classWeights = new Array(prior.sizes.length).fill(0);
    this.sums = prior.sizes.map(() => new Float64Array(prior.parts));
    this.weights.forEach((weight, scene) => {
      const label = prior.labels[scene];
      this.classWeights[label] += weight;
      if (weight > UNLIKELY) add(this.sums[label], weight, prior.coefficients, scene * prior.parts);
    });
    this.middle = this.sums.reduce((sum, own) => add(sum, 1, own), new Float64Array(prior.parts));
  }

  /** Probabilities of the classes: with a temperature τ, their odds to those before all looks to the power 1 / τ. */
  get chances() {
    const { prior, optics, taken } = this;
    if (!prior.temperatures || !taken) return this.classWeights;
    const temperature = temperatureAt(prior.temperatures, optics.photons, taken - 1);
    const odds = (weight, place) => Math.log(Math.max(weight, LEAST_WEIGHT)) - prior.shares[place];
    return softmax(this.classWeights.map((weight, place) => odds(weight, place) / temperature + prior.shares[place]));
  }

  /** Product of coefficients with the covariance that is left, given the counts. */
  unknown(parts) {
    const left = Float64Array.from(parts);
    for (const direction of this.known) add(left, -dot(parts, direction), direction);
    return left;
  }

  /** Mean scene. */
  get scene() {
    const here = add(this.unknown(this.middle), 1, this.shift);
    return add(this.prior.picture(here), 1, this.prior.mean);
  }
}
