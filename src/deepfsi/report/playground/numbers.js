// Random numbers, Poisson counts and packed arrays.

/** Seeded numbers: mulberry32 of Tommy Ettinger, whose 2³² states are far more than a page draws. */
export class Random {
  constructor(seed, stream = 0) {
    this.state = Math.imul(seed, 0x9e3779b1) ^ Math.imul(stream + 1, 0x85ebca6b);
  }

  bits() {
    this.state = (this.state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(this.state ^ (this.state >>> 15), this.state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return (mixed ^ (mixed >>> 14)) >>> 0;
  }

  /** Uniform in (0, 1), 53 bits. */
  uniform() {
    return ((this.bits() >>> 5) * 2 ** 26 + (this.bits() >>> 6) + 0.5) * 2 ** -53;
  }
}

const FACTORIALS = [1, 1, 2, 6, 24, 120, 720, 5040, 40320, 362880];

function logFactorial(k) {
  if (k < 10) return Math.log(FACTORIALS[k]);
  const inverse = 1 / k;
  const series = inverse / 12 - inverse ** 3 / 360 + inverse ** 5 / 1260;
  return (k + 0.5) * Math.log(k) - k + 0.5 * Math.log(2 * Math.PI) + series;
}

/**
 * One Poisson count of any rate, exact: inversion at low rates, and above them Hörmann's
 * transformed rejection PTRS (Insurance: Mathematics and Economics 12, 39, 1993).
 */
export function poisson(rate, random) {
  if (!(rate > 0)) return 0;
  if (rate < 10) {
    let chance = Math.exp(-rate);
    let rest = random.uniform();
    let count = 0;
    while (rest > chance && chance > 0) {
      rest -= chance;
      count += 1;
      chance *= rate / count;
    }
    return count;
  }
  const b = 0.931 + 2.53 * Math.sqrt(rate);
  const a = -0.059 + 0.02483 * b;
  const inverse = 1.1239 + 1.1328 / (b - 3.4);
  const sure = 0.9277 - 3.6224 / (b - 2);
  for (;;) {
    const u = random.uniform() - 0.5;
    const v = random.uniform();
    const us = 0.5 - Math.abs(u);
    const count = Math.floor(((2 * a) / us + b) * u + rate + 0.43);
    if (us >= 0.07 && v <= sure) return count;
    if (count < 0 || (us < 0.013 && v > us)) continue;
    const left = Math.log(v) + Math.log(inverse) - Math.log(a / (us * us) + b);
    if (left <= count * Math.log(rate) - rate - logFactorial(count)) return count;
  }
}

/** Array of the payload: base64 of deflated byte planes, the lowest bytes first. */
export async function unpack({ shape, bytes, planes }) {
  const packed = Uint8Array.from(atob(planes), (letter) => letter.charCodeAt(0));
  const inflated = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const plane = new Uint8Array(await new Response(inflated).arrayBuffer());
  const count = plane.length / bytes;
  const whole = new Uint8Array(plane.length);
  for (let byte = 0; byte < bytes; byte++) {
    for (let i = 0; i < count; i++) whole[i * bytes + byte] = plane[byte * count + i];
  }
  const kind = { 1: Int8Array, 2: Uint16Array, 4: Float32Array }[bytes];
  return { shape, values: new kind(whole.buffer) };
}

/** Temperature at a budget and a place among the stops: interpolated, and as 1 / Φ below all budgets. */
export function temperatureAt({ logs, budgets }, photons, place) {
  const step = Math.log(budgets[1] / budgets[0]);
  const level = Math.log(photons / budgets[0]) / step;
  const log = between(logs.map((row) => between(row, level)), place);
  return Math.exp(log - Math.min(level, 0) * step);
}

/** Value between equidistant ones at a place from 0; the ends are held. */
export function between(values, place) {
  const at = Math.min(Math.max(place, 0), values.length - 1);
  const low = Math.floor(at);
  const high = Math.min(low + 1, values.length - 1);
  return values[low] + (at - low) * (values[high] - values[low]);
}

export function softmax(scores) {
  const top = scores.reduce((a, b) => Math.max(a, b));
  const powers = Array.from(scores, (score) => Math.exp(score - top));
  const sum = powers.reduce((a, b) => a + b, 0);
  return powers.map((power) => power / sum);
}

/** Cholesky factor, in place, of a symmetric positive definite matrix. */
export function factorise(matrix, size) {
  for (let j = 0; j < size; j++) {
    const row = j * size;
    for (let i = j; i < size; i++) {
      const other = i * size;
      let sum = matrix[other + j];
      for (let k = 0; k < j; k++) sum -= matrix[other + k] * matrix[row + k];
      matrix[other + j] = i === j ? Math.sqrt(sum) : sum / matrix[row + j];
    }
  }
  return matrix;
}

/** Square of a vector's length in the metric of a matrix, given the matrix's Cholesky factor. */
export function squaredLength(vector, factor) {
  const solved = new Float64Array(vector.length);
  vector.forEach((value, i) => {
    solved[i] = (value - dot(solved.subarray(0, i), factor, i * vector.length)) / factor[i * (vector.length + 1)];
  });
  return dot(solved, solved);
}

/** Sum of the products of two vectors, the second from a place on. */
export function dot(a, b, start = 0) {
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += a[i] * b[start + i];
  return sum;
}

/** Logarithm of the determinant of a symmetric positive definite matrix, given by its rows. */
export function logDeterminant(rows) {
  const size = rows.length;
  const factor = factorise(Float64Array.from(rows.flat()), size);
  return rows.reduce((sum, _, i) => sum + 2 * Math.log(factor[i * size + i]), 0);
}
