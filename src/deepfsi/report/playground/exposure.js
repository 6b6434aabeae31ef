// One exposure of a scene: frames, counts and answers.

import { Random, poisson } from "./numbers.js";

const SLICES = 48; // parts of an exposure whose readouts all see light at once

/** Frames of one device in their order: the readouts of each, and its share of the exposure. */
function framesOf(model) {
  const frames = [];
  const add = (mask, rails, share) => {
    const places = rails.flatMap((rail) =>
      Array.from({ length: model.detectors }, (_, d) => model.place(rail, mask, d)),
    );
    if (share > 0) frames.push({ mask, rails, share, places, scale: 1 });
  };
  const lit = model.peaks.flat().filter((peak) => peak > 0).length;
  for (let mask = 0; mask < model.masks; mask++) {
    const peaks = model.peaks.map((rail) => rail[mask]);
    if (model.law.arms === 2) {
      add(mask, [0, 1], model.entry(0, mask, 0) + model.entry(1, mask, 0));
      continue;
    }
    peaks.forEach((peak, rail) => {
      const own = model.law.equal_times ? 1 / lit : peak;
      add(mask, [rail], peak > 0 ? own : 0);
    });
  }
  return frames;
}

/** Frames of masks that all see light at once: the exposure in slices. */
function slicesOf(model) {
  const places = Array.from({ length: model.readouts }, (_, place) => place);
  const rails = model.peaks.map((_, rail) => rail);
  const slice = { mask: null, rails, share: 1 / SLICES, places, scale: 1 / SLICES };
  return Array.from({ length: SLICES }, () => ({ ...slice }));
}

/** What all exposures have: frames one after another, and answers after them. */
export class Frames {
  constructor(model, scene, photons, seed) {
    Object.assign(this, { model, scene, photons, seed, frames: [], answers: new Map(), stop: null });
    this.together = !model.law.one_device;
  }

  /** When it ends: all masks that are known before are shown. */
  get end() {
    return this.length;
  }

  /** True after the last frame of an exposure whose counts are unlike those of the training. */
  unlike(count) {
    const { model, photons, scene, seed } = this;
    if (!model.usual || count !== (this.stop?.count ?? this.frames.length)) return false;
    const rate = (photons * scene.reduce((a, b) => a + b, 0)) / model.summed_reflectance;
    const allOn = { light: poisson(rate, new Random(seed, 4)), dark: 0 }; // a frame as long as the exposure
    const { misfit, looks, sums } = this.statistics;
    return model.unlike({ misfit, looks, photons, sums: [allOn, ...sums] });
  }

  /** Place the frames in time, one after another. */
  lay() {
    let end = 0;
    for (const frame of this.frames) {
      frame.begin = end;
      end += frame.share;
      frame.end = end;
    }
    this.length = end;
  }
}

export class Exposure extends Frames {
  /** Draw an exposure. */
  constructor(model, scene, photons, seed) {
    super(model, scene, photons, seed);
    const random = new Random(seed);
    const light = model.rates(scene).map((rate) => rate * photons);
    const rates = model.darkCounts ? light.map((rate, place) => rate + model.darkCounts[place]) : light;
    this.frames = this.together ? slicesOf(model) : framesOf(model);
    for (const frame of this.frames) {
      frame.counts = frame.places.map((place) => poisson(rates[place] * frame.scale, random));
    }
    this.lay();
  }

  /** Counts are drawn beforehand: nothing is to be done to reach a moment. */
  reach() {}

  /** Counts, and those of light, after so many frames. */
  after(count) {
    const { model } = this;
    const counts = new Float64Array(model.readouts);
    const scale = new Float64Array(model.readouts);
    this.frames.slice(0, count).forEach((frame) => {
      frame.places.forEach((place, i) => {
        counts[place] += frame.counts[i];
        scale[place] += frame.scale;
      });
    });
    return { counts, lit: model.withoutDark(counts, scale) };
  }

  /** What the test of counts asks of the whole exposure. */
  get statistics() {
    const { model, photons, frames } = this;
    const { lit } = this.after(frames.length);
    const sum = (values) => values.reduce((a, b) => a + b, 0);
    const sums = [{ light: sum(lit), dark: sum(model.darkCounts ?? []) }];
    return { misfit: model.misfit(lit, photons), looks: 1, sums };
  }

  /** Probabilities at the end; where all masks see light at once, those of so much light. */
  answer(count) {
    const { model, photons, frames } = this;
    if (!count || !(this.together || count === frames.length)) return null;
    if (!this.answers.has(count)) {
      const light = this.together ? photons * frames[count - 1].end : photons;
      this.answers.set(count, model.classify(this.after(count).lit, light));
    }
    return this.answers.get(count);
  }
}
