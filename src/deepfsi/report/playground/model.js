// The design: what its masks count of a scene, and what its networks make of the counts.

import { between, dot, factorise, softmax, squaredLength, temperatureAt, unpack } from "./numbers.js";

const SMALLEST = 1e-6; // share of the light below which it is taken for this
const NEAR = 0.5 + 1e-9; // decades from the budget of a rule, where it holds

/** Outputs of a network with rectified hidden layers. */
function outputs(layers, inputs) {
  let hidden = inputs;
  layers.forEach(({ weight, bias }, place) => {
    const [rows, columns] = weight.shape;
    const next = new Float64Array(rows);
    const weights = weight.values;
    const before = Float64Array.from(hidden);
    const last = place === layers.length - 1;
    for (let row = 0; row < rows; row++) {
      let sum = bias.values[row];
      const start = row * columns;
      for (let column = 0; column < columns; column++) {
        sum += weights[start + column] * before[column];
      }
      next[row] = last || sum > 0 ? sum : 0;
    }
    hidden = next;
  });
  return hidden;
}

/** What all designs have. */
export class Design {
  constructor(payload) {
    Object.assign(this, payload);
    this.law = LAW; // facts of its light law, which the page begins with
    this.pixels = payload.image_shape.reduce((a, b) => a * b);
  }

  /** True of counts that are unlike those of the training: by their misfit, or by a sum of counts of light. */
  unlike({ misfit, looks, photons, sums }) {
    const { budgets, logarithms, lights, deviations } = this.usual;
    const level = Math.log(photons / budgets[0]) / Math.log(budgets[1] / budgets[0]);
    const [mean, deviation] = logarithms.map((rows) => between(rows.map((row) => row[looks - 1]), level));
    if (Math.log(misfit) > mean + deviations[0] * deviation) return true;
    return sums.some(({ light, dark }, i) => {
      const { limits, expected, spread } = lights[i];
      const share = light / (photons * expected);
      const noise = Math.sqrt(photons * expected + dark) / (photons * expected);
      if (share >= limits[0] - 3 * noise && share <= limits[1] + 3 * noise) return false;
      const far = Math.abs(Math.log(Math.max(share, SMALLEST)));
      return far > deviations[1] * Math.sqrt(Math.log1p(spread ** 2 + noise ** 2));
    });
  }

  /** True where the light is far below that of the training. */
  tooDim(photons) {
    return this.temperatures !== null && photons < this.temperatures.dimmest * (1 - 1e-9);
  }

  /** The stopping rule, if there is one that was chosen near this budget. */
  rule(photons) {
    return this.rules.find(({ photons: own }) => Math.abs(Math.log10(own / photons)) <= NEAR) ?? null;
  }
}

/** A design of masks that are known before an exposure. */
export class Model extends Design {
  /** The design of a payload, its arrays unpacked. */
  static async load(payload) {
    const model = new Model(payload);
    model.matrix = (await unpack(payload.matrix)).values;
    model.total = payload.total && (await unpack(payload.total)).values;
    model.mean = (await unpack(payload.mean)).values;
    model.std = (await unpack(payload.std)).values;
    model.darkCounts = payload.dark ? (await unpack(payload.dark_counts)).values : null;
    model.network = await Promise.all(
      payload.network.map(async ({ weight, bias }) => ({
        weight: await unpack(weight),
        bias: await unpack(bias),
      })),
    );
    const { noise, rest, means, axes } = model.usual ?? {};
    for (const [name, packed] of Object.entries({ noise, rest, means, axes })) {
      if (packed) model.usual[name] = (await unpack(packed)).values;
    }
    model.masks = model.matrix.length / model.pixels;
    model.features = model.mean.length;
    model.frames = model.findFrames();
    model.peaks = model.findPeaks();
    return model;
  }

  /** Frames of all masks, rail by rail: shares of each pixel's photons. */
  findFrames() {
    const { masks, matrix, pixels, total } = this;
    return Array.from({ length: this.rails * masks }, (_, place) => {
      const [rail, mask] = [Math.floor(place / masks), place % masks];
      return Float64Array.from({ length: pixels }, (_, pixel) => {
        const at = mask * pixels + pixel;
        if (this.rails === 1) return matrix[at];
        const sum = total ? total[total.length === masks ? mask : at] : Math.abs(matrix[at]);
        return Math.max((rail === 0 ? sum + matrix[at] : sum - matrix[at]) / 2, 0);
      });
    });
  }

