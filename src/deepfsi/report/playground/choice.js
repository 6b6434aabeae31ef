// Choice of the next mask: deepfsi.adaptive.choice in the browser.

import { dot, logDeterminant } from "./numbers.js";
import { add } from "./posterior.js";

const LIKELIEST = 4; // classes that the next mask is to separate at most
const SAMPLES = 128; // scenes drawn of the posterior by which masks are compared
const HALVINGS = 4; // steps by which the best threshold of a mask is found
const DARKEST = 1e-3; // least reflectance of the mean scene

/** Mask whose counts are expected to tell most of the class, for a share of the exposure. */
export function nextMask(state, share, uniform) {
  const drawn = sample(state.weights, uniform);
  let [best, most] = [null, -Infinity];
  for (const mask of candidates(state)) {
    const told = worth(state, mask, share, drawn);
    if (told > most) [best, most] = [mask, told];
  }
  return best;
}

/** Masks that separate the likeliest classes in two groups. */
export function candidates(state) {
  const { classWeights: chances, prior, optics } = state;
  const order = [...chances.keys()].sort((a, b) => chances[b] - chances[a] || a - b);
  const top = order.slice(0, LIKELIEST);
  const scene = state.scene.map((value) => Math.max(value, DARKEST));
  const middle = (group) => {
    const sum = new Float64Array(prior.parts);
    let weight = 0;
    for (const place of group) {
      add(sum, 1, state.sums[place]);
      weight += chances[place];
    }
    return sum.map((value) => value / Math.max(weight, 1e-9));
  };
  const differ = [];
  for (let number = 1; number < 2 ** (top.length - 1); number++) {
    const one = top.filter((_, place) => (number >> place) & 1);
    const other = top.filter((_, place) => !((number >> place) & 1));
    differ.push(prior.picture(state.unknown(add(middle(one), -1, middle(other)))));
  }
  if (optics.arms === 1) differ.push(...differ.map((each) => each.map((value) => -value)));
  return differ.map((each) => brightest(each, scene, optics));
}

/** Mask with the largest difference over its photon noise; found in steps, a local maximum. */
export function brightest(differ, scene, optics) {
  const threshold = new Float64Array(optics.detectors);
  const ratio = (on) => {
    const [above, below] = [new Float64Array(optics.detectors), new Float64Array(optics.detectors)];
    on.forEach((each, i) => {
      above[optics.detector(i)] += each * differ[i];
      below[optics.detector(i)] += each * scene[i];
    });
    return above.map((value, place) => value / Math.max(below[place], 1e-12));
  };
  const mask = () =>
    differ.map((value, i) => (value / scene[i] > threshold[optics.detector(i)] ? 1 : 0));
  if (optics.arms === 2) threshold.set(ratio(differ.map(() => 1)));
  for (let step = 0; step < HALVINGS; step++) {
    const on = mask();
    const middle = ratio(on);
    if (optics.arms === 2) add(middle, 1, ratio(on.map((each) => 1 - each)));
    threshold.set(middle.map((value) => value / 2));
  }
  return mask();
}

/** Scenes drawn by their weights, all where there are few: their places and weights. */
function sample(weights, uniform) {
  if (weights.length <= SAMPLES) return { places: [...weights.keys()], weights: [...weights] };
  const places = [];
  const sum = weights.reduce((a, b) => a + b, 0);
  let [place, below] = [0, weights[0]];
  for (let point = 0; point < SAMPLES; point++) {
    const wanted = ((point + uniform) / SAMPLES) * sum;
    while (below < wanted && place < weights.length - 1) below += weights[++place];
    places.push(place);
  }
  return { places, weights: new Array(SAMPLES).fill(1 / SAMPLES) };
}

/** Nats that the counts of a mask are expected to tell of the class. */
export function worth(state, mask, share, drawn) {
  const { prior, optics } = state;
  const [gain, dark] = [optics.gain * share, optics.dark * share];
  const lights = optics.readouts(mask).map((seen) => prior.light(seen));
  const left = lights.map(({ parts }) => state.unknown(parts));
  const counts = lights.map(({ mean, parts }, place) => {
    const offset = mean + dot(parts, state.shift);
    const light = (scene) => offset + dot(left[place], prior.coefficients, scene * prior.parts);
    return drawn.places.map((scene) => Math.max(light(scene), 0) * gain + dark);
  });
  const usual = counts.map((own) => gain / Math.sqrt(Math.max(dot(own, drawn.weights), 1e-6)));
  const unknown = lights.map(({ parts }, j) =>
    left.map((each, i) => (prior.spread ? dot(each, parts) * usual[i] * usual[j] : 0)),
  );
  const labels = drawn.places.map((scene) => prior.labels[scene]);
  return information(counts, labels, drawn.weights, prior.sizes.length, unknown);
}

/** Nats that counts tell of the class, were they normal within each on 2 √counts. */
function information(counts, labels, weights, classes, unknown) {
  const scale = counts.map((own) => {
    const roots = own.map((count) => 2 * Math.sqrt(count + 3 / 8));
    const mean = dot(roots, weights);
    return roots.map((root) => root - mean);
  });
  const size = new Float64Array(classes);
  labels.forEach((label, scene) => (size[label] += weights[scene]));
  const sums = scale.map((own) => {
    const found = new Float64Array(classes);
    own.forEach((value, scene) => (found[labels[scene]] += value * weights[scene]));
    return found;
  });
  const square = (entry) => scale.map((_, i) => scale.map((_, j) => entry(i, j)));
  const noise = (i, j) => (i === j ? 1 : 0) + unknown[i][j];
  const between = square((i, j) =>
    sums[i].reduce((all, sum, k) => all + (sum * sums[j][k]) / Math.max(size[k], 1e-12), 0),
  );
  const total = square((i, j) => scale[i].reduce((all, value, s) => all + value * weights[s] * scale[j][s], 0));
  if (counts.length === 1) {
    const within = Math.max(total[0][0] - between[0][0], 0) + noise(0, 0);
    return Math.log1p(between[0][0] / within) / 2;
  }
  const whole = logDeterminant(square((i, j) => total[i][j] + noise(i, j)));
  return (whole - logDeterminant(square((i, j) => total[i][j] - between[i][j] + noise(i, j)))) / 2;
}
