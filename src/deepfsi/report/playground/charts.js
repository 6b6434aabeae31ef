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

/** Photons in words, with thin spaces: 31 600. */
export const photonsText = (photons) =>
  Number(photons.toPrecision(3)).toLocaleString("en").replaceAll(",", " ");

const power = (exponent) =>
  `10${[...String(exponent)].map((digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]).join("")}`;

/** Accuracy of the curve at a budget, on the line between its measured points. */
export function accuracyAt(curve, photons) {
  const at = curve.findIndex((point) => point.photons >= photons);
  if (at <= 0) return curve[at < 0 ? curve.length - 1 : 0].accuracy;
  const [before, after] = [curve[at - 1], curve[at]];
  const share = Math.log(photons / before.photons) / Math.log(after.photons / before.photons);
  return before.accuracy + share * (after.accuracy - before.accuracy);
}

export function drawCurve(holder, model, photons) {
  const { curve, budget, classes } = model;
  const height = 210;
  const { width, add } = begin(holder, height);
  const [left, right, top, bottom] = [42, width - 10, 12, height - 24];
  const x = (value) => left + ((Math.log10(value) - 1) / 6) * (right - left);
  const y = (value) => bottom - value * (bottom - top);
  for (const share of [0, 0.5, 1]) {
    add("path", { class: "axis", d: `M${left} ${y(share)}H${right}` });
    add("text", { x: left - 6, y: y(share) + 4, "text-anchor": "end" }, `${share * 100} %`);
  }
  const chance = 1 / classes.length;
  add("path", { class: "axis", d: `M${left} ${y(chance)}H${right}`, "stroke-dasharray": "3 3" });
  add("text", { x: right, y: y(chance) - 4, "text-anchor": "end" }, "guessing");
  for (let exponent = 1; exponent <= 7; exponent++) {
    add("text", { x: x(10 ** exponent), y: height - 6, "text-anchor": "middle" }, power(exponent));
  }
  const [low, high] = [x(budget.low), x(budget.high)];
  if (high > low) add("rect", { class: "trained", x: low, y: top, width: high - low, height: bottom - top });
  else add("path", { class: "trained-line", d: `M${low} ${top}V${bottom}` });
  const middle = (low + high) / 2;
  const anchor = middle > (left + right) / 2 ? "end" : "start";
  const beside = high > low ? 0 : anchor === "end" ? -5 : 5;
  add("text", { class: "strong", x: (anchor === "end" ? high : low) + beside, y: bottom - 26, "text-anchor": anchor }, "learned for");
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

/** Counts of each mask as bars: the positive rail upward, the negative one downward. */
export function drawCounts(holder, model, counts, most, now) {
  const height = 230;
  const { width, add } = begin(holder, height);
  const [left, right, top] = [50, width - 4, 14];
  const dual = model.rails === 2;
  const zero = dual ? height / 2 : height - 22;
  const reach = (dual ? zero : zero) - top;
  const scale = reach / Math.max(most, 1);
  const step = (right - left) / model.masks;
  const bar = Math.max(step * 0.75, 0.6);
  for (let rail = 0; rail < model.rails; rail++) {
    let path = "";
    for (let mask = 0; mask < model.masks; mask++) {
      const tall = counts[rail][mask] * scale;
      const start = left + mask * step + (step - bar) / 2;
      path += `M${start} ${zero}h${bar}v${rail ? tall : -tall}h${-bar}z`;
    }
    add("path", { class: rail ? "minus" : "plus", d: path });
  }
  add("path", { class: "axis", d: `M${left} ${zero}H${right}` });
  add("text", { x: left - 6, y: top + 4, "text-anchor": "end" }, photonsText(most));
  add("text", { x: left - 6, y: zero + 4, "text-anchor": "end" }, "0");
  if (dual) {
    add("text", { x: left - 6, y: height - top + 4, "text-anchor": "end" }, photonsText(most));
    add("text", { x: left, y: 10, class: "strong" }, "positive rail");
    add("text", { x: left, y: height - 3, class: "strong" }, "negative rail");
  } else {
    add("text", { x: left, y: height - 4 }, "mask 1");
    add("text", { x: right, y: height - 4, "text-anchor": "end" }, `mask ${model.masks}`);
  }
  if (now === null) return;
  const middle = left + (now + 0.5) * step;
  const tip = dual ? zero : zero + 3;
  add("path", { class: "now", d: `M${middle} ${tip}l5 8h-10z` });
}

/** Probabilities of the classes over the exposure, as far as it is shown. */
export function drawHistory(holder, exposure, count, top) {
  const height = 150;
  const { width, add } = begin(holder, height);
  const [left, right, upper, bottom] = [42, width - 8, 16, height - 32];
  const x = (time) => left + (time / exposure.length) * (right - left);
  const y = (value) => bottom - value * (bottom - upper);
  for (const share of [0, 0.5, 1]) {
    add("path", { class: "axis", d: `M${left} ${y(share)}H${right}` });
    add("text", { x: left - 6, y: y(share) + 4, "text-anchor": "end" }, `${share * 100} %`);
  }
  add("text", { x: left, y: height - 16 }, "start");
  add("text", { x: right, y: height - 16, "text-anchor": "end" }, "end of the exposure");
  const known = [...exposure.answers].filter(([at, { chances }]) => chances && at <= count);
  known.sort(([a], [b]) => a - b);
  const time = (at) => exposure.frames[at - 1].end;
  exposure.model.classes.forEach((_, place) => {
    if (place === top || !known.length) return;
    const points = known.map(([at, { chances }]) => `${x(time(at))} ${y(chances[place])}`);
    add("path", { class: "class-line", d: `M${points.join("L")}` });
  });
  if (known.length && top !== null) {
    const points = known.map(([at, { chances }]) => `${x(time(at))} ${y(chances[top])}`);
    add("path", { class: "class-line top", d: `M${points.join("L")}` });
  }
  const { rule, stop } = exposure;
  if (rule && rule.threshold < 1) {
    add("path", { class: "threshold", d: `M${left} ${y(rule.threshold)}H${right}` });
  }
  if (!stop || count < stop.count) return;
  const at = x(stop.end);
  add("path", { class: "stop-line", d: `M${at} ${upper}V${bottom + 6}` });
  const anchor = at > (left + right) / 2 ? "end" : "start";
  const words = `could stop: ${Math.round(stop.saved * 100)} % saved`;
  add("text", { class: "strong", x: at, y: height - 2, "text-anchor": anchor }, words);
}

/** Bars of the classes' probabilities, the ten likeliest where there are many. */
export function drawAnswer(list, model, chances, sound) {
  const places = model.classes.map((_, place) => place);
  const many = places.length > 12;
  if (many && chances) places.sort((a, b) => chances[b] - chances[a]);
  const top = chances ? chances.indexOf(Math.max(...chances)) : null;
  list.classList.toggle("unsound", !sound);
  const rows = places.slice(0, many ? 10 : undefined).map((place) => {
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
    value.textContent = chances ? `${(chances[place] * 100).toFixed(1)} %` : "";
    row.append(name, track, value);
    return row;
  });
  list.replaceChildren(...rows);
  return top;
}