  /** Share of a pixel's photons that a rail of a mask counts. */
  entry(rail, mask, pixel) {
    return this.frames[rail * this.masks + mask][pixel];
  }

  /** Largest entry of each frame, [rail][mask]. */
  findPeaks() {
    const peaks = this.frames.map((frame) => frame.reduce((a, b) => Math.max(a, b), 0));
    return Array.from({ length: this.rails }, (_, rail) =>
      peaks.slice(rail * this.masks, (rail + 1) * this.masks),
    );
  }

  /** Place of a readout among the counts: rail by rail, mask by mask, detector by detector. */
  place(rail, mask, detector = 0) {
    return (rail * this.masks + mask) * this.detectors + detector;
  }

  get readouts() {
    return this.rails * this.masks * this.detectors;
  }

  /** Expected counts of a scene's reflectances for a budget of one photon. */
  rates(scene) {
    const rates = new Float64Array(this.readouts);
    this.frames.forEach((frame, place) => {
      const first = place * this.detectors;
      for (let pixel = 0; pixel < this.pixels; pixel++) {
        rates[this.labels ? first + this.labels[pixel] : first] += frame[pixel] * scene[pixel];
      }
    });
    return rates.map((rate) => rate / this.summed_reflectance);
  }

  /** Counts less those that are expected in the dark; `scale` is the share of each readout's time. */
  withoutDark(counts, scale) {
    const dark = this.darkCounts;
    return dark ? counts.map((count, place) => count - dark[place] * scale[place]) : counts;
  }

  /** Squared distance of counts without dark ones from those of the nearest class, by Woodbury's identity. */
  misfit(lit, photons) {
    const { noise, rest, means, axes } = this.usual;
    const count = noise.length;
    const scale = Float64Array.from(noise, (each, i) => {
      return 1 / Math.sqrt(photons * each + (this.darkCounts?.[i] ?? 0) + photons ** 2 * rest[i]);
    });
    const rows = Array.from({ length: axes.length / count }, (_, row) =>
      scale.map((each, i) => photons * each * axes[row * count + i]),
    );
    const precision = rows.flatMap((one, i) => rows.map((other, j) => (i === j ? 1 : 0) + dot(one, other)));
    const factor = factorise(precision, rows.length);
    const distances = this.classes.map((_, k) => {
      const off = scale.map((each, i) => each * (lit[i] - photons * means[k * count + i]));
      return dot(off, off) - squaredLength(rows.map((row) => dot(row, off)), factor);
    });
    return Math.min(...distances);
  }

  /** Features that the networks read of counts. */
  read(counts) {
    const each = this.detectors;
    const half = this.masks * each;
    if (this.rails === 1) return counts;
    if (this.readout === "difference") {
      return Float64Array.from({ length: half }, (_, i) => counts[i] - counts[half + i]);
    }
    const features = new Float64Array(2 * half);
    for (let i = 0; i < half; i++) {
      const mask = Math.floor(i / each);
      features[mask * each + i] = counts[i];
      features[(mask + 1) * each + i] = counts[half + i];
    }
    return features;
  }

  /** Inputs of the classifier, of counts at a budget. */
  inputs(counts, photons) {
    const inputs = Array.from(this.read(counts), (each, i) => (each / photons - this.mean[i]) / this.std[i]);
    if (this.exposure.kind !== "conditioned") return inputs;
    const { photons: low, span, used } = this.exposure;
    const middle = Math.log(span) / 2;
    inputs.push((Math.log(photons / (used * low)) - middle) / Math.max(middle, 1));
    inputs.push(1); // all masks are shown
    return inputs;
  }

  /** Calibrated probabilities of the classes; parameters as of `inputs`. */
  classify(counts, photons) {
    const temperature = this.temperature(photons);
    const logits = outputs(this.network, this.inputs(counts, photons));
    return softmax(logits.map((each) => each / temperature));
  }

  /** What the logits are divided by: interpolated between budgets. */
  temperature(photons) {
    return this.temperatures ? temperatureAt(this.temperatures, photons, 0) : 1;
  }
}
