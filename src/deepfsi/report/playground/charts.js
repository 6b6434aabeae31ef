// Charts, drawn as SVG at the width they have.

const SVG = "http://www.w3.org/2000/svg";

/** A chart's SVG, emptied, with functions that add to it. */
function begin(holder, height) {
  const width = Math.max(holder.clientWidth, 200);
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("height", height);
  svg.setAttribute("aria-hidden", "true");
  holder.replaceChildren(svg);
  const add = (name, attributes, text) => {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    svg.append(element);
  };
  return { width, add };
}

/** Photons in words, with thin spaces that do not break: 31 600. */
export const photonsText = (photons) =>
  Number(photons.toPrecision(3)).toLocaleString("en").replaceAll(",", "\u202f");

/** A whole number, with the same spaces. */
export const wholeText = (count) => count.toLocaleString("en").replaceAll(",", "\u202f");

/** A probability in percent, with one digit; none is said to be 0 or 1. */
export function chanceText(chance) {
  if (chance < 0.0005) return "<\u00a00.1\u00a0%";
  return chance < 0.9995 ? `${(chance * 100).toFixed(1)}\u00a0%` : ">\u00a099.9\u00a0%";
}

const power = (exponent) =>
  `10${[...String(exponent)].map((digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]).join("")}`;

/** Accuracy of the curve at a budget, or another of its numbers, on the line between its measured points. */
export function accuracyAt(curve, photons, name = "accuracy") {
  const at = curve.findIndex((point) => point.photons >= photons);
  if (at <= 0) return curve[at < 0 ? curve.length - 1 : 0][name];
  const [before, after] = [curve[at - 1], curve[at]];
  const share = Math.log(photons / before.photons) / Math.log(after.photons / before.photons);
  return before[name] + share * (after[name] - before[name]);
}

export function drawCurve(holder, model, photons) {
  const { curve } = model;
  const height = 168;
  const { width, add } = begin(holder, height);
  const [left, right, top, bottom] = [42, width - 14, 22, height - 38];
  const x = (value) => left + ((Math.log10(value) - 1) / 6) * (right - left);
  const y = (value) => bottom - value * (bottom - top);
  for (const share of [0, 0.5, 1]) {
    add("path", { class: "axis", d: `M${left} ${y(share)}H${right}` });
    add("text", { x: left - 6, y: y(share) + 4, "text-anchor": "end" }, `${share * 100} %`);
  }
  const chance = model.test.commonest;
  add("path", { class: "axis", d: `M${left} ${y(chance)}H${right}`, "stroke-dasharray": "3 3" });
  for (let exponent = 1; exponent <= 7; exponent++) {
    add("text", { x: x(10 ** exponent), y: bottom + 16, "text-anchor": "middle" }, power(exponent));
  }
  add("text", { x: 0, y: 10 }, "share of test scenes that are right");
  add("text", { x: right, y: height - 4, "text-anchor": "end" }, "photons in one exposure");
  add("text", { x: right, y: y(chance) - 4, "text-anchor": "end" }, "guessing");
  const line = curve.map((point) => `${x(point.photons)} ${y(point.accuracy)}`).join("L");
  add("path", { class: "curve-line", d: `M${line}` });
  for (const point of curve) {
    add("path", { class: "interval", d: `M${x(point.photons)} ${y(point.low)}V${y(point.high)}` });
    add("circle", { class: "measured", cx: x(point.photons), cy: y(point.accuracy), r: 2.8 });
  }
  const here = accuracyAt(curve, photons);
  add("path", { class: "here-line", d: `M${x(photons)} ${y(here)}V${bottom}` });
  add("circle", { class: "here", cx: x(photons), cy: y(here), r: 7 });
}

/** Bars of the masks, the second rail downward: their paths, and where each mask is. */
function bars(values, { left, right, zero, reach, most }) {
  const scale = (value) => (value / most) * reach;
  const step = (right - left) / values[0].length;
  const wide = Math.max(step * 0.75, 0.6);
  const start = (mask) => left + mask * step + (step - wide) / 2;
  const path = (rail, masks) =>
    masks
      .map((mask) => {
        const tall = scale(values[rail][mask]);
        return `M${start(mask)} ${zero}h${wide}v${rail ? tall : -tall}h${-wide}z`;
      })
      .join("");
  return { path, scale, middle: (mask) => left + (mask + 0.5) * step };
}

/** Whole numbers from 0. */
export const places = (count) => Array.from({ length: count }, (_, place) => place);

