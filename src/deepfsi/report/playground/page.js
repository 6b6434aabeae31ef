// What all parts of the page use.

export const $ = (id) => document.getElementById(id);

const PLACES = [1, 2, 4, 6, 8, 10];

/** Smallest round number that is not below a value. */
export function roundUp(value) {
  const unit = 10 ** Math.floor(Math.log10(value));
  return PLACES.find((place) => place * unit >= value) * unit;
}

export const percent = (share) => `${(share * 100).toFixed(share > 0 && share < 0.1 ? 1 : 0)}\u00a0%`;
