// Adaptive masks: the design, and an exposure whose each next mask is made from the counts so far.

import { nextMask } from "./choice.js";
import { Frames } from "./exposure.js";
import { Design } from "./model.js";
import { poisson, Random, unpack } from "./numbers.js";
import { LookOptics, Posterior, Prior } from "./posterior.js";

export class LookModel extends Design {
  /** The design of a payload, its arrays unpacked. */
  static async load(payload) {
    const model = new LookModel(payload);
    const { mean, components, steps, levels, members } = payload.prior;
    const arrays = Object.entries({ mean, components, steps, levels, members }).map(async ([name, packed]) => [
      name,
      (await unpack(packed)).values,
    ]);
    model.prior = new Prior({ ...payload.prior, ...Object.fromEntries(await Promise.all(arrays)) });
    model.masks = model.looks = payload.shares.length;
    return model;
  }

  /** Place of a readout among the counts, look by look. */
  place(rail, look, detector = 0) {
    return (look * this.rails + rail) * this.detectors + detector;
  }

  get readouts() {
    return this.rails * this.looks * this.detectors;
  }
}

export class LookExposure extends Frames {
  constructor(model, scene, photons, seed) {
    super(model, scene, photons, seed);
    this.rule = model.rule(photons);
    this.random = [new Random(seed), new Random(seed, 3)]; // of counts, and of the masks' choice
    this.optics = new LookOptics(model, photons);
    this.state = new Posterior(model.prior, this.optics);
    this.scenes = [this.state.scene];
    this.misfit = 0;
    const readouts = Array.from({ length: model.rails * model.detectors }, (_, place) => place);
    this.frames = model.shares.map((share, look) => ({
      mask: look,
      look,
      share,
      places: readouts.map((place) => look * readouts.length + place),
      counts: null,
      pattern: null,
    }));
    this.lay();
  }

  /** Number of looks that are taken. */
  get taken() {
    return this.scenes.length - 1;
  }

  /** When it ends: where it is sure, or after all looks. */
  get end() {
    return this.stop ? this.stop.end : this.length;
  }

  /** Take looks until there are so many, or it stops. */
  reach(count) {
    const [counting, choosing] = this.random;
    while (this.taken < count && !this.stop) {
      const frame = this.frames[this.taken];
      frame.pattern = nextMask(this.state, frame.share, choosing.uniform());
      const expected = this.optics.expected(frame.pattern, this.scene, frame.share);
      frame.counts = expected.map((rate) => poisson(rate, counting));
      this.misfit += this.state.misfit(frame.pattern, frame.counts, frame.share);
      this.state.update(frame.pattern, frame.counts, frame.share);
      this.scenes.push(this.state.scene);
      this.answers.set(this.taken, this.state.chances);
      this.judge(this.taken);
    }
  }

  /** Stop after a look, if it is the first after which the rule would. */
  judge(count) {
    if (!this.rule || count >= this.frames.length) return;
    const { end } = this.frames[count - 1];
    if (Math.max(...this.answer(count)) > this.rule.threshold) {
      this.stop = { count, end, saved: 1 - end / this.length };
    }
  }

  /** What the test of counts asks of the looks. */
  get statistics() {
    return { misfit: this.misfit, looks: this.taken, sums: [] };
  }

  /** Counts after so many looks, at most those that are taken. */
  after(count) {
    const counts = new Float64Array(this.model.readouts);
    for (const frame of this.frames.slice(0, count)) {
      frame.places.forEach((place, i) => (counts[place] = frame.counts[i]));
    }
    return { counts };
  }

  answer(count) {
    return this.answers.get(count) ?? null;
  }
}