/** Counts of each mask as bars: the positive rail upward, the negative one downward. */
export function drawCounts(holder, model, counts, most, now, names) {
  const height = model.rails === 2 ? 170 : 140;
  const { width, add } = begin(holder, height);
  const [left, right, top] = [50, width - 4, 22];
  const dual = model.rails === 2;
  const zero = dual ? height / 2 : height - 32;
  const chart = bars(counts, { left, right, zero, reach: zero - top, most });
  add("path", { class: "axis", d: `M${left} ${zero}H${right}` });
  for (const share of [1 / 2, 1]) {
    const rise = chart.scale(most * share);
    for (const y of dual ? [zero - rise, zero + rise] : [zero - rise]) {
      add("path", { class: "axis", d: `M${left} ${y}H${right}` });
      add("text", { x: left - 6, y: y + 4, "text-anchor": "end" }, photonsText(most * share));
    }
  }
  add("text", { x: left - 6, y: zero + 4, "text-anchor": "end" }, "0");
  counts.forEach((_, rail) => {
    add("path", { class: rail ? "minus" : "plus", d: chart.path(rail, places(model.masks)) });
  });
  const rails = model.law.arms === 2 ? ["one direction", "the other"] : ["positive rail", "negative rail"];
  if (!dual) add("text", { x: 0, y: 10 }, names.counts);
  else {
    add("text", { x: 0, y: 10, class: "strong" }, `${names.counts}: ${rails[0]}`);
    add("text", { x: left, y: height - 2, class: "strong" }, rails[1]);
  }
  const low = dual ? height - 2 : height - 4;
  if (!dual) add("text", { x: left, y: low }, names.one);
  add("text", { x: right, y: low, "text-anchor": "end" }, names.all);
  if (now !== null) add("path", { class: "now", d: `M${chart.middle(now)} ${zero + 2}l5 8h-10z` });
}

/** Probabilities of the classes over the exposure, as far as it is shown. */
export function drawHistory(holder, exposure, count, top) {
  const height = 140;
  const { width, add } = begin(holder, height);
  const [left, right, upper, bottom] = [50, width - 8, 22, height - 22];
  add("text", { x: 0, y: 10 }, "probability of each class");
  const across = (time) => left + (time / exposure.length) * (right - left);
  const y = (value) => bottom - value * (bottom - upper);
  for (const share of [0, 0.5, 1]) {
    add("path", { class: "axis", d: `M${left} ${y(share)}H${right}` });
    add("text", { x: left - 6, y: y(share) + 4, "text-anchor": "end" }, `${share * 100} %`);
  }
  add("text", { x: left, y: height - 4 }, "start");
  add("text", { x: right, y: height - 4, "text-anchor": "end" }, "end of the exposure");
  if (top === null) return;
  const known = exposure.frames
    .slice(0, count)
    .map((frame, place) => ({ x: across(frame.end), chances: exposure.answer(place + 1) }))
    .filter(({ chances }) => chances);
  const line = (place) => `M${known.map(({ x, chances }) => `${x} ${y(chances[place])}`).join("L")}`;
  exposure.model.classes.forEach((_, place) => {
    if (place !== top) add("path", { class: "class-line", d: line(place) });
  });
  add("path", { class: "class-line top", d: line(top) });
  for (const { x, chances } of exposure.together ? [] : known) {
    add("circle", { class: "dot", cx: x, cy: y(chances[top]), r: 3.5 });
  }
}

/** Bars of the classes' probabilities, the ten likeliest where there are many. */
export function drawAnswer(list, model, chances) {
  const order = places(model.classes.length);
  const many = order.length > 12;
  if (many && chances) order.sort((a, b) => chances[b] - chances[a]);
  const top = chances ? chances.indexOf(Math.max(...chances)) : null;
  const rows = order.slice(0, many ? 10 : undefined).map((place) => {
    const row = document.createElement("li");
    if (place === top) row.className = "top";
    const [name, track, value] = ["name", "track", "value"].map((kind) => {
      const part = document.createElement("span");
      part.className = kind;
      return part;
    });
    name.textContent = name.title = model.classes[place];
    if (chances) {
      const fill = document.createElement("span");
      fill.className = "fill";
      fill.style.width = `${chances[place] * 100}%`;
      track.append(fill);
    }
    value.textContent = chances ? chanceText(chances[place]) : "";
    row.append(name, track, value);
    return row;
  });
  list.replaceChildren(...rows);
  return top;
}
